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
from dolfinx_llm.finite.pairs.terms import ContactTerms
from dolfinx_llm.geometry.cells import areas_around, unit
from dolfinx_llm.interface.tool_forces import tool_shares


def shapes_on_frame(sides: Sides, z: Array, at: OnFrame) -> csr_matrix:
    """(n, m) shape functions of the frame's control values at places of the pairs; none negative,
    also beyond its rim. Of a prescribed side, which may have nodes far closer to each other, those
    of the moving side at its nodes."""
    if sides.prescribed:
        return (mover_at_frame(sides, z) @ sides.nodal).maximum(0.0).T.tocsr()
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


def on_mover(sides: Sides, z: Array, cells: Array) -> OnFrame:
    """Where the frame's m nodes lie on facets ``cells`` of the moving side, along its averaged
    normals."""
    x, y = sides.split(z)
    return find_on_frame(y, x, cells, unit(areas_around(x, sides.mover.skin)))


def gap_of_frame(sides: Sides, z: Array, pairs: Array) -> Array:
    """(m,) distance of the frame's nodes from the facets of which all nodes are pairs (n,), along
    their averaged normals; inf where there are none opposite [length]."""
    gap, cells = np.full(len(sides.carrier.x), np.inf), sides.mover.cells
    cells = cells[pairs[cells].all(axis=1)]
    if len(cells):
        at = on_mover(sides, z, cells)
        there = at.met & (at.beyond < INSIDE)
        if isinstance(sides, SelfSides):  # they would find themselves
            there &= ~pairs
        gap[there] = at.gap[there]
    return gap


def mover_at_frame(sides: Sides, z: Array) -> csr_matrix:
    """(m, n) values of the moving side's nodes at the frame's nodes; none beside its facets."""
    cells = sides.mover.cells
    at = on_mover(sides, z, cells)
    N = np.where((at.met & (at.beyond < INSIDE))[:, None], at.N, 0.0)
    index = np.repeat(np.arange(len(N)), N.shape[1]), cells[at.facet].ravel()
    return csr_matrix((N.ravel(), index), (len(N), len(sides.mover.x)))


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
