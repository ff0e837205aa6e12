"""Obstacles that bodies cannot part from: they hold nodes as supports do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.operators.prescribed import REPEATED, place_among


@dataclass(frozen=True, eq=False)
class Guides:
    """Rows of obstacles that bodies cannot part from, at nodes that have others as well."""

    rows: Array  # (r,)
    nodes: Array  # (k,) ascending
    node: Array  # (r,) of each row
    place: Array  # (r,) among its node's
    inverse: Array  # (k, gdim, j) pseudo-inverse of the free parts of the node's base vectors
    free: Array  # (k, gdim, gdim) projector on the directions that they leave

    @classmethod
    def of(cls, nodes: Array, base: Array, rows: Array) -> Guides:
        """Of some rows (r,); ``nodes`` (n,) and free parts of base vectors (n, gdim) of all."""
        known, node = np.unique(nodes[rows], return_inverse=True)
        place = place_among(node)
        vectors = np.zeros((len(known), place.max(initial=0) + 1, base.shape[1]))
        vectors[node, place] = base[rows]
        inverse = np.linalg.pinv(vectors, rcond=REPEATED)
        return cls(rows, known, node, place, inverse, np.eye(base.shape[1]) - inverse @ vectors)

    def without(self, nodes: Array, base: Array) -> Array:
        """What these leave of base vectors (n, gdim) at some nodes (n,)."""
        here, at = self._at(nodes)
        left = np.einsum("ni,nij->nj", base[here], self.free[at])
        left[np.linalg.norm(left, axis=1) <= REPEATED] = 0.0
        base = base.copy()
        base[here] = left
        return base

    def told(self, nodes: Array, forces: Array) -> Array:
        """(r,) what these bear of forces (n, gdim) at some nodes (n,)."""
        here, at = self._at(nodes)
        total = np.zeros((len(self.nodes), forces.shape[1]))
        np.add.at(total, at, forces[here])
        return np.einsum("kij,ki->kj", self.inverse, total)[self.node, self.place]

    def _at(self, nodes: Array) -> tuple[Array, Array]:
        """(n,) which of the nodes have such rows, and (m,) the number of each that does."""
        here = np.isin(nodes, self.nodes)
        return here, np.searchsorted(self.nodes, nodes[here])
