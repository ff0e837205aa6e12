"""Pairs of a surface and a moving frame: what they add to Newton's system, by law."""
