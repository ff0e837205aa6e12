"""The iteration of contact laws, and the results."""
