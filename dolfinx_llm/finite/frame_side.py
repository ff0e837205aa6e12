"""What is told of the side that carries the frame: whether its nodes touch, how far away the other
body is, how far they slide.

Its nodes are no pairs of their own: what pairs about them do is theirs. Rows that are designed say
nothing here, since they reach to nodes beyond contact.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal
from dolfinx_llm.finite.frame.location import INSIDE, OnFrame, find_on_frame
from dolfinx_llm.finite.frame.self_sides import SelfSides
from dolfinx_llm.finite.frame.sides import HARDLY, Sides
from dolfinx_llm.finite.pairs.friction_law import in_plane
from dolfinx_llm.finite.pairs.terms import ContactTerms
from dolfinx_llm.geometry.cells import areas_around, cell_sizes, unit
from dolfinx_llm.interface.tool_forces import tool_shares

ON_A_LINE = 1e-6  # of the largest variance of places: pairs that tell nothing across
SPREAD = 1e-3  # of a facet's size, squared: the variance that tells how slip changes
WIDER = 2  # times that facets around those of a node are taken in where its own tell too little


def shapes_on_frame(sides: Sides, at: OnFrame) -> csr_matrix:
    """(n, m) shape functions of the frame's control values at places of n nodes; none negative,
    also beyond its rim."""
    surface = sides.carrier
    N = at.N @ surface.element.bernstein
    N = np.where(at.met[:, None] & (N > INSIDE), N, 0.0)
    index = np.repeat(np.arange(len(N)), N.shape[1]), surface.cells[at.facet].ravel()
    found = csr_matrix((N.ravel(), index), (len(N), len(surface.x)))
    found.eliminate_zeros()
    return found


def status_of_frame(shapes: csr_matrix, status: Array) -> Array:
    """(m,) status of the frame's nodes, of pairs with status (n,) on which their shape functions
    (n, m) are: slip where one slips."""
    reached = (shapes > HARDLY).T @ diagonal(status)
    return np.asarray(reached.max(axis=1).todense()).ravel().astype(status.dtype)


def gap_of_frame(sides: Sides, z: Array, pairs: Array) -> Array:
    """(m,) distance of the frame's nodes from the facets of which all nodes are pairs (n,), along
    their averaged normals; inf where there are none opposite [length]."""
    x, y = sides.split(z)
    gap, cells = np.full(len(y), np.inf), sides.mover.cells
    cells = cells[pairs[cells].all(axis=1)]
    if len(cells):
        at = find_on_frame(y, x, cells, unit(areas_around(x, sides.mover.skin)))
        there = at.met & (at.beyond < INSIDE)
        if isinstance(sides, SelfSides):  # they would find themselves
            there &= ~pairs
        gap[there] = at.gap[there]
    return gap


def mover_at_frame(sides: Sides, z: Array) -> csr_matrix:
    """(m, n) values of the moving side's nodes at the frame's nodes; none beside its facets."""
    x, y = sides.split(z)
    cells = sides.mover.cells
    at = find_on_frame(y, x, cells, unit(areas_around(x, sides.mover.skin)))
    N = np.where((at.met & (at.beyond < INSIDE))[:, None], at.N, 0.0)
    index = np.repeat(np.arange(len(y)), N.shape[1]), cells[at.facet].ravel()
    return csr_matrix((N.ravel(), index), (len(y), len(x)))


def with_tool_forces(sides: Sides, terms: ContactTerms, shapes: csr_matrix) -> ContactTerms:
    """The same with forces on a prescribed side's nodes as ``tool_shares`` has them, for shape
    functions (n, m) of the pairs there."""
    E, place = sides.nodal, terms.place
    x, y = sides.split(place.z)
    force, known = sides.split(terms.force)
    where = place.areas, sides.control[0] @ x, y
    shares = tool_shares(shapes.T, place.N, *where, -(E.T @ force), known)
    if shares is None:
        return terms

    def shared(values: Array) -> Array:
        own = sides.split(values)[0]
        return np.concatenate(sides.in_order(own, -(shares @ (E.T @ own)))).ravel()

    drag = terms.friction
    return replace(
        terms, force=shared(terms.force), friction=drag if drag is None else shared(drag)
    )


def slip_of_frame(sides: Sides, shapes: csr_matrix, z: Array, normal: Array, slip: Array) -> Array:
    """(m, gdim) slip of the frame's nodes on the other body, by linear functions of the place,
    s(x), which are fitted about each node to the slip of pairs; 0 where there are none. What node
    J, now at y_J, faced at first has gone on to y_J - s_J, so that s_J = -s(y_J - s_J).

    Args:
        sides: the surfaces.
        shapes: (n, m) weights of the pairs in contact, at least 0.
        z: all coordinates [length].
        normal: (m, gdim) of the frame's nodes.
        slip: (n, gdim) of the pairs [length].
    """
    x, y = sides.split(z)
    x, m, cells = sides.control[0] @ x, len(y), sides.carrier.cells
    least = SPREAD * float(np.square(cell_sizes(y, sides.carrier.facets)).mean())
    index = cells.ravel(), np.repeat(np.arange(len(cells)), cells.shape[1])
    beside = csr_matrix((np.ones(cells.size), index), (m, len(cells)))
    for _ in range(WIDER):
        middle, spread = _about(shapes, x, y, normal)[2:]
        few = (np.linalg.eigvalsh(spread)[:, 1] < least) & (shapes.getnnz(axis=0) > 0)
        shapes = shapes + shapes @ beside @ beside.T @ diagonal(few)
    w, arm, middle, spread = _about(shapes, x, y, normal)
    p, J = shapes.tocoo().row, shapes.tocoo().col
    mean = _sums(w[:, None] * slip[p], J, m)
    moment = _sums(arm[:, :, None] * (w[:, None] * (slip[p] - mean[J]))[:, None], J, m)
    slope = np.linalg.pinv(spread, ON_A_LINE, hermitian=True) @ moment
    found = np.einsum("mi,mij->mj", middle, slope) - mean
    turns = np.linalg.pinv(np.eye(y.shape[1]) - np.swapaxes(slope, 1, 2))
    return in_plane(normal, np.einsum("mij,mj->mi", turns, found))


def _about(shapes: csr_matrix, x: Array, y: Array, normal: Array) -> tuple[Array, ...]:
    """Of the pairs about each node: parts of its weights (e,), ways from their middle in its
    tangent plane (e, gdim), by entries; that middle (m, gdim) from the node, and the mean of the
    ways' squares (m, gdim, gdim)."""
    of, m = shapes.tocoo(), len(y)
    w = of.data / np.bincount(of.col, of.data, m)[of.col]
    arm = in_plane(normal[of.col], x[of.row] - y[of.col])
    middle = _sums(w[:, None] * arm, of.col, m)
    arm = arm - middle[of.col]
    return w, arm, middle, _sums(w[:, None, None] * arm[:, :, None] * arm[:, None], of.col, m)


def _sums(values: Array, at: Array, m: int) -> Array:
    """(m, ...) sums of values (e, ...) at their places."""
    found = np.zeros((m, *values.shape[1:]))
    np.add.at(found, at, values)
    return found
