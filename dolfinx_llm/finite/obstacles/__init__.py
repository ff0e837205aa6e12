"""Pairs of a surface and a rigid obstacle, which is moved, pressed or tied to."""
