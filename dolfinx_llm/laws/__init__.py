"""Contact laws and their rows, at a few nodes, in plain NumPy."""
