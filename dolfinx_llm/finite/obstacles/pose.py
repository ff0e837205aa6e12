"""Where a rigid obstacle is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dolfinx_llm.base.arrays import Array


@dataclass(frozen=True, eq=False)
class Pose:
    """Where an obstacle is: what was drawn at X is at pivot + shift + R (X - pivot)."""

    pivot: Array  # (gdim,) as drawn [length]
    shift: Array  # (gdim,) [length]
    turn: Array  # (1,), (3,) rotation vector [rad]
    R: Array  # (gdim, gdim)

    @classmethod
    def of(cls, numbers: Array, gdim: int) -> Pose:
        """Of pivot, displacement, rotation, and what forces and moments are."""
        ends = np.cumsum([gdim, gdim, 1 if gdim == 2 else 3])
        pivot, shift, turn, _ = np.split(numbers, ends)
        vector = [0.0, 0.0, turn[0]] if gdim == 2 else turn
        return cls(pivot, shift, turn, Rotation.from_rotvec(vector).as_matrix()[:gdim, :gdim])

    def back(self, x: Array) -> Array:
        """(n, gdim) where points x were drawn."""
        return (x - self.pivot - self.shift) @ self.R + self.pivot

    def on(self, X: Array) -> Array:
        """(n, gdim) where points drawn at X are."""
        return (X - self.pivot) @ self.R.T + self.pivot + self.shift
