"""Surfaces of first order that are drawn curved: normals at their nodes; sharp edges."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, summing
from dolfinx_llm.geometry.cells import (
    facets_around,
    outline_edges,
    unit,
    unit_normals,
    vector_areas,
)
from dolfinx_llm.geometry.neighbours import neighbours

CURVES, SHARP = 1e-3, np.pi / 6  # angles of facets with the mean about a node, where it is curved
STANDS_OUT = 2.0  # times as sharp as what bends the same way beside it, or SHARP: an edge
LEAST_EDGE = 0.2  # angle: normals that are rounded off lean by half of it
BENT_ALONE = 3.0  # times as sharp as all that bends beside it
HARDLY_TOLD = 1e-6  # of the largest share in a fit: directions that it tells no slope along


def drawn_curved(x: Array, facets: Array) -> tuple[csr_matrix | None, Array]:
    """(m, f) weights of the facets' vector areas in nodal normals, None: of those around alike; and
    (m,) the nodes about which a surface is drawn curved and has no edge.

    A node's normal is that of the facets around; at the outline of what is drawn curved, which has
    facets on one side alone, that of ``_continued``.

    Args:
        x: (m, gdim) nodes as drawn [length].
        facets: (f, k) their facets.
    """
    m, area = len(x), vector_areas(x, facets)
    around = facets_around(facets, m)

    def angles(weights: csr_matrix) -> Array:
        normal, mean, most = unit(area), unit(weights @ area), np.zeros(m)
        np.maximum.at(most, facets, np.linalg.norm(mean[facets] - normal[:, None], axis=2))
        return most

    angle, weights = angles(around), None
    bent = around @ (around.T @ (angle > CURVES)) > 0.0
    outline = np.isin(np.arange(m), outline_edges(facets))
    deep = around @ (around.T @ ~outline) > 0.0  # else facets about it tell no slope inwards
    rim = np.flatnonzero(outline & deep & bent & (angle < SHARP))
    if len(rim):
        own = _continued(rim, x, facets, around, angle < SHARP)
        kept = diagonal(~np.isin(np.arange(m), rim) + 0.0)
        weights = (kept @ around + summing(rim, m) @ own).tocsr()
        angle = angles(weights)
    return weights, (angle > CURVES) & (angle < SHARP)


def angles_between(x: Array, facets: Array) -> tuple[Array, Array, Array]:
    """(e,) pairs i and j of facets (f, k) that are neighbours, and the angle between their normals,
    for nodes x (m, gdim)."""
    normal, (i, j) = unit_normals(x, facets), neighbours(facets)
    return i, j, np.arccos(np.clip(np.einsum("ni,ni->n", normal[i], normal[j]), -1.0, 1.0))


def edges(x: Array, facets: Array) -> tuple[Array, Array, Array, Array]:
    """Pairs as of ``angles_between``, and (e,) whether an edge is between them: they meet by far
    sharper than others next to them, as facets of a round surface, however coarse, meet at like
    angles. Next to a pair are those of its facets, and of facets beside these but for those with a
    node of what the pair shares, along which it may go on."""
    i, j, angle = angles_between(x, facets)
    e, edge, bent = len(angle), np.zeros(len(angle), dtype=bool), np.flatnonzero(angle > LEAST_EDGE)
    if not len(bent):
        return i, j, angle, edge
    centre = x[facets].mean(axis=1)
    out = np.einsum("ei,ei->e", centre[j] - centre[i], unit_normals(x, facets)[i]) < 0.0
    of = csr_matrix((np.ones(2 * e), (np.tile(np.arange(e), 2), np.append(i, j))), (e, len(facets)))
    around = facets_around(facets, len(x)).T.tocsr()
    shared, beside = around[i].multiply(around[j]).tocsr(), of[bent] @ of.T
    far, along = (beside @ of @ of.T).tocoo(), (shared[bent] @ shared.T).tocoo()
    number = [M.row.astype(np.int64) * e + M.col for M in (far, along)]
    beside, apart = beside.tocoo(), ~np.isin(*number)
    row, other = np.append(beside.row, far.row[apart]), np.append(beside.col, far.col[apart])
    row, other = row[other != bent[row]], other[other != bent[row]]
    most, alike, size = *np.zeros((2, len(bent))), np.minimum(angle, SHARP)
    np.maximum.at(most, row, size[other])
    np.maximum.at(alike, row, np.where(out[other] == out[bent[row]], size[other], 0.0))
    amid = np.bincount(row, minlength=len(bent)) > 1  # others beside it tell: it is no arc
    edge[bent] = amid & (angle[bent] > np.maximum(LEAST_EDGE, BENT_ALONE * most))
    edge[bent] |= angle[bent] > np.maximum(SHARP, STANDS_OUT * alike)
    return i, j, angle, edge


def _continued(
    rim: Array, x: Array, facets: Array, around: csr_matrix, smooth: Array
) -> csr_matrix:
    """(r, f) weights in the normals of nodes (r,) at the outline: of the linear function along the
    surface that fits unit normals of the facets about them best, the value at the node.

    Args:
        around: (m, f) which facets lie around a node.
        smooth: (m,) nodes over which the surface goes on without an edge.
    """
    near = (around[rim] @ around.T @ diagonal(1.0 * smooth) @ around).tocsr()
    at, area = np.repeat(np.arange(len(rim)), np.diff(near.indptr)), vector_areas(x, facets)
    normal = unit(around[rim] @ area)[at]
    s = x[facets].mean(axis=1)[near.indices] - x[rim][at]
    s -= np.einsum("ei,ei->e", s, normal)[:, None] * normal
    size = np.sqrt(np.bincount(at, np.einsum("ei,ei->e", s, s)) / np.bincount(at))
    p = np.column_stack([np.ones(len(s)), s / size[at][:, None]])
    fit = np.zeros((len(rim), p.shape[1], p.shape[1]))
    np.add.at(fit, at, p[:, :, None] * p[:, None, :])
    value = np.linalg.pinv(fit, rcond=HARDLY_TOLD, hermitian=True)[:, 0]
    near.data = np.einsum("ei,ei->e", value[at], p) / np.linalg.norm(area, axis=1)[near.indices]
    return near
