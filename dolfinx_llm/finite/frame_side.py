"""What is told of the side that carries the frame: whether its nodes touch, how far away the other
body is, how far they slide.

Its nodes are no pairs of their own: what pairs about them do is theirs. Rows that are designed say
nothing here, since they reach to nodes beyond contact.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal
from dolfinx_llm.finite.friction_law import in_plane
from dolfinx_llm.finite.location import INSIDE, OnFrame, find_on_frame
from dolfinx_llm.finite.self_sides import SelfSides
from dolfinx_llm.finite.sides import HARDLY, Sides
from dolfinx_llm.geometry.cells import areas_around, unit

ON_A_LINE = 1e-6  # of the largest variance of places: pairs that tell nothing across


def shapes_on_frame(sides: Sides, at: OnFrame) -> csr_matrix:
    """(n, m) shape functions of the frame's control values at places of n nodes that are on them,
    also beyond its rim; none negative."""
    surface = sides.surfaces[sides.frame]
    N = at.N @ surface.element.bernstein
    N = np.where(at.met[:, None] & (N > HARDLY), N, 0.0)
    index = np.repeat(np.arange(len(N)), N.shape[1]), surface.cells[at.facet].ravel()
    found = csr_matrix((N.ravel(), index), (len(N), len(surface.x)))
    found.eliminate_zeros()
    return found


def status_of_frame(shapes: csr_matrix, status: Array) -> Array:
    """(m,) status of the frame's nodes, where their shape functions (n, m) reach pairs with status
    (n,): slip where one slips."""
    reached = (shapes > 0.0).T @ diagonal(status)
    return np.asarray(reached.max(axis=1).todense()).ravel().astype(status.dtype)


def gap_of_frame(sides: Sides, z: Array, pairs: Array) -> Array:
    """(m,) distance of the frame's nodes from the facets of which all nodes are pairs (n,), along
    their averaged normals; inf where there are none opposite [length]."""
    x, y = sides.split(z)
    gap, cells = np.full(len(y), np.inf), sides.cells(True)
    cells = cells[pairs[cells].all(axis=1)]
    if len(cells):
        at = find_on_frame(y, x, cells, unit(areas_around(x, sides.skin(True))))
        there = at.met & (at.beyond < INSIDE)
        if isinstance(sides, SelfSides):  # they would find themselves
            there &= ~pairs
        gap[there] = at.gap[there]
    return gap


def slip_of_frame(shapes: csr_matrix, x: Array, y: Array, normal: Array, slip: Array) -> Array:
    """(m, gdim) slip of the frame's nodes at y (m, gdim) on the other body, by linear functions of
    the place, s(x), which are fitted about each node to the slip of pairs; the mean where pairs lie
    in one place, 0 where there are none. What a node faced at first has gone on to y - s_J, so that
    s_J = -s(y - s_J).

    Args:
        shapes: (n, m) weights of the pairs in contact, at least 0.
        x, slip: (n, gdim) of the pairs.
        y, normal: (m, gdim) of the frame's nodes.
    """
    of = shapes.tocoo()
    p, J, w, m = of.row, of.col, of.data, len(y)
    total = np.bincount(J, w, m)
    w = w / total[J]

    def sums(values: Array) -> Array:
        """(m, ...) weighted, of values per entry (e, ...)."""
        found = np.zeros((m, *values.shape[1:]))
        np.add.at(found, J, w.reshape(-1, *(1,) * (values.ndim - 1)) * values)
        return found

    arm, mean = in_plane(normal[J], x[p] - y[J]), sums(slip[p])
    middle = sums(arm)
    arm = arm - middle[J]
    spread = np.linalg.pinv(sums(arm[:, :, None] * arm[:, None]), ON_A_LINE, hermitian=True)
    slope = spread @ sums(arm[:, :, None] * (slip[p] - mean[J])[:, None])
    found = np.einsum("mi,mij->mj", middle, slope) - mean
    turns = np.linalg.pinv(np.eye(y.shape[1]) - np.swapaxes(slope, 1, 2))
    return in_plane(normal, np.einsum("mij,mj->mi", turns, found))
