"""One interface: what the user chooses, and all that follows from its geometry."""
