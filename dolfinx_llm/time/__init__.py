"""What you step through in time: `TimeStepper`, inertia of bodies in contact, impact."""
