"""Facets that share edges, and what hangs together over them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.cells import outline_edges, unit_normals
from dolfinx_llm.geometry.facing import TURN

STRAIGHT = 1e-8  # difference of the unit normals of a flat side's facets


def faces(sides: Sequence[tuple[Array, Array]], pairs: Sequence[Array]) -> Array:
    """(n,) number of the face of each pair of facets, n of both sides, that face each other: what
    hangs together without a sharp edge; 0 of all where there is none.

    Args:
        sides: per side positions of nodes (m, gdim), and facets (f, k).
        pairs: per side (n,) numbers of facets.
    """
    joined, sharp, first = [], False, [0, len(sides[0][1])]
    for (x, facets), start in zip(sides, first, strict=True):
        i, j = neighbours(facets)
        smooth = meet_smoothly(unit_normals(x, facets), i, j)
        sharp |= not smooth.all()
        joined.append((start + i[smooth], start + j[smooth]))
    if not sharp:
        return np.zeros(len(pairs[0]), dtype=np.int64)
    joined.append((pairs[0], first[1] + pairs[1]))
    row, col = (np.concatenate(ends) for ends in zip(*joined, strict=True))
    label = connected_parts(row, col, first[1] + len(sides[1][1]))
    return np.unique(label[pairs[0]], return_inverse=True)[1]


def connected_parts(i: Array, j: Array, n: int) -> Array:
    """(n,) number of the connected part of each, where i and j (m,) hang together."""
    graph = coo_matrix((np.ones(len(i)), (i, j)), (n, n))
    found: Array = connected_components(graph, False)[1]
    return found


def meet_smoothly(normals: Array, i: Array, j: Array) -> Array:
    """(n,) whether facets i and j (n,) of these normals meet without a sharp edge."""
    found: Array = np.einsum("ni,ni->n", normals[i], normals[j]) > np.cos(TURN)
    return found


def creased(facets: Array, normals: Array, i: Array, j: Array) -> Array:
    """(n,) whether facets i and j (n,), of all these with unit normals, belong to two flat faces
    with nodes inside of them: no facets of a curve, however far they turn."""
    flat = np.abs(normals[i] - normals[j]).max(axis=1) < STRAIGHT
    face = connected_parts(i[flat], j[flat], len(facets))
    nodes, faces_of = np.unique(
        np.column_stack([facets.ravel(), face.repeat(facets.shape[1])]), axis=0
    ).T
    at, count = np.unique(nodes, return_counts=True)
    inner = np.setdiff1d(at[count == 1], outline_edges(facets))
    broad = np.isin(face, faces_of[np.isin(nodes, inner)])
    return ~flat & broad[i] & broad[j]


def neighbours(facets: Array, by_nodes: bool = False) -> tuple[Array, Array]:
    """Pairs of facets that share an edge (a node of segments, or where ``by_nodes``)."""
    m, k = facets.shape
    if k == 2 or by_nodes:
        key = facets.ravel()
    else:
        ends = np.sort(np.stack([facets, np.roll(facets, -1, axis=1)], axis=2), axis=2)
        key = (ends[..., 0] * (facets.max() + 1) + ends[..., 1]).ravel()
    owner = np.repeat(np.arange(m), k)
    order = np.lexsort((owner, key))
    same = key[order][1:] == key[order][:-1]
    return owner[order][:-1][same], owner[order][1:][same]
