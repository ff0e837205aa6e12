"""Facets and nodes that several interfaces, or pieces of one, have."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy.sparse import csr_matrix, triu

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.geometry.pieces import Piece
from dolfinx_llm.interface.choices import Interface, SelfContact
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.interface.obstacle import Obstacle
from dolfinx_llm.interface.site import Site

MESH = 2**40  # more nodes than a mesh has: numbers of those of several meshes stay apart


def check_pairs(geometries: Sequence[InterfaceGeometry]) -> None:
    """Require that no two interfaces are of the same facets on both of their sides."""
    facets = [
        [p.surface.dofs[p.surface.facets] + MESH * k for p, k in zip(g.pairs, g.spaces)]
        for g in geometries
    ]
    check_once([g.interface for g in geometries], facets)


def check_once(interfaces: Sequence[Interface], facets: Sequence[Sequence[Array]]) -> None:
    """Require that no two interfaces are of the same facets on both of their sides, of the same
    facets and obstacle, of an obstacle under a force, or of the same facets that meet themselves.

    Args:
        interfaces: the user's choices.
        facets: per interface and side that is a body (f, k) numbers of each facet's corners; of a
            surface that meets itself once.

    Raises:
        ContactInputError: what touches is given twice.
    """
    if len(interfaces) < 2:
        return
    pushed = [i for i in interfaces if i.obstacle is not None and _pushed(i.obstacle)]
    for one, other in combinations(pushed, 2):
        if one.obstacle is other.obstacle:
            raise ContactInputError(
                f"the interfaces {one.name} and {other.name} are of the same obstacle, which is "
                "under a force: each would bear all of it. Give the surfaces that it touches one "
                "tag, and one interface"
            )
    known = [np.full((len(f), 6), -1) for sides in facets for f in sides]
    places = [(i, k) for i, sides in enumerate(facets) for k in range(len(sides))]
    for rows, (i, k) in zip(known, places, strict=True):
        nodes = np.sort(facets[i][k], axis=1)
        rows[:, 0], rows[:, 1], rows[:, 2 : 2 + nodes.shape[1]] = i, k, nodes
    every = np.concatenate(known)
    _, number = np.unique(every[:, 2:], axis=0, return_inverse=True)
    shape, number = (len(interfaces), len(every)), number.ravel()
    own = [
        csr_matrix((np.ones(side.sum()), (every[side, 0], number[side])), shape)
        for side in (every[:, 1] == 0, every[:, 1] == 1)
    ]
    for first, second in ((0, 1), (1, 0)):  # the other one's sides may come in the other order
        common = [triu(own[k] @ own[j].T, 1, format="csr") for k, j in ((0, first), (1, second))]
        twice = common[0].multiply(common[1]).tocoo()
        if twice.nnz:
            i, j = int(twice.row[0]), int(twice.col[0])
            counts = [int(M[i, j]) for M in common]
            raise ContactInputError(
                f"the interfaces {interfaces[i].name} and {interfaces[j].name} have {counts[0]} "
                f"and {counts[1]} facets of both sides in common: give each pair of surfaces once"
            )
    alike = triu(own[0] @ own[0].T, 1).tocoo()
    for i, j, n in zip(alike.row, alike.col, alike.data, strict=True):
        one, other = interfaces[i], interfaces[j]
        if one.obstacle is not other.obstacle:
            continue
        rigid = one.obstacle is not None
        if rigid or {type(one), type(other)} == {SelfContact}:
            what = "the same obstacle" if rigid else "a surface that meets itself"
            raise ContactInputError(
                f"the interfaces {one.name} and {other.name} are of {what} and have {int(n)} "
                "facets in common: give them once"
            )


def _pushed(obstacle: Obstacle) -> bool:
    """Whether a force or a moment acts on it."""
    return obstacle.force is not None or obstacle.moment is not None


def shared_nodes(geometries: Sequence[InterfaceGeometry]) -> list[tuple[Array, ...]]:
    """Per interface and side (n,) nodes of the tagged surface that several interfaces have."""
    every = 1 + max(max(geometry.spaces) for geometry in geometries)  # a number per node and space
    nodes = [
        pairs.dofs * every + space
        for geometry in geometries
        for pairs, space in zip(geometry.pairs, geometry.spaces, strict=True)
    ]
    known, count = np.unique(np.concatenate(nodes), return_counts=True)
    several = known[count > 1]
    return [
        tuple(
            np.isin(whole.dofs * every + space, several)
            for whole, space in zip(geometry.site.whole, geometry.spaces, strict=True)
        )
        for geometry in geometries
    ]


def shared_by(pieces: Sequence[Piece], site: Site) -> tuple[Array, ...]:
    """Per side (n,) nodes that several pieces, or other interfaces have; none of laws that may slip
    or part."""
    if len(pieces) == 1 or not site.interface.law.ties:
        return site.shared
    found = []
    for k, side in enumerate(site.whole):
        nodes = np.concatenate([np.unique(side.cells[piece.facets[k]]) for piece in pieces])
        found.append(np.bincount(nodes, minlength=len(side.x)) > 1)
    return tuple(a | b for a, b in zip(found, site.shared or found, strict=True))
