"""What you step through in time: inertia of bodies in contact, impact."""
