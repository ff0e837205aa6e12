"""A law of one's own at nodes of the moving side: what it is told, its rows and their derivatives.

The law is told forces and jumps in a base that is carried along with the surface: t1 is the
direction from a node to a neighbour of it, in the tangent plane of the frame there, t2 = n x t1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, vstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, per_item, summing
from dolfinx_llm.finite.frame.jacobians import coordinates, cross_matrix, jacobian
from dolfinx_llm.laws.answers import rows_of
from dolfinx_llm.laws.law import Law
from dolfinx_llm.laws.rows import LawNodes

STEP = 1e-4  # part of an area by which the law's forces are compared: they are about linear in it


@dataclass(frozen=True, eq=False)
class Tangents:
    """Bases of k tangent planes, which follow the surface."""

    e: Array  # (k, gdim - 1, gdim) unit vectors
    by_z: tuple[csr_matrix, ...]  # of each (k gdim, width) [1 / length]

    @classmethod
    def of(
        cls,
        x: Array,
        ends: tuple[Array, Array],
        normal: Array,
        turned: csr_matrix,
        first: int,
    ) -> Tangents:
        """Bases at nodes.

        Args:
            x: (n, gdim) nodes of the surface [length].
            ends: (k,) nodes, and a neighbour of each.
            normal: (k, gdim) unit normals.
            turned: (k gdim, width) their derivative [1 / length].
            first: number of the first coordinate of the surface.
        """
        k, gdim = normal.shape
        unit = np.eye(gdim)
        d = x[ends[1]] - x[ends[0]]
        both = np.tile(np.concatenate([unit, -unit], axis=1), (k, 1, 1))
        columns = coordinates(np.column_stack(ends[::-1]), gdim, first)
        moved = jacobian(both, columns, turned.shape[1])
        along = np.einsum("ki,ki->k", normal, d)
        w = d - along[:, None] * normal
        size = np.linalg.norm(w, axis=1)
        e = w / size[:, None]
        across = (unit - e[:, :, None] * e[:, None, :]) / size[:, None, None]
        by_normal = -across @ (along[:, None, None] * unit + normal[:, :, None] * d[:, None, :])
        P = unit - normal[:, :, None] * normal[:, None, :]
        by_e = per_item(by_normal) @ turned + per_item(across @ P) @ moved
        if gdim == 2:
            return cls(e[:, None], (by_e,))
        # d(n x e) = dn x e + n x de
        second = per_item(cross_matrix(e)) @ turned - per_item(cross_matrix(normal)) @ by_e
        return cls(np.stack([e, np.cross(normal, e)], axis=1), (by_e, second))

    def components(self, w: Array) -> Array:
        """(k, gdim - 1) components of vectors w (k, gdim)."""
        return np.einsum("kri,ki->kr", self.e, w)

    def turning(self, w: Array) -> list[csr_matrix]:
        """Of each component (k, width) its derivative for a vector w (k, gdim) that stays."""
        return [per_item(w[:, None]) @ by for by in self.by_z]


@dataclass(frozen=True, eq=False)
class Linear:
    """What a law leaves at k nodes, q components each, and its derivatives."""

    left: Array  # (k, q) [force]
    by_force: Array  # (k, q, q)
    by_jump: Array  # (k, q, q) [force / length]
    by_N: Array  # (k, q)
    by_area: Array  # (k, q) [force / area]
    status: Array  # (k,)
    holds: Array  # (k,) where pairs may pull


def linear(law: Law, nodes: LawNodes, jump: Array) -> Linear:
    """A law about an iterate.

    Args:
        law: of one's own.
        nodes: what it is told.
        jump: (k, q) where its rows are asked; what it is told is at least 0 along the normal where
            pairs may part [length].

    Raises:
        ContactInputError: the law returns what fits no node.
    """
    rows = rows_of(law, nodes)
    now = replace(nodes, jump=jump)
    more, less = (
        rows_of(law, replace(nodes, area=nodes.area * (1.0 + h))).left(now) for h in (STEP, -STEP)
    )
    weight = 1.0 if rows.weight is None else rows.weight[:, None]
    assert rows.holds is not None
    return Linear(
        rows.left(now),
        rows.C_T,
        rows.C_jump,
        rows.C_N * weight,
        (more - less) / (2.0 * STEP * nodes.area)[:, None],
        rows.status,
        rows.holds,
    )


@dataclass(frozen=True, eq=False)
class LawSystem:
    """What a law leaves at k of n nodes, p components each, by all that it depends on: coordinates,
    lambda, the design's unknowns and tau, in this order of columns."""

    columns: int
    width: int  # number of coordinates
    n: int
    at: Array  # (k,) the nodes
    said: Linear
    tangents: Tangents | None  # where the law slips
    normal: Array  # (k, gdim)
    turned: csr_matrix  # (k gdim, width) its derivative
    tau: Array  # (k, gdim) forces along the surface [force]

    @property
    def own(self) -> Array:
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
        self, gap: csr_matrix, growth: csr_matrix, way: tuple[Array, csr_matrix], sign: float
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

    def along(self, change: csr_matrix) -> tuple[csr_matrix, Array]:
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
