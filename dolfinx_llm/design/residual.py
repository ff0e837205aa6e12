"""What must cancel at the nodes of a flat frame: forces of unit pressure (28), and moments.

At second order pressures that are linear along the surface pass as well if the moments of both
sides' forces about each frame node cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.design.stencils import spread
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.loads import NodalLoads


def patch_residual(N: Sequence[csr_matrix], forces: Sequence[np.ndarray]) -> np.ndarray:
    """Residual (28) at the frame's nodes over the largest force.

    Args:
        N: pair of (n_i, m) sparse matrices, the scalar L_b of each side.
        forces: pair of (n_i,) forces of unit pressure [area].

    Returns:
        (m,) residual; the frame passes where its largest value is at most 1e-13.
    """
    loads, s = [NodalLoads.of_forces(f) for f in forces], np.zeros((N[0].shape[1], 0))
    return FrameLoads(s, loads, [], 1.0, max(f.max() for f in forces)).residual(N)[:, 0]


def load_residual(
    frame: Frame, s: np.ndarray, N: Sequence[csr_matrix], loads: Sequence[NodalLoads]
) -> np.ndarray:
    """(m, 1) residual (28) at the frame's nodes over the largest force; (m, gdim) where loads have
    moments: force, and moments about the node over the frame's mean cell size."""
    return FrameLoads.of(frame, s, N, loads).residual(N)


@dataclass(frozen=True, eq=False)
class FrameLoads:
    """The forces and moments at the frame's nodes that must cancel."""

    s: np.ndarray  # (m, d) frame nodes in coordinates of the plane [length]
    loads: Sequence[NodalLoads]  # of both sides
    places: Sequence[np.ndarray]  # (n_i, d) where their nodes are [length]
    size: float  # of the frame's cells [length]
    scale: float  # largest force [area]
    tangents: np.ndarray | None = None  # (m, gdim - 1, gdim) at the nodes of a curved frame, where
    # s and places are positions in space

    @classmethod
    def of(
        cls, frame: Frame, s: np.ndarray, N: Sequence[csr_matrix], loads: Sequence[NodalLoads]
    ) -> FrameLoads:
        scale = max(float(np.abs(load.forces).max()) for load in loads)
        # Rows reproduce linear fields: so they tell where they are.
        return cls(s, loads, [M @ s for M in N], float(frame.cell_size.mean()), scale)

    @property
    def count(self) -> int:
        """Of equations at a frame node: 1, with moments gdim."""
        d = self.loads[0].moments.shape[1]
        return 1 + d if self.tangents is None else d

    def at(self, side: int, indptr: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """(z, count) what the rows' loads are at entries: force, and moments about the node."""
        load = self.loads[side]
        force = spread(load.forces, indptr)[:, None]
        if self.count == 1:
            return force / self.scale
        arm = spread(self.places[side], indptr) - self.s[nodes]
        moment = (spread(load.moments, indptr) + arm * force) / self.size
        if self.tangents is not None:
            moment = np.einsum("zai,zi->za", self.tangents[nodes], moment)
        return np.column_stack([force, moment]) / self.scale

    def residual(self, N: Sequence[csr_matrix]) -> np.ndarray:
        """(m, count)"""
        # Nᵀ f without the transpose: SciPy takes longer to make that than the product of small
        # frames.
        total, m = np.zeros((len(self.s), self.count)), len(self.s)
        for side, (M, sign) in enumerate(zip(N, (1.0, -1.0), strict=True)):
            at = self.at(side, M.indptr, M.indices)
            for a in range(self.count):
                total[:, a] += sign * np.bincount(M.indices, M.data * at[:, a], m)
        return total
