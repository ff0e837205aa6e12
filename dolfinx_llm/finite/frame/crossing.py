"""Facets that cross each other, as at edges that meet between their nodes."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.cells import cell_sizes, unit_normals

STILL_ON = 1e-9  # of a facet beyond its outline: still on it
CROSSED = 0.1  # of a facet: deeper lies what has gone through


def crossing(x: tuple[Array, Array], facets: tuple[Array, Array]) -> tuple[Array, Array, Array]:
    """Which facets of two surfaces cross by more than a tenth of the smaller one: numbers of both
    (n,), (n,), and how deep (n,) [length].

    Args:
        x: (m, gdim) nodes of each [length].
        facets: (f, k) of each.
    """
    if not (len(facets[0]) and len(facets[1])):
        return np.zeros(0, int), np.zeros(0, int), np.zeros(0)
    sizes = [cell_sizes(a, cells) for a, cells in zip(x, facets, strict=True)]
    normals = [unit_normals(a, cells) for a, cells in zip(x, facets, strict=True)]
    trees = [cKDTree(a[cells].mean(axis=1)) for a, cells in zip(x, facets, strict=True)]
    near = trees[0].sparse_distance_matrix(
        trees[1], 0.5 * sum(float(size.max()) for size in sizes), output_type="coo_matrix"
    )
    i, j = near.row, near.col
    both = (x[0][facets[0][i]], x[1][facets[1][j]]), (normals[0][i], normals[1][j])
    depth = depth_through(*both, inside=True)
    through = depth > CROSSED * np.minimum(sizes[0][i], sizes[1][j])
    return i[through], j[through], depth[through]


def depth_through(
    x: tuple[Array, Array], normal: tuple[Array, Array], inside: bool = False
) -> Array:
    """(n,) how deep facets go through each other: the least distance of an edge's ends from the
    facet that it cuts, or by which that lies behind or in front of its own where that is less; 0
    where none does [length].

    Args:
        x: (n, k, gdim) nodes of both [length].
        normal: (n, gdim) unit normals of both.
        inside: no deeper than that place lies within the outline of the facet that is cut: ridges
            that cross are hardly in each other where they cut facets next to each other.
    """
    return np.maximum(_one_through(x, normal, inside), _one_through(x[::-1], normal[::-1], inside))


def _one_through(x: tuple[Array, Array], normal: tuple[Array, Array], inside: bool) -> Array:
    """The same of the edges of the first facets p and the second q."""
    p, q = x
    side = np.roll(q, -1, axis=1) - q
    inward = side if q.shape[2] == 2 else np.cross(normal[1][:, None], side)
    height, across = (
        np.einsum("nki,ni->nk", a - b.mean(axis=1)[:, None], n)
        for a, b, n in zip(x, x[::-1], normal[::-1], strict=True)
    )
    ends = height, np.roll(height, -1, axis=1)
    cut = ends[0] * ends[1] < 0.0
    part = ends[0] / np.where(cut, ends[0] - ends[1], 1.0)
    place = p + part[:, :, None] * (np.roll(p, -1, axis=1) - p)
    each = np.einsum("nkli,nli->nkl", place[:, :, None] - q[:, None], inward)
    within = each.min(axis=2)
    size = np.einsum("nli,nli->nl", inward, inward).max(axis=1)[:, None]
    depth = np.where(cut & (within >= -STILL_ON * size), np.minimum(*np.abs(ends)), 0.0)
    if inside:
        lengths = np.sqrt(np.einsum("nli,nli->nl", inward, inward))
        depth = np.minimum(depth, np.maximum((each / lengths[:, None]).min(axis=2), 0.0))
    both = np.maximum(np.minimum(across.max(axis=1), -across.min(axis=1)), 0.0)
    return np.minimum(depth.max(axis=1, initial=0.0), both)
