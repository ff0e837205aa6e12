"""Finite deformation: Newton's iteration, in load steps, and its results."""
