"""Facets and nodes that several interfaces, or pieces of one, have."""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix, triu

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.geometry.pieces import Piece
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.interface.site import Site


def check_pairs(geometries: Sequence[InterfaceGeometry]) -> None:
    """Require that no two interfaces have the same facets on both of their sides."""
    pairs = [(i, k) for i, g in enumerate(geometries) if len(g.pairs) == 2 for k in (0, 1)]
    if len(pairs) < 4:
        return
    facets = []
    for i, k in pairs:
        surface = geometries[i].pairs[k].surface
        nodes = np.sort(surface.dofs[surface.facets], axis=1)
        known = np.full((len(nodes), 7), -1)
        known[:, 0], known[:, 1] = i, k
        known[:, 2], known[:, 3 : 3 + nodes.shape[1]] = geometries[i].spaces[k], nodes
        facets.append(known)
    rows = np.concatenate(facets)
    _, number = np.unique(rows[:, 2:], axis=0, return_inverse=True)
    shape, number = (len(geometries), len(rows)), number.ravel()
    own = [
        csr_matrix((np.ones(side.sum()), (rows[side, 0], number[side])), shape)
        for side in (rows[:, 1] == 0, rows[:, 1] == 1)
    ]
    common = [triu(M @ (own[0] + own[1]).T, 1, format="csr") for M in own]
    twice = common[0].multiply(common[1]).tocoo()
    if twice.nnz:
        i, j = int(twice.row[0]), int(twice.col[0])
        counts = [int(M[i, j]) for M in common]
        names = " and ".join(geometries[k].interface.name for k in (i, j))
        raise ContactInputError(
            f"the interfaces {names} have {counts[0]} and {counts[1]} facets of both sides in "
            "common: give each pair of surfaces once"
        )


def shared_nodes(geometries: Sequence[InterfaceGeometry]) -> list[tuple[Array, ...]]:
    """Per interface and side (n,) nodes of the tagged surface that several interfaces have."""
    nodes = [
        np.column_stack([np.full(len(pairs.dofs), space), pairs.dofs])
        for geometry in geometries
        for pairs, space in zip(geometry.pairs, geometry.spaces, strict=True)
    ]
    known, count = np.unique(np.concatenate(nodes), axis=0, return_counts=True)
    several = known[count > 1]
    return [
        tuple(
            np.isin(whole.dofs, several[several[:, 0] == space, 1])
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
