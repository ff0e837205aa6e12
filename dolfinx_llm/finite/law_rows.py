"""A law of one's own at nodes of the moving side: what it is told, its rows and their derivatives.

The law is told forces and jumps in a base that is carried along with the surface: t1 is the
direction from a node to a neighbour of it, in the tangent plane of the frame there, t2 = n x t1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.sparse import per_item
from dolfinx_llm.finite.jacobians import coordinates, cross_matrix, jacobian
from dolfinx_llm.laws.law import Law
from dolfinx_llm.laws.rows import LawNodes, LawRows, checked

STEP = 1e-4  # part of an area by which the law's forces are compared: they are about linear in it


@dataclass(frozen=True, eq=False)
class Tangents:
    """Bases of k tangent planes, which follow the surface."""

    e: np.ndarray  # (k, gdim - 1, gdim) unit vectors
    by_z: tuple[csr_matrix, ...]  # of each (k gdim, width) [1 / length]

    @classmethod
    def of(
        cls,
        x: np.ndarray,
        ends: tuple[np.ndarray, np.ndarray],
        normal: np.ndarray,
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

    def components(self, w: np.ndarray) -> np.ndarray:
        """(k, gdim - 1) components of vectors w (k, gdim)."""
        return np.einsum("kri,ki->kr", self.e, w)

    def turning(self, w: np.ndarray) -> list[csr_matrix]:
        """Of each component (k, width) its derivative for a vector w (k, gdim) that stays."""
        return [per_item(w[:, None]) @ by for by in self.by_z]


@dataclass(frozen=True, eq=False)
class Linear:
    """What a law leaves at k nodes, q components each, and its derivatives."""

    left: np.ndarray  # (k, q) [force]
    by_force: np.ndarray  # (k, q, q)
    by_jump: np.ndarray  # (k, q, q) [force / length]
    by_N: np.ndarray  # (k, q)
    by_area: np.ndarray  # (k, q) [force / area]
    status: np.ndarray  # (k,)
    holds: np.ndarray  # (k,) where pairs may pull


def linear(law: Law, nodes: LawNodes, jump: np.ndarray) -> Linear:
    """A law about an iterate.

    Args:
        law: of one's own.
        nodes: what it is told.
        jump: (k, q) where its rows are asked; what it is told is at least 0 along the normal where
            pairs may part [length].

    Raises:
        ContactInputError: the law returns what fits no node.
    """
    rows = _rows(law, nodes)
    now = replace(nodes, jump=jump)
    more, less = (
        _rows(law, replace(nodes, area=nodes.area * (1.0 + h))).left(now) for h in (STEP, -STEP)
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


def _rows(law: Law, nodes: LawNodes) -> LawRows:
    return checked(repr(law), law.rows(nodes), *nodes.jump.shape)
