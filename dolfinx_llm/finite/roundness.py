"""Gaps to a curved frame, which stands out beyond its facets: by its nodal normals.

With y(xi) = sum_J N_J y_J on a facet, and n_J the averaged normals of its nodes,

    s(xi) = 1/2 sum_J N_J n_J·(y_J - y(xi)):

half of what planes across n_J through the nodes stand out in the mean, exact where the surface is
quadratic, and 0 on flat facets. Its slope is -n·y' but for what curvature varies: forces along n do
as good as no work where a node slides along the frame. Nodes count about which the frame is drawn
curved: what is drawn flat bends at rims of contact most, where it is not smooth.

Designed rows pass forces, and move with the frame; where they say a node is they miss the frame by
as much as s, since they reproduce planes alone. So where nodes count a gap is that to the frame
itself, on which N_0 places the node:

    gap = n·(x - sum_J N_J y_J) + w n·sum_J (N - N_0)_J y_J - s,

w the sum of N_0J over the nodes J that count.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, per_item, summing
from dolfinx_llm.finite.jacobians import NodalNormals, coordinates, jacobian
from dolfinx_llm.finite.location import LocationDerivatives, OnFrame
from dolfinx_llm.geometry.cells import unit, vector_areas
from dolfinx_llm.geometry.overlap_flat import outline_edges

CURVES, SHARP = 1e-3, np.pi / 6  # angles of facets with the mean about a node, where it is curved
HARDLY_TOLD = 1e-6  # of the largest share in a fit: directions that it tells no slope along


def rounded_gap(
    at: OnFrame,
    d: LocationDerivatives,
    y: Array,
    facets: Array,
    normals: NodalNormals,
    rounded: Array,
    columns: tuple[Array, int, int],
    by_rows: Array,
) -> tuple[Array, Array, csr_matrix]:
    """(n,) gaps at places on a frame [length], (n,) w, and (n, width) their derivative by all
    coordinates but for 1 - w times that of what rows say.

    Args:
        at, d: the places, and how they change.
        y: (m, gdim) the frame's nodes [length].
        facets: (f, k) its facets.
        normals: of its nodes.
        rounded: (m,) nodes that count.
        columns: numbers (n, gdim) of the nodes' coordinates, of the frame's first, and of all.
        by_rows: (n,) n·(x - sum_J N_J y_J) with the designed rows [length].
    """
    cells, (of_x, first, width) = facets[at.facet], columns
    (n, k), gdim, count = at.N.shape, y.shape[1], rounded[cells]
    on_frame = coordinates(cells, gdim, first)
    # How far the frame stands out.
    nn = normals.n[cells] * count[:, :, None]
    arm = y[cells] - np.einsum("nk,nki->ni", at.N, y[cells])[:, None]
    stands = np.einsum("nki,nki->nk", nn, arm)
    mean = np.einsum("nk,nki->ni", at.N, nn)
    slope = np.einsum("nkd,nk->nd", at.dN, stands)
    slope -= np.einsum("ni,nkd,nki->nd", mean, at.dN, y[cells])
    by_n = (at.N * count)[:, :, None] * arm
    by_y = at.N[:, :, None] * (nn - mean[:, None])
    turned = jacobian(by_n.reshape(n, 1, k * gdim), coordinates(cells, gdim), y.size)
    moved = jacobian(by_y.reshape(n, 1, k * gdim), on_frame, width)
    s_z = 0.5 * (turned @ normals.derivative + moved + per_item(slope[:, None]) @ d.xi)
    gap = by_rows - 0.5 * np.einsum("nk,nk->n", at.N, stands)
    if not count.any():
        return gap, np.zeros(n), -s_z
    # What rows miss of it.
    w, apart = np.einsum("nk,nk->n", at.N, count), at.gap - by_rows
    slope = -np.einsum("ni,nkd,nki->nd", at.normal, at.dN, y[cells])
    by_y = -at.N[:, :, None] * at.normal[:, None]
    moved = jacobian(by_y.reshape(n, 1, k * gdim), on_frame, width)
    to_frame = jacobian(at.normal[:, None], of_x, width) + moved + per_item(slope[:, None]) @ d.xi
    fades = per_item(np.einsum("nkd,nk->nd", at.dN, count)[:, None]) @ d.xi
    return gap + w * apart, w, diagonal(w) @ to_frame + diagonal(apart) @ fades - s_z


def drawn_curved(x: Array, facets: Array) -> tuple[csr_matrix, Array]:
    """(m, f) weights of the facets' vector areas in nodal normals, and (m,) the nodes about which a
    surface is drawn curved and has no edge.

    A node's normal is that of the facets around; at the outline of what is drawn curved, which has
    facets on one side alone, that of ``_continued``.

    Args:
        x: (m, gdim) nodes as drawn [length].
        facets: (f, k) their facets.
    """
    (f, k), m = facets.shape, len(x)
    each = np.repeat(np.arange(f), k)
    around = csr_matrix((np.ones(f * k), (facets.ravel(), each)), (m, f))
    area = vector_areas(x, facets)

    def angles(weights: csr_matrix) -> Array:
        normal, mean, most = unit(area), unit(weights @ area), np.zeros(m)
        np.maximum.at(most, facets, np.linalg.norm(mean[facets] - normal[:, None], axis=2))
        return most

    angle = angles(around)
    bent = around @ (around.T @ (angle > CURVES)) > 0.0
    outline = np.isin(np.arange(m), outline_edges(facets))
    deep = around @ (around.T @ ~outline) > 0.0  # else facets about it tell no slope inwards
    rim = np.flatnonzero(outline & deep & bent & (angle < SHARP))
    if len(rim):
        own = _continued(rim, x, facets, around, angle < SHARP)
        kept = diagonal(~np.isin(np.arange(m), rim) + 0.0)
        around = (kept @ around + summing(rim, m) @ own).tocsr()
        angle = angles(around)
    return around, (angle > CURVES) & (angle < SHARP)


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
