"""How far pairs slide along what they touch, in an increment and in a load step.

Slip is objective: sigma_p = x_p - c_p, with c_p the point that p faced at the start of the
increment, carried with what it belongs to, and what counts of it lies in the tangent plane of p
now. A chord it is, not a way along the surface. A pair that was open at the start counts from where
the straight way from there to the iterate that closes it for the first time meets the surface,
c⁰ + theta (c - c⁰) with theta = gap⁰ / (gap⁰ - gap).

What increments of a load step slip adds up; what earlier ones slipped turns and stretches with what
pairs slide on, so that where deformation is homogeneous the sum is the same in any increments.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, summing
from dolfinx_llm.finite.frame.location import OnFrame
from dolfinx_llm.finite.pairs.friction_law import in_plane
from dolfinx_llm.finite.pairs.terms import Held, MovingContact, Origin
from dolfinx_llm.laws.rows import CLOSED, OPEN, SLIP

MET_AT = 1e-9  # gap over facet size at the start that is none
ALMOST = 1e-3  # part of the gap at the start at which a pair has met
CONTINUED = 1e-2  # gap over facet size to the frame's continuation that is none
COMES_IN = 3.0  # facets beyond the rim from where nodes may come in within an increment


class Slides(MovingContact):
    """Contact that knows from where its pairs slide."""

    def started(self, place: Any, held: Held, closed: Array) -> Origin:
        """Where slip counts from, at the start of an increment.

        Args:
            place: of the pairs then.
            held: from the start.
            closed: (n,) pairs that are in contact.
        """
        raise NotImplementedError

    def here(self, place: Any) -> Any:
        """(n, ...) the points that nodes touch now, as ``Origin.points`` are written."""
        raise NotImplementedError

    def way(self, place: Any, origin: Origin) -> tuple[Array, csr_matrix]:
        """(n, gdim) sigma, and its derivative (n gdim, width) [length]."""
        raise NotImplementedError

    def written(self, place: Any, slip: Array) -> Any:
        """Vectors (n, gdim) along the surface as what follows it wherever it goes."""
        raise NotImplementedError

    def read(self, place: Any, written: Any) -> Array:
        """(n, gdim) the vectors where the surface is now."""
        raise NotImplementedError

    def touching(
        self, place: Any, q: Array, before: Array, held: Held, reach: Array
    ) -> tuple[Array, Held]:
        """(n,) status of the pairs, and what is held, with the origin of slip."""
        origin = held.origin or self.started(place, held, before != OPEN)
        status, held = super().touching(place, q, before, held, reach)
        first = (status == CLOSED) & ~origin.touched
        return status, replace(
            held, origin=self.begun(origin, place, first) if first.any() else origin
        )

    def begun(self, origin: Origin, place: Any, first: Array) -> Origin:
        """The same with pairs that are closed for the first time; those that have not met yet, and
        are drawn together, do not begin until they do."""
        nowhere = ~np.isfinite(origin.gap)
        before = np.where(nowhere, 0.0, origin.gap)
        left = np.where(first, place.gap, 0.0)
        closing = before - left
        theta = np.where(closing > 0.0, before / np.where(closing > 0.0, closing, 1.0), 1.0)
        theta = np.where(before > 0.0, np.minimum(theta, 1.0), 0.0)
        theta = np.where(first, np.where(nowhere, 1.0, theta), 0.0)
        points = diagonal(1.0 - theta) @ origin.points + diagonal(theta) @ self.here(place)
        met = left <= ALMOST * before
        met |= before == 0.0
        return replace(origin, points=points, touched=origin.touched | (first & met))

    def off_way(self, place: Any, held: Held, status: Array) -> Array:
        """(n,) by how far slip of pairs that have met in an increment lies off their way in it: it
        counts from where an iterate has met, which may have gone elsewhere [length].

        Args:
            place, held, status: at the end of the increment.
        """
        origin, normal = held.origin, place.normal
        if origin is None or origin.first is None:
            return np.zeros(len(normal))
        ways = (
            self.way(place, replace(origin, points=p))[0] for p in (origin.points, origin.first)
        )
        slip, way = (in_plane(normal, w) for w in ways)
        size = np.einsum("ni,ni->n", way, way)
        part = np.einsum("ni,ni->n", slip, way) / np.where(size > 0.0, size, 1.0)
        off = np.linalg.norm(slip - np.clip(part, 0.0, 1.0)[:, None] * way, axis=1)
        met = origin.touched & (origin.gap > 0.0) & np.isfinite(origin.gap) & (status == SLIP)
        return np.where(met, off, 0.0)

    def slip(self, place: Any, held: Held, since: Array, earlier: Any) -> Array:
        """(n, gdim) how far pairs have gone along what they touch in the load step [length].

        Args:
            place: at the end of an increment.
            held: then.
            since: (n,) pairs of which what they slipped in earlier increments counts.
            earlier: ``written`` at the end of the last of these; None: there is none.
        """
        origin, normal = held.origin, place.normal
        if origin is None:  # tied
            return np.zeros_like(normal)
        total = self.way(place, origin)[0]
        if earlier is not None:
            total = total + since[:, None] * self.read(place, earlier)
        known = place.pairs & (origin.touched | np.isfinite(origin.gap))
        return np.where(known[:, None], in_plane(normal, total), 0.0)


class SlidesOnFrame(Slides):
    """On a frame; points of it are written as rows (n, m)."""

    design: Any

    def located(self, place: Any) -> OnFrame:
        found: OnFrame = place.at
        return found

    def started(self, place: Any, held: Held, closed: Array) -> Origin:
        """Where slip counts from, at the start of an increment; nodes beyond the frame's rim lie on
        its continuation, so that one that comes in knows from where."""
        at, (n, m), C = place.at, place.N.shape, self.sides.control[0]
        near = at.met & (at.beyond < COMES_IN)
        near[place.on] = False
        nodes = np.flatnonzero(near)
        cells = self.sides.carrier.cells[at.facet[nodes]]
        index = np.repeat(nodes, cells.shape[1]), cells.ravel()
        rows = summing(place.on, n) @ place.rows.matrix(m)
        rows = rows + csr_matrix((at.N[nodes].ravel(), index), (n, m))
        near[place.on] = True
        outside = (abs(C) @ ~near == 0.0) & ~place.pairs
        gap = np.where(outside, C @ at.gap, place.gap)
        gap[gap < np.where(outside, CONTINUED, MET_AT) * self.design.size] = 0.0
        points = self.here(place) + diagonal(outside) @ C @ rows
        points = points.tocsr()
        return Origin(points, gap, closed, first=points)

    def here(self, place: Any) -> csr_matrix:
        """(n, m) rows now, of points straight below the pairs. At second order those of control
        values do not lie there where normals turn: each node of which a pair is made is off its own
        row's place along its own normal."""
        if self.design.element.order == 1:
            found: csr_matrix = place.N
            return found
        x, y = self.sides.split(place.z)
        beside = self.sides.control[0] @ x - place.N @ y
        beside = np.where(place.pairs[:, None], in_plane(place.normal, beside), 0.0)
        return (place.N + self.written(place, beside)).tocsr()

    def way(self, place: Any, origin: Origin) -> tuple[Array, csr_matrix]:
        x, y = self.sides.split(place.z)
        way = self.sides.control[0] @ x - origin.points @ y
        return way, self.sides.jumps(origin.points)

    def written(self, place: Any, slip: Array) -> csr_matrix:
        """(n, m) rows D: in the tangent plane sum_J D_pJ y_J is the slip; they are derivatives of
        the shape functions along it."""
        y, cells = self.sides.split(place.z)[1], self.sides.carrier.cells
        return along_facets(place.at, y, cells, place.normal, slip)

    def read(self, place: Any, written: csr_matrix) -> Array:
        return np.asarray(written @ self.sides.split(place.z)[1])


def along_facets(at: OnFrame, y: Array, facets: Array, normal: Array, w: Array) -> csr_matrix:
    """(n, m) rows D by which sum_J D_J y_J is what of vectors w lies in tangent planes: derivatives
    of the shape functions along facets.

    Args:
        at: n places on the facets.
        y: (m, gdim) nodes of these [length].
        facets: (f, k).
        normal: (n, gdim) of the planes.
        w: (n, gdim) [length].
    """
    cells = facets[at.facet]
    edges = np.einsum("nkd,nki->ndi", at.dN, y[cells])
    n, d, gdim = edges.shape
    edges = in_plane(np.repeat(normal, d, axis=0), edges.reshape(-1, gdim)).reshape(n, d, gdim)
    along = np.einsum("nid,ni->nd", np.linalg.pinv(edges), w)
    values = np.einsum("nkd,nd->nk", at.dN, along)
    index = np.repeat(np.arange(n), cells.shape[1]), cells.ravel()
    return csr_matrix((values.ravel(), index), (n, len(y)))
