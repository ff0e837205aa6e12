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
    centres = [a[cells].mean(axis=1) for a, cells in zip(x, facets, strict=True)]
    reach = [float(cell_sizes(a, cells).max()) for a, cells in zip(x, facets, strict=True)]
    near = cKDTree(centres[0]).sparse_distance_matrix(
        cKDTree(centres[1]), 0.5 * sum(reach), output_type="coo_matrix"
    )
    i, j = near.row, near.col
    depth, size = depth_through(x, facets, (i, j), inside=True)
    through = depth > CROSSED * size
    return i[through], j[through], depth[through]


def depth_through(
    x: tuple[Array, Array],
    facets: tuple[Array, Array],
    pairs: tuple[Array, Array],
    inside: bool = False,
) -> tuple[Array, Array]:
    """(n,) how deep pairs of facets go through each other: the least distance of an edge's ends
    from the facet that it cuts, or by which that lies behind or in front of its own where that is
    less, 0 where none does; and (n,) the size of the smaller facet [length].

    Args:
        x: (m, gdim) nodes of both surfaces [length].
        facets: (f, k) of each.
        pairs: (n,) numbers of these.
        inside: no deeper than that place lies within the outline of the facet that is cut: ridges
            that cross are hardly in each other where they cut facets next to each other.
    """
    cells = tuple(of[at] for of, at in zip(facets, pairs, strict=True))
    first, second = ((a[c], unit_normals(a, c)) for a, c in zip(x, cells, strict=True))
    sizes = (cell_sizes(a, c) for a, c in zip(x, cells, strict=True))
    both = _one_through(first, second, inside), _one_through(second, first, inside)
    return np.maximum(*both), np.minimum(*sizes)


def _one_through(one: tuple[Array, Array], other: tuple[Array, Array], inside: bool) -> Array:
    """The depth by the edges of the first facets (n, k, gdim) alone; with their unit normals."""
    (p, normal_p), (q, normal_q) = one, other
    side = np.roll(q, -1, axis=1) - q
    inward = side if q.shape[2] == 2 else np.cross(normal_q[:, None], side)
    height, across = (
        np.einsum("nki,ni->nk", a - b.mean(axis=1)[:, None], n)
        for a, b, n in ((p, q, normal_q), (q, p, normal_p))
    )
    ends = height, np.roll(height, -1, axis=1)
    cut = ends[0] * ends[1] < 0.0
    part = ends[0] / np.where(cut, ends[0] - ends[1], 1.0)
    place = p + part[:, :, None] * (np.roll(p, -1, axis=1) - p)
    within = np.einsum("nkli,nli->nkl", place[:, :, None] - q[:, None], inward)
    squares = np.einsum("nli,nli->nl", inward, inward)
    on_it = within.min(axis=2) >= -STILL_ON * squares.max(axis=1)[:, None]
    depth = np.where(cut & on_it, np.minimum(*np.abs(ends)), 0.0)
    if inside:
        depth = np.minimum(depth, np.maximum((within / np.sqrt(squares)[:, None]).min(axis=2), 0.0))
    both = np.maximum(np.minimum(across.max(axis=1), -across.min(axis=1)), 0.0)
    return np.minimum(depth.max(axis=1, initial=0.0), both)
