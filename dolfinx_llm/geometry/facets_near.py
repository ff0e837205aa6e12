"""Facets of different bodies that face each other and lie near, of all bodies at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.cells import joined_lists, repeated_for, unit, unit_normals
from dolfinx_llm.geometry.surface import Surface

TOUCH = 0.1  # of the larger facet's radius: distance of what touches, where none is given
MEET = (
    1e-6  # of the smaller facet's radius, by which facets in front of each other overlap at least
)
AT_ONCE = 1_000_000  # pairs that are looked at together
PARALLEL = 1e-9  # sine below which edges do not cross
STEEP = 0.1  # cosine below which a facet stands on edge


@dataclass(frozen=True, eq=False)
class Polygons:
    """Facets as convex polygons."""

    corners: Array  # (m, k, gdim) in a cycle [length]
    normal: Array  # (m, gdim) unit, out of the body

    @cached_property
    def ball(self) -> tuple[Array, Array]:
        """Centres (m, gdim) and radii (m,) of balls that hold the facets [length]."""
        centre = self.corners.mean(axis=1)
        return centre, np.linalg.norm(self.corners - centre[:, None], axis=2).max(axis=1)

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


@dataclass(frozen=True, eq=False)
class Across:
    """Where two facets of n pairs are in front of each other."""

    along: Array  # (n, gdim) direction, out of the first facet into the second
    x: Array  # (n, gdim) the middle of what they share, halfway between them [length]
    gap: Array  # (n,) there [length]


def facing_pairs(
    parts: Sequence[Polygons],
    body: Array,
    distance: float | None,
    angle: float,
    seen: bool = False,
) -> tuple[Array, Array]:
    """Pairs of facets of different bodies, the lower body's first, that face each other.

    Args:
        parts: facets of all meshes.
        body: (m,) of each facet.
        distance: largest [length]; None: ``TOUCH``.
        angle: largest between opposite normals [rad].
        seen: leave out pairs between which there are other facets, as of a thin plate.
    """
    facets = Polygons.together(parts)
    centre, radius = facets.ball
    found = [np.zeros((0, 2), dtype=np.int64)]

    def reach(largest: float) -> Array:
        most = TOUCH * np.maximum(radius, largest) if distance is None else distance
        return np.asarray(radius + largest + most)

    for i, j in _near(facets, centre, reach):
        lower = body[i] < body[j]
        i, j = i[lower], j[lower]
        limit = TOUCH * np.maximum(radius[i], radius[j]) if distance is None else distance
        good, across = _face(facets, i, j, np.minimum(radius[i], radius[j]), limit, angle)
        i, j = i[good], j[good]
        if seen:
            shows = ~_hidden(facets, body, i, j, across)
            i, j = i[shows], j[shows]
        found.append(np.column_stack([i, j]))
    pairs = np.unique(np.concatenate(found), axis=0)
    return pairs[:, 0], pairs[:, 1]


def _near(
    facets: Polygons, x: Array, reach: Callable[[float], Array]
) -> Iterator[tuple[Array, Array]]:
    """Points (n, gdim) and facets, some pairs at a time, whose centres are within the reach (n,),
    told for facets of a largest radius."""
    centre, radius = facets.ball
    step = np.log2(radius / radius.min()).astype(int)
    for size in np.unique(step):
        group = np.flatnonzero(step == size)
        tree, within = cKDTree(centre[group]), reach(float(radius[group].max()))
        counts = tree.query_ball_point(x, within, return_length=True)
        ends = np.flatnonzero(np.diff(np.cumsum(counts) // AT_ONCE)) + 1
        for some in np.split(np.arange(len(x)), ends):
            near = tree.query_ball_point(x[some], within[some])
            yield repeated_for(some, near), group[joined_lists(near)]


def _face(
    facets: Polygons, i: Array, j: Array, size: Array, limit: object, angle: float
) -> tuple[Array, Across]:
    """(n,) whether facets i and j, the smaller of a size (n,), face each other; and where those
    that do."""
    good = -np.einsum("ni,ni->n", facets.normal[i], facets.normal[j]) >= np.cos(angle)
    at = np.flatnonzero(good)
    i, j, size = i[at], j[at], size[at]
    limit = np.broadcast_to(np.asarray(limit, dtype=float), good.shape)[at]
    along = unit(facets.normal[i] - facets.normal[j])
    p, q = facets.corners[i], facets.corners[j]
    over, inside = _overlap(p, q, along, MEET * size)
    # The gap along this direction is linear: it is looked at where the shared part has corners.
    up = _height(q, p[:, 0], facets.normal[i], along)
    down = _height(p, q[:, 0], facets.normal[j], along)
    x = [q - 0.5 * up[:, :, None] * along[:, None], p - 0.5 * down[:, :, None] * along[:, None]]
    gap, there = [up, -down], [inside]
    if p.shape[2] == 3:
        y, apart, cross = _crossings(p, q, along)
        x, gap, there = [*x, y], [*gap, apart], [*there, cross]
    x, gap, there = (np.concatenate(a, axis=1) for a in (x, gap, there))
    faces = over & (np.where(there, np.abs(gap), np.inf).min(axis=1) <= limit)
    good[at] = faces
    x, gap, there = x[faces], gap[faces], there[faces]
    share = there / there.sum(axis=1)[:, None]
    middle = np.einsum("nk,nki->ni", share, x)
    return good, Across(along[faces], middle, np.einsum("nk,nk->n", share, gap))


def _crossings(p: Array, q: Array, along: Array) -> tuple[Array, Array, Array]:
    """Where edges of polygons cross, seen along a direction: (n, k k) points halfway, gaps, and
    whether they do."""
    d, e = (np.roll(x, -1, axis=1) - x for x in (p, q))
    n, k, gdim = p.shape
    shape = n, k, q.shape[1], gdim
    d, e = np.broadcast_to(d[:, :, None], shape), np.broadcast_to(e[:, None], shape)
    start, way = p[:, :, None], q[:, None] - p[:, :, None]

    def turn(a: Array, b: Array) -> Array:
        return np.asarray(np.einsum("nabi,ni->nab", np.cross(a, b), along))

    det = turn(d, e)
    skew = np.abs(det) > PARALLEL * np.linalg.norm(d, axis=3) * np.linalg.norm(e, axis=3)
    det = np.where(skew, det, 1.0)
    s, t = turn(way, e) / det, turn(way, d) / det
    on_p, on_q = start + s[..., None] * d, q[:, None] + t[..., None] * e
    cross = skew & (np.abs(s - 0.5) <= 0.5) & (np.abs(t - 0.5) <= 0.5)
    gap = np.einsum("nabi,ni->nab", on_q - on_p, along)
    flat = n, k * q.shape[1]
    return (0.5 * (on_p + on_q)).reshape(*flat, gdim), gap.reshape(flat), cross.reshape(flat)


def _hidden(facets: Polygons, body: Array, i: Array, j: Array, across: Across) -> Array:
    """(n,) whether other facets lie between facets i and j, on the line across the middle of what
    these share: those of a third body, or the far sides of bodies that are thinner than they seem
    to overlap."""
    radius = facets.ball[1]
    size = MEET * np.minimum(radius[i], radius[j])
    hidden = np.zeros(len(i), dtype=bool)
    some = np.flatnonzero(np.abs(across.gap) > size)
    half = 0.5 * np.abs(across.gap[some]) + size[some]
    for at, k in _near(facets, across.x[some], lambda largest: half + largest):
        pair = some[at]
        other = (k != i[pair]) & (k != j[pair])
        other &= np.abs(np.einsum("ni,ni->n", facets.normal[k], across.along[pair])) > STEEP
        pair, k = pair[other], k[other]
        x, along = across.x[pair][:, None], across.along[pair]
        corners, normal = facets.corners[k], facets.normal[k]
        inside = _overlap(corners, x, along, size[pair])[1][:, 0]
        place = -_height(x, corners[:, 0], normal, along)[:, 0]
        end, sense = 0.5 * across.gap[pair], np.einsum("ni,ni->n", normal, along)
        between = np.abs(place) < np.abs(end) - size[pair]
        # A third body that touches one of both, in front of it.
        third = (body[k] != body[i[pair]]) & (body[k] != body[j[pair]]) & (end > 0.0)
        touches = np.abs(np.abs(place) - end) <= size[pair]
        between |= third & touches & (place * sense > 0.0)
        hidden[pair[inside & between]] = True
    return hidden


def _height(x: Array, y: Array, n: Array, along: Array) -> Array:
    """(n, k) from planes through y (n, gdim) with normals n to points x (n, k, gdim), along a
    direction."""
    return np.asarray(
        np.einsum("nki,ni->nk", x - y[:, None], n) / np.einsum("ni,ni->n", n, along)[:, None]
    )


def _overlap(p: Array, q: Array, along: Array, least: Array) -> tuple[Array, Array]:
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
