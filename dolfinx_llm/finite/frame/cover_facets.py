"""What a surface in space covers of another one, exact on clipped facets, with derivatives.

A facet is covered where facets of the other surface lie across, seen along its own normal. Seen
like that they join without gaps, so that what is common to neighbours cancels: facets that are
covered all over know nothing of the others, and integrals over the rest,

    f_J = int_P N_J dA,   df_J = int_P N_J div v dA + int_(edges of the others) N_J (w - v)·nu dl,

need the outline alone. v is the velocity of the facet, w that of the edge. Facets are cut as convex
polygons, many pairs at once, of which each edge knows whose it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import summing
from dolfinx_llm.finite.frame.areas import FacetPlanes, plane_integrals
from dolfinx_llm.finite.frame.covered import Covered
from dolfinx_llm.finite.frame.jacobians import coordinates, jacobian
from dolfinx_llm.geometry.cells import (
    cross_plane,
    gauss,
    joined_lists,
    repeated_for,
)
from dolfinx_llm.geometry.element import Element
from dolfinx_llm.geometry.swept import Swept

OPPOSED = -0.3  # cosine between the normals of facets that lie across, at most
LAYER = 2.0  # distance of facets that lie across, over their sizes, at most
SLIVER = 1e-11  # part of a facet that is none
# From a facet's origin to the edge: polynomials of degree 4, at second order 7, are exact.
_TO_EDGE = {1: gauss(3), 2: gauss(4)}
OWN = -1  # mark of an edge of the polygon that is cut
ON = 1e-12  # distance from a line over the polygon's size that is none


@dataclass(frozen=True, eq=False)
class Clipped:
    """n polygons of up to v corners in a plane, counterclockwise."""

    x: Array  # (n, v, 2); unused places repeat nothing of meaning [length]
    mark: Array  # (n, v) of the edge after each corner: OWN, or the number of the cutting one
    count: Array  # (n,) corners

    @property
    def used(self) -> Array:
        """(n, v) places that hold corners."""
        return np.arange(self.x.shape[1]) < self.count[:, None]

    @property
    def following(self) -> Array:
        """(n, v) place of the next corner."""
        place = np.arange(1, self.x.shape[1] + 1)
        return np.where(place < self.count[:, None], place, 0)

    @property
    def ends(self) -> Array:
        """(n, v, 2) where the edge after each corner ends [length]."""
        return np.take_along_axis(self.x, self.following[:, :, None], axis=1)

    @property
    def area(self) -> Array:
        """(n,)."""
        return 0.5 * np.where(self.used, cross_plane(self.x, self.ends), 0.0).sum(axis=1)


def cut(p: Array, by: Array) -> Clipped:
    """What of polygons p (n, k, 2) lies in convex ones (n, m, 2), all counterclockwise.

    Edges on a line of the cutting polygon count as inside, and stay the polygon's own.
    """
    (n, k, _), m = p.shape, by.shape[1]
    found = Clipped(p, np.full((n, k), OWN), np.full(n, k))
    tolerance = ON * np.abs(p).max(axis=(1, 2), initial=0.0)[:, None]
    for c in range(m):
        found = _behind(found, by[:, c], by[:, (c + 1) % m], c, tolerance)
    return found


def _behind(p: Clipped, a: Array, b: Array, c: int, tolerance: Array) -> Clipped:
    """What lies to the left of the lines from a to b (n, 2), whose edges get the mark c."""
    side = (b - a) / np.maximum(np.linalg.norm(b - a, axis=1), 1e-300)[:, None]
    arm = p.x - a[:, None]
    d = side[:, None, 0] * arm[..., 1] - side[:, None, 1] * arm[..., 0]
    ahead = np.take_along_axis(d, p.following, axis=1)
    inside, then, used = d >= -tolerance, ahead >= -tolerance, p.used
    crosses = used & (inside != then)
    t = np.clip(d / np.where(crosses, d - ahead, 1.0), 0.0, 1.0)
    crossing = p.x + t[:, :, None] * (p.ends - p.x)
    n, v = d.shape
    keep = np.stack([used & inside, crosses], axis=2).reshape(n, 2 * v)
    x = np.stack([p.x, crossing], axis=2).reshape(n, 2 * v, 2)
    mark = np.stack([p.mark, np.where(inside, c, p.mark)], axis=2).reshape(n, 2 * v)
    count = keep.sum(axis=1)
    order = np.argsort(~keep, axis=1, kind="stable")[:, : max(count.max(initial=0), 1)]
    return Clipped(
        np.take_along_axis(x, order[:, :, None], axis=1),
        np.take_along_axis(mark, order, axis=1),
        count,
    )


@dataclass(frozen=True, eq=False)
class Skin:
    """A surface that covers, or is covered, with facets that are straight between corners."""

    x: Array  # (n, 3) nodes [length]
    facets: Array  # (f, k)
    element: Element  # of the j functions that are integrated over what is covered
    used: Array  # (f,) facets that can touch
    first: int  # number of the nodes' first coordinate


def covered_facets(own: Skin, other: Skin, width: int, behind: float) -> Covered:
    """What the other surface covers of a surface.

    Args:
        own, other: in this configuration.
        width: number of all coordinates.
        behind: how far behind a facet another may lie across, over its size.
    """
    planes = FacetPlanes.of(own.x, own.facets, own.element)
    (f, k), n = own.facets.shape, own.element.nodes
    i, j = _across(planes, own, other, behind)
    ends, heights = planes.seen(i, other.x[other.facets[j][:, ::-1]])  # looked at from behind
    low, high = (f(planes.corners[i], axis=1) for f in (np.min, np.max))
    meet = ((ends.min(axis=1) < high) & (ends.max(axis=1) > low)).all(axis=1)
    i, j, ends, heights = i[meet], j[meet], ends[meet], heights[meet]
    pieces = cut(planes.corners[i], ends)
    part = np.bincount(i, pieces.area, f) / planes.size
    whole, at = part > 1.0 - SLIVER, (part > SLIVER) & (part <= 1.0 - SLIVER)
    columns = coordinates(own.facets, 3, own.first)
    share, change = planes.whole()
    share, change = share * whole[:, None], change * whole[:, None, None]
    edges = _Edges.of(pieces, np.flatnonzero(at[i]), i, ends, heights)
    values, blocks = edges.integrals(planes)
    integral = np.zeros((f, n))
    np.add.at(integral, edges.facet, values)
    cutoff = np.flatnonzero(at)
    share[cutoff] = integral[cutoff] / planes.size[cutoff][:, None]
    change[cutoff] = planes.over_size(cutoff, integral[cutoff], np.zeros((len(cutoff), n, 3 * k)))
    nodes = other.facets[j][:, ::-1][edges.pair]
    m = nodes.shape[1]
    clip = np.take_along_axis(nodes, np.stack([edges.mark, edges.mark + 1], axis=1) % m, axis=1)
    places = [columns[edges.facet], coordinates(clip, 3, other.first)]
    by_edge = jacobian(
        blocks / planes.size[edges.facet][:, None, None], np.concatenate(places, axis=1), width
    )
    gather = summing(coordinates(edges.facet[:, None], n).ravel(), f * n)
    return Covered(share, jacobian(change, columns, width) + gather @ by_edge)


def _across(planes: FacetPlanes, own: Skin, other: Skin, behind: float) -> tuple[Array, Array]:
    """Pairs of facets that may lie across each other: (n,) of the surface, (n,) of the other."""
    a, b = np.flatnonzero(own.used), np.flatnonzero(other.used)
    if not len(a) or not len(b):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    theirs = FacetPlanes.of(other.x, other.facets)
    radius = [np.linalg.norm(p.corners, axis=2).max(axis=1) for p in (planes, theirs)]
    far = LAYER * np.sqrt(max(planes.size[a].max(), theirs.size[b].max()))
    reach = np.hypot(radius[0][a] + radius[1][b].max(), far)
    near = cKDTree(theirs.centre[b]).query_ball_point(planes.centre[a], reach)
    i, j = repeated_for(a, near), b[joined_lists(near)]
    arm = theirs.centre[j] - planes.centre[i]
    height = np.einsum("ni,ni->n", planes.normal[i], arm)
    aside = np.linalg.norm(arm - height[:, None] * planes.normal[i], axis=1)
    deep = behind * np.sqrt(np.maximum(planes.size[i], theirs.size[j]))
    good = (-deep < height) & (height < far) & (aside < radius[0][i] + radius[1][j])
    good &= np.einsum("ni,ni->n", planes.normal[i], theirs.normal[j]) < OPPOSED
    return i[good], j[good]


@dataclass(frozen=True, eq=False)
class _Edges:
    """e edges of the covered parts of facets that are covered in part."""

    pair: Array  # (e,) pair of facets that each belongs to
    facet: Array  # (e,) facet that is covered
    a: Array  # (e, 2) where it begins in that facet's plane [length]
    b: Array  # (e, 2) where it ends
    theirs: Array  # (e,) whether it lies on an edge of the other facet
    mark: Array  # (e,) on which one; 0 where it does not
    ends: Array  # (e, 2, 2) ends of that edge [length]
    heights: Array  # (e, 2) of its ends over the plane [length]

    @classmethod
    def of(cls, pieces: Clipped, pairs: Array, i: Array, p: Array, h: Array) -> _Edges:
        """Edges of the pieces of some pairs, whose other facets lie at p (n, m, 2), h (n, m)."""
        row, place = np.nonzero(pieces.used[pairs])
        pair = pairs[row]
        mark = pieces.mark[pair, place]
        theirs, mark = mark != OWN, np.maximum(mark, 0)
        both = np.stack([mark, (mark + 1) % p.shape[1]], axis=1)
        a, b = pieces.x[pair, place], pieces.ends[pair, place]
        which = pair[:, None]
        return cls(pair, i[pair], a, b, theirs, mark, p[which, both], h[which, both])

    def integrals(self, planes: FacetPlanes) -> tuple[Array, Array]:
        """What each edge adds to the integrals (e, j) [area], and its derivatives (e, j, 3 k + 6)
        by the positions of the facet's nodes and of the other edge's ends [length]."""
        corners, k, element = planes.corners[self.facet], planes.facets.shape[1], planes.element
        side = self.b - self.a
        swept = Swept.by(corners, self.a, self.b, _TO_EDGE[element.order])
        x, xi, N = swept.x, swept.xi, swept.N
        values, by_own = plane_integrals(element, corners, swept.points, swept.weights)
        # Their edges move by w = (1 - t) w_a + t w_b against the facet.
        line = self.ends[:, 1] - self.ends[:, 0]
        size = np.maximum(np.einsum("ei,ei->e", line, line), 1e-300)
        t = np.einsum("egi,ei->eg", x - self.ends[:, :1], line) / size[:, None]
        out = np.column_stack([side[:, 1], -side[:, 0]]) * self.theirs[:, None]
        positive = N
        if element.nodes != k:
            positive = element.positive(xi.reshape(-1, 2)).reshape(*xi.shape[:2], element.nodes)
        weighted = swept.along[:, None] * positive
        weighted = np.swapaxes(weighted, 1, 2)
        by_own = by_own - _times(weighted @ N, out)
        shares = np.stack([1.0 - t, t], axis=2)
        by_other = _times(weighted @ shares, out)
        return values, planes.in_space(self.facet, by_own, by_other, self.heights)


def _times(a: Array, v: Array) -> Array:
    """(e, j, k, 2) products of a (e, j, k) with vectors v (e, 2)."""
    return np.asarray(a[..., None] * v[:, None, None, :])
