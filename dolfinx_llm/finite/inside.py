"""Which points lie within a closed outline, and how deep bodies went into each other on their way.

An increment that carries a body wholly through another leaves no node behind a facet: what tells of
it are the states between, with all nodes on straight ways.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_llm.geometry.cells import cell_sizes
from dolfinx_llm.geometry.overlap_flat import outline_edges

STRIDE = 0.5  # of a facet, at most, by which nodes move between the states looked at
LOOKED_AT = 100  # states, at most: bodies that go farther are looked at more seldom
ANGLES = 1_000_000  # pairs of points and facets that are looked at together


def winding(x: np.ndarray, y: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """(n,) how often a closed outline goes round points: 1 within it, 0 outside.

    Args:
        x: (n, gdim) points, not on the outline.
        y: (m, gdim) nodes of the outline.
        facets: (f, k) its facets; quads count as two triangles.
    """
    found = np.zeros(len(x))
    if facets.shape[1] == 4:
        facets = np.concatenate([facets[:, [0, 1, 2]], facets[:, [0, 2, 3]]])
    for points in np.array_split(np.arange(len(x)), len(x) * len(facets) // ANGLES + 1):
        a = y[facets] - x[points][:, None, None]  # (p, f, k, gdim)
        if facets.shape[1] == 2:
            (ax, ay), (bx, by) = np.moveaxis(a[:, :, 0], 2, 0), np.moveaxis(a[:, :, 1], 2, 0)
            angle = np.arctan2(ax * by - ay * bx, ax * bx + ay * by)
            found[points] = angle.sum(axis=1) / (2.0 * np.pi)
            continue
        # A. van Oosterom and J. Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125-126.
        size = np.linalg.norm(a, axis=3)
        dots = np.einsum("pfki,pfki->pfk", np.roll(a, -1, axis=2), np.roll(a, -2, axis=2))
        below = size.prod(axis=2) + (dots * size).sum(axis=2)
        volume = np.einsum("pfi,pfi->pf", a[:, :, 0], np.cross(a[:, :, 1], a[:, :, 2]))
        found[points] = 2.0 * np.arctan2(volume, below).sum(axis=1) / (4.0 * np.pi)
    return np.abs(found)


def depth(x: np.ndarray, y: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """(n,) distance of points within a closed outline from its nodes, 0 outside [length].

    Args:
        x, y, facets: as of ``winding``.
    """
    found = np.zeros(len(x))
    near = np.flatnonzero(((x > y.min(axis=0)) & (x < y.max(axis=0))).all(axis=1))
    within = near[winding(x[near], y, facets) > 0.5]
    found[within] = cKDTree(y).query(x[within])[0]
    return found


def deepest(
    x: tuple[np.ndarray, np.ndarray], y: tuple[np.ndarray, np.ndarray], facets: np.ndarray
) -> tuple[np.ndarray, float]:
    """(n,) how deep nodes go into a body on the way to a state, beyond where they were at first,
    and the size of its facets [length].

    Args:
        x: (n, gdim) nodes at the start and at the end [length].
        y: (m, gdim) nodes of the other body's outline then.
        facets: (f, k) of the outline; nothing is found where it is not closed.
    """
    size = float(cell_sizes(y[0], facets).max())
    went = [np.linalg.norm(b - a, axis=1).max(initial=0.0) for a, b in (x, y)]
    if sum(went) < size or len(outline_edges(facets)):
        return np.zeros(len(x[0])), size
    at_first, found = depth(x[0], y[0], facets), np.zeros(len(x[0]))
    for t in np.linspace(0.0, 1.0, min(LOOKED_AT, int(sum(went) / (STRIDE * size))) + 1)[1:]:
        (p, q) = (a + t * (b - a) for a, b in (x, y))
        found = np.maximum(found, depth(p, q, facets))
    return np.where(found > at_first, found, 0.0), size
