"""Facets of different bodies that face each other and lie near, of all bodies at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_llm.geometry.cells import joined_lists, repeated_for, unit, unit_normals
from dolfinx_llm.geometry.surface import Surface

TOUCH = 0.1  # of the larger facet's radius: distance of what touches, where none is given
MEET = (
    1e-6  # of the smaller facet's radius, by which facets in front of each other overlap at least
)
AT_ONCE = 1_000_000  # pairs that are looked at together


@dataclass(frozen=True, eq=False)
class Polygons:
    """Facets as convex polygons."""

    corners: np.ndarray  # (m, k, gdim) in a cycle [length]
    normal: np.ndarray  # (m, gdim) unit, out of the body

    @classmethod
    def of(cls, surface: Surface) -> Polygons:
        """The facets of a surface."""
        x, facets = surface.x, surface.facets
        return cls(x[facets], unit_normals(x, facets))

    @classmethod
    def together(cls, parts: Sequence[Polygons]) -> Polygons:
        """All of several; those with fewer corners repeat their last."""
        most = max(part.corners.shape[1] for part in parts)
        corners = [
            np.concatenate([c, np.repeat(c[:, -1:], most - c.shape[1], axis=1)], axis=1)
            for c in (part.corners for part in parts)
        ]
        return cls(np.concatenate(corners), np.concatenate([part.normal for part in parts]))


def facing_pairs(
    parts: Sequence[Polygons], body: np.ndarray, distance: float | None, angle: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of facets of different bodies, the lower body's first, that face each other.

    Args:
        parts: facets of all meshes.
        body: (m,) of each facet.
        distance: largest [length]; None: ``TOUCH``.
        angle: largest between opposite normals [rad].
    """
    facets = Polygons.together(parts)
    centre = facets.corners.mean(axis=1)
    radius = np.linalg.norm(facets.corners - centre[:, None], axis=2).max(axis=1)
    step = np.log2(radius / radius.min()).astype(int)
    found = [np.zeros((0, 2), dtype=np.int64)]
    for size in np.unique(step):
        group = np.flatnonzero(step == size)
        tree, largest = cKDTree(centre[group]), radius[group].max()
        reach = (
            radius
            + largest
            + (TOUCH * np.maximum(radius, largest) if distance is None else distance)
        )
        counts = tree.query_ball_point(centre, reach, return_length=True)
        ends = np.flatnonzero(np.diff(np.cumsum(counts) // AT_ONCE)) + 1
        for some in np.split(np.arange(len(centre)), ends):
            near = tree.query_ball_point(centre[some], reach[some])
            i, j = repeated_for(some, near), group[joined_lists(near)]
            lower = body[i] < body[j]
            i, j = i[lower], j[lower]
            limit = TOUCH * np.maximum(radius[i], radius[j]) if distance is None else distance
            good = _face(facets, i, j, np.minimum(radius[i], radius[j]), limit, angle)
            found.append(np.column_stack([i[good], j[good]]))
    pairs = np.unique(np.concatenate(found), axis=0)
    return pairs[:, 0], pairs[:, 1]


def _face(
    facets: Polygons, i: np.ndarray, j: np.ndarray, size: np.ndarray, limit: object, angle: float
) -> np.ndarray:
    """(n,) whether facets i and j, the smaller of a size (n,), face each other."""
    good = -np.einsum("ni,ni->n", facets.normal[i], facets.normal[j]) >= np.cos(angle)
    at = np.flatnonzero(good)
    i, j, size = i[at], j[at], size[at]
    limit = np.broadcast_to(np.asarray(limit, dtype=float), good.shape)[at]
    n0, n1 = facets.normal[i], facets.normal[j]
    along = unit(n0 - n1)
    p, q = facets.corners[i], facets.corners[j]
    over, inside = _overlap(p, q, along, MEET * size)
    # The gap along this direction is linear: it is looked at where corners lie over each other.
    gaps = [
        _height(points, across, normal, along) * sign
        for points, across, normal, sign in (
            (q, p[:, 0], n0, 1.0),
            (p, q[:, 0], n1, -1.0),
            (0.5 * (p.mean(axis=1) + q.mean(axis=1))[:, None], p[:, 0], n0, 2.0),
        )
    ]
    gap = np.abs(np.concatenate(gaps, axis=1))
    gap[:, :-1][~inside] = np.inf
    gap[:, -1][inside.any(axis=1)] = np.inf
    good[at] = over & (gap.min(axis=1) <= limit)
    return good


def _height(x: np.ndarray, y: np.ndarray, n: np.ndarray, along: np.ndarray) -> np.ndarray:
    """(n, k) from planes through y (n, gdim) with normals n to points x (n, k, gdim), along a
    direction."""
    return np.einsum("nki,ni->nk", x - y[:, None], n) / np.einsum("ni,ni->n", n, along)[:, None]


def _overlap(
    p: np.ndarray, q: np.ndarray, along: np.ndarray, least: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) whether polygons overlap by more than ``least``, seen along a direction, and (n, 2 k)
    which corners of q, then of p, lie over the other: no axis across an edge separates them."""
    gdim = p.shape[2]
    over = np.ones(len(p), dtype=bool)
    inside = [np.ones(x.shape[:2], dtype=bool) for x in (q, p)]
    for own, other, k in ((p, q, 0), (q, p, 1)):
        if gdim == 2:
            axes = np.stack([-along[:, 1], along[:, 0]], axis=1)[:, None]
        else:
            axes = np.cross(np.roll(own, -1, axis=1) - own, along[:, None])
        length = np.linalg.norm(axes, axis=2)
        for a, size in zip(np.moveaxis(axes, 1, 0), length.T, strict=True):
            there = size > 0.0  # corners that are repeated have no edge
            a = a / np.where(there, size, 1.0)[:, None]
            s, t = (np.einsum("nki,ni->nk", x, a) for x in (own, other))
            low = np.maximum(s.min(axis=1), t.min(axis=1))
            high = np.minimum(s.max(axis=1), t.max(axis=1))
            over &= (high - low > least) | ~there
            within = (t >= s.min(axis=1)[:, None] - least[:, None]) & (
                t <= s.max(axis=1)[:, None] + least[:, None]
            )
            inside[k] &= within | ~there[:, None]
    return over, np.concatenate(inside, axis=1)
