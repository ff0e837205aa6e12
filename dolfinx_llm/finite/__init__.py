"""Finite deformation: nodes on the moving frame, rows designed there, and their derivatives."""
