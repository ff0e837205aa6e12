"""Rows of Newton's system of a law of one's own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, vstack

from dolfinx_llm.base.sparse import diagonal, per_item, summing
from dolfinx_llm.finite.jacobians import coordinates
from dolfinx_llm.finite.law_rows import Linear, Tangents


@dataclass(frozen=True, eq=False)
class LawSystem:
    """What a law leaves at k of n nodes, p components each, by all that it depends on: coordinates,
    lambda, the design's unknowns and tau, in this order of columns."""

    columns: int
    width: int  # number of coordinates
    n: int
    at: np.ndarray  # (k,) the nodes
    said: Linear
    tangents: Tangents | None  # where the law slips
    normal: np.ndarray  # (k, gdim)
    turned: csr_matrix  # (k gdim, width) its derivative
    tau: np.ndarray  # (k, gdim) forces along the surface [force]

    @property
    def own(self) -> np.ndarray:
        """(k gdim,) numbers of the nodes' components."""
        return coordinates(self.at[:, None], self.normal.shape[1]).ravel()

    def on_tau(self) -> csr_matrix:
        """(k gdim, columns) tau itself."""
        first = self.columns - self.n * self.normal.shape[1]
        return summing(first + self.own, self.columns).T.tocsr()

    def widened(self, matrix: csr_matrix) -> csr_matrix:
        """The same with columns of zeros behind."""
        parts = matrix.data, matrix.indices, matrix.indptr
        return csr_matrix(parts, (matrix.shape[0], self.columns))

    def change(
        self, gap: csr_matrix, growth: csr_matrix, way: tuple[np.ndarray, csr_matrix], sign: float
    ) -> csr_matrix:
        """(k p, columns) derivatives.

        Args:
            gap: (k, columns) of the gaps; nothing where the law does not give.
            growth: (k, width) of the areas.
            way: sigma (k, gdim), and its derivative (k gdim, width).
            sign: of sigma and tau in what the law is told.
        """
        said, on_lambda = self.said, summing(self.width + self.at, self.columns).T
        forces, jumps = [], []
        if self.tangents is not None:
            by_tau, by_way = self.tangents.turning(self.tau), self.tangents.turning(way[0])
            for i, (turns, carried) in enumerate(zip(by_tau, by_way, strict=True)):
                e = per_item(self.tangents.e[:, i][:, None])
                forces.append(sign * (self.widened(turns) + e @ self.on_tau()))
                jumps.append(sign * self.widened(carried + e @ way[1]))
        if len(forces) < said.left.shape[1]:
            forces.append(on_lambda)
            jumps.append(-gap)
        return (
            per_item(said.by_force) @ _interleaved(forces)
            + per_item(said.by_jump) @ _interleaved(jumps)
            + per_item(said.by_N[:, :, None]) @ on_lambda
            + per_item(said.by_area[:, :, None]) @ self.widened(growth)
        )

    def along(self, change: csr_matrix) -> tuple[csr_matrix, np.ndarray]:
        """(k gdim, columns) derivatives and (k, gdim) values of the part along the surface as
        vectors, and of n·tau, which is 0.

        Args:
            change: of ``change``.
        """
        assert self.tangents is not None
        (k, p), e, normal, left = self.said.left.shape, self.tangents.e, self.normal, self.said.left
        gdim, r = normal.shape[1], e.shape[1]
        across = np.einsum("ki,ki->k", normal, self.tau)[:, None]
        rows = np.arange(k * p).reshape(k, p)[:, :r].ravel()
        unit, outer = np.eye(gdim), normal[:, :, None] * normal[:, None, :]
        by_normal = normal[:, :, None] * self.tau[:, None, :] + across[:, :, None] * unit
        turns = per_item(by_normal) @ self.turned
        for i, by in enumerate(self.tangents.by_z):
            turns = turns + diagonal(np.repeat(left[:, i], gdim)) @ by
        found = per_item(np.swapaxes(e, 1, 2)) @ change[rows] + per_item(outer) @ self.on_tau()
        found = found + self.widened(turns)
        return found, across * normal + np.einsum("kri,kr->ki", e, left[:, :r])


def _interleaved(parts: list[csr_matrix]) -> csr_matrix:
    """(k p, columns) rows of p matrices (k, columns), node by node."""
    k, p = parts[0].shape[0], len(parts)
    return vstack(parts, format="csr")[np.arange(k * p).reshape(p, k).T.ravel()]
