"""Surfaces, frames, where nodes lie on them and what two surfaces share. Plain NumPy."""
