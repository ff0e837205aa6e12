"""Which facets of two surfaces can touch: those that face each other and lie near, one by one.

Nothing here knows a common plane, so that whole surfaces of bodies may be given, and whatever their
orientation in space the same facets are found. Two facets face each other where their outward
normals are opposite within TURN, one lies in front of the other along the mean of both normals, and
aside of it by no more than a few facets.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.cells import (
    bases,
    cell_sizes,
    joined_lists,
    outline_edges,
    points_of,
    repeated_for,
    vector_areas,
)
from dolfinx_llm.geometry.location import ClosestPoints
from dolfinx_llm.geometry.surface import Surface

TURN = 1.0  # [rad] between facing normals; no two sides of a regular polygon differ by as much
ASIDE = 3.0  # between centres of facing facets, in the sum of their radii
BEYOND = 0.5  # how much farther than the nearest ones facets count, in the smaller surface's radius
BEHIND = 3.0  # how much farther than what is nearest to its partner a facet may lie
NEAREST = 8  # facets that are tried before all within reach are
DEPTH = 1e-9  # of the surface's size: depths below are none
PAIRS = 2_000_000  # of facets that are looked at in one go


@dataclass(frozen=True, eq=False)
class Facets:
    """The facets of a surface as discs."""

    centre: Array  # (m, gdim) [length]
    radius: Array  # (m,) of a ball about the centre that holds the facet [length]
    normal: Array  # (m, gdim) unit, out of the body
    reach: float  # radius of the surface about its own centre [length]

    @classmethod
    def of(cls, surface: Surface) -> Facets:
        """The facets of a surface."""
        p = surface.x[surface.facets]
        centre, area = p.mean(axis=1), vector_areas(surface.x, surface.facets)
        size = np.linalg.norm(area, axis=1)
        middle = size @ centre / size.sum()
        radius = np.linalg.norm(p - centre[:, None], axis=2).max(axis=1)
        reach = np.append(np.linalg.norm(centre - middle, axis=1), radius)  # of one facet its own
        return cls(centre, radius, area / size[:, None], float(reach.max()))


@dataclass(frozen=True, eq=False)
class Facing:
    """Facets of one side that can touch the other."""

    facets: Array  # (k,) ascending numbers
    partner: Array  # (k,) a facet of the other side that each faces


def facing_facets(
    sides: Sequence[Surface], separations: Sequence[Separation]
) -> tuple[Facing, Facing]:
    """The facets of both surfaces that can touch; none at all where nothing faces. Bodies may
    overlap in the drawing."""
    all_facets = [Facets.of(side) for side in sides]
    depth = max(float(s.depth.max()) for s in separations)
    found = []
    for k in (0, 1):
        distance = separations[k].distance[sides[k].facets].mean(axis=1)
        found.append(_Search(all_facets[k], all_facets[1 - k], depth).partners(distance))
    nearest = min(gap.min(initial=np.inf) for _, gap in found)
    limit = nearest + BEYOND * min(f.reach for f in all_facets)
    keep = [np.flatnonzero(np.isfinite(gap) & (gap <= limit)) for _, gap in found]
    out = []
    for k in (0, 1):  # what lies behind another part of the other body cannot be touched
        (partner, gap), (_, other) = found[k], found[1 - k]
        own, across = keep[k], partner[keep[k]]
        sizes = all_facets[k].radius[own] + all_facets[1 - k].radius[across]
        seen = own[gap[own] <= BEHIND * np.maximum(other[across], 0.0) + 2.0 * sizes]
        out.append(Facing(seen, partner[seen]))
    return out[0], out[1]


class _Search:
    """Finds for facets one of the other side that they face."""

    def __init__(self, own: Facets, other: Facets, depth: float):
        self.own, self.other, self.depth = own, other, depth
        step = np.log2(other.radius / other.radius.min()).astype(int)
        self.sizes = [np.flatnonzero(step == k) for k in np.unique(step)]
        self.trees = [cKDTree(other.centre[group]) for group in self.sizes]
        self.partner = np.full(len(own.centre), -1)
        self.gap = np.full(len(own.centre), np.inf)
        self.apart = np.full(len(own.centre), np.inf)  # of its partner, see ``_gaps``

    def partners(self, distance: Array) -> tuple[Array, Array]:
        """(m,) partner of each facet, -1 for none, and the gap between them, from each facet's
        distance (m,) to the other surface."""
        own, other = self.own, self.other
        everywhere, tries = cKDTree(other.centre), min(NEAREST, len(other.centre))
        for ahead in (0.0 * distance, distance):  # most face one of those next to them
            rest = np.flatnonzero(self.partner < 0)
            points = own.centre[rest] + ahead[rest, None] * own.normal[rest]
            near = everywhere.query(points, k=tries)[1]
            self._try(np.repeat(rest, tries), near.ravel())
        span = np.linalg.norm(own.centre.mean(axis=0) - other.centre.mean(axis=0))
        span += own.reach + other.reach
        low = np.zeros(len(own.centre))
        high = 2.0 * own.radius
        while True:  # farther and farther ahead of those that have found none
            limit = min(span, self.gap.min() + BEYOND * min(own.reach, other.reach))
            rest = np.flatnonzero((self.partner < 0) & (low <= limit))
            if not len(rest):
                return self.partner, self.gap
            self._look_ahead(rest, low[rest], high[rest])
            low[rest], high[rest] = high[rest], 1.5 * high[rest]

    def _look_ahead(self, facet: Array, low: Array, high: Array) -> None:
        """Try all facets of the other side with a gap between two bounds."""
        first = low == 0.0
        middle = np.where(first, 0.0, 0.5 * (low + high))
        # The mean of two normals is off one of them by at most TURN / 2, and what is across, too.
        sine = np.sin(0.5 * TURN)
        lean = (2.0 * np.sin(0.25 * TURN) + sine / (1.0 - sine)) * high
        around = np.where(first, 2.0 * high + self.depth, 0.5 * (high - low) + lean)
        points = self.own.centre[facet] + middle[:, None] * self.own.normal[facet]
        for group, tree in zip(self.sizes, self.trees):
            largest = self.other.radius[group].max()
            reach = around + ASIDE * (self.own.radius[facet] + largest) / (1.0 - sine)
            for some in _portions(tree.query_ball_point(points, reach, return_length=True)):
                near = tree.query_ball_point(points[some], reach[some])
                self._try(repeated_for(facet[some], near), group[joined_lists(near)])

    def _try(self, facet: Array, other: Array) -> None:
        """Keep the nearest of the facets that face each other, of pairs (n,), (n,)."""
        gap, apart = self._gaps(facet, other)
        good = np.flatnonzero(np.isfinite(gap))
        order = good[np.lexsort((apart[good], facet[good]))]
        first = order[np.unique(facet[order], return_index=True)[1]]
        first = first[apart[first] < self.apart[facet[first]]]
        at = facet[first]
        self.partner[at], self.gap[at], self.apart[at] = other[first], gap[first], apart[first]

    def _gaps(self, facet: Array, other: Array) -> tuple[Array, Array]:
        """(n,) gap between facets along the mean of their normals, inf where they do not face, and
        how far the facet's centre is from the other facet.

        The gap alone does not choose: a neighbour of the facet across has none where both lean to
        each other by the same angle.
        """
        n0, n1 = self.own.normal[facet], self.other.normal[other]
        d = self.other.centre[other] - self.own.centre[facet]
        cosine = -np.einsum("ni,ni->n", n0, n1)
        good = cosine > np.cos(TURN)
        m = n0 - n1
        m /= np.maximum(np.linalg.norm(m, axis=1), 1e-300)[:, None]
        gap = np.einsum("ni,ni->n", d, m)
        aside = np.linalg.norm(d - gap[:, None] * m, axis=1)
        sizes = self.own.radius[facet] + self.other.radius[other]
        # Along either normal a facet is across, and of facets that lean these are two directions.
        lean = np.linalg.norm(d, axis=1) * np.sqrt(np.maximum(0.5 * (1.0 - cosine), 0.0))
        good &= aside <= ASIDE * sizes + lean
        # Each has a point in front of the other's plane, or no deeper than bodies overlap.
        sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
        deepest = -1.001 * self.depth - 1e-6 * sizes
        good &= np.einsum("ni,ni->n", d, n0) + self.other.radius[other] * sine >= deepest
        good &= self.own.radius[facet] * sine - np.einsum("ni,ni->n", d, n1) >= deepest
        beside = np.maximum(aside - self.other.radius[other], 0.0)
        return np.where(good, gap, np.inf), np.hypot(gap, beside)


def _portions(counts: Array) -> Iterator[Array]:
    """Numbers 0, 1, ... in portions whose counts add up to no more than PAIRS, or of one."""
    total = np.cumsum(counts)
    yield from np.split(np.arange(len(counts)), np.flatnonzero(np.diff(total // PAIRS)) + 1)


@dataclass(frozen=True, eq=False)
class Separation:
    """The nodes of one side against the other surface; n nodes."""

    distance: Array  # (n,) from the closest point of the other surface [length]
    depth: Array  # (n,) how deep each lies inside of the other body, 0 outside [length]
    over: Array  # (n,) whether its closest point is inside of a facet, not at an edge
    size: Array  # (n,) of the facets there, the larger of both sides' [length]


def separation(side: Surface, other: Surface) -> Separation:
    """Where the nodes of a side lie against the other surface, as drawn. A node lies inside where
    the closest point is inside of a facet and in front of it. Of an open surface nobody knows how
    thick its body is: there that point must lie inside of the own body, too."""
    height, distance, y, cell, inner = _heights(side.x, other)
    size = np.maximum(facet_sizes(side), cell_sizes(other.x, other.facets)[cell])
    inside = np.flatnonzero(inner & (height < -DEPTH * other.diameter))
    if len(inside) and len(outline_edges(other.facets)):
        inside = inside[_heights(y[inside], side)[0] < 0.0]
    depth = np.zeros(len(side.x))
    depth[inside] = -height[inside]
    return Separation(distance, depth, inner, size)


def _heights(x: Array, surface: Surface) -> tuple[Array, ...]:
    """Of points their height over the closest facet, distance, closest point, its facet and whether
    it lies inside of it."""
    at = ClosestPoints(surface.x, surface.facets).locate(x)
    _, y, tangents = points_of(surface.x, surface.facets[at.cell], at.xi)
    height = np.einsum("ni,ni->n", x - y, bases(tangents)[:, -1])
    return height, np.linalg.norm(x - y, axis=1), y, at.cell, at.outside <= 0.0


def facet_sizes(surface: Surface) -> Array:
    """(n,) size of the largest facet at each node [length]."""
    size = np.zeros(len(surface.x))
    of = cell_sizes(surface.x, surface.facets)
    np.maximum.at(size, surface.cells, of[:, None])
    return size
