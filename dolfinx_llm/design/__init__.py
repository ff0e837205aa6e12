"""How a frame is found, and made to pass a constant pressure exactly. Plain NumPy."""
