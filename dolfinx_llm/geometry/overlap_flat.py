"""Common area of two surfaces and the energy-equivalent forces of a constant pressure on it.

Exact to rounding on flat surfaces: facets are clipped with the other surface's outline (Shapely)
and the shape functions integrated over the pieces. Positions are plane coordinates.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.geometry.cells import (
    cross,
    cross_plane,
    facet_vectors,
    gauss,
    outline_edges,
    unit,
)
from dolfinx_llm.geometry.element import element_of
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.geometry.swept import Swept, shape_at, tangents_at

# Along a part of a segment, polynomials of degree 4, and 6 with a thickness, are exact.
_ON_SEGMENT = gauss(4)
# From a facet's origin to an edge: products of two second-order functions, and of one with a square
# of positions, of degree 10 with the Jacobian, are exact.
_TO_CUT = gauss(6)


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane (a line in 2D) with its own axes."""

    origin: Array  # (gdim,) [length]
    base: Array  # (gdim, gdim) rows t1, (t2,) n, right-handed

    @property
    def normal(self) -> Array:
        return self.base[-1]

    def project(self, x: Array) -> Array:
        """(n, gdim) positions to (n, gdim - 1) plane coordinates."""
        return (x - self.origin) @ self.base[:-1].T

    def height(self, x: Array) -> Array:
        """(n,) distance along the normal."""
        return (x - self.origin) @ self.normal

    def lift(self, s: Array) -> Array:
        """(n, gdim - 1) plane coordinates to (n, gdim) positions."""
        return self.origin + s @ self.base[:-1]


def orthonormal_base(normal: Array) -> Array:
    """(gdim, gdim) rows t1, (t2,) n, right-handed, for a unit normal."""
    return local_bases(normal[None])[0]


def local_bases(normals: Array) -> Array:
    """(n, gdim, gdim) rows t1, (t2,) n, right-handed, for unit normals (n, gdim)."""
    if normals.shape[1] == 2:
        return np.stack([np.column_stack([normals[:, 1], -normals[:, 0]]), normals], axis=1)
    axis = np.eye(3)[np.argmin(np.round(np.abs(normals), 12), axis=1)]
    t1 = unit(axis - np.einsum("ni,ni->n", axis, normals)[:, None] * normals)
    return np.stack([t1, cross(normals, t1), normals], axis=1)


def common_plane(side0: Surface, side1: Surface) -> Plane:
    """Plane between two surfaces, its normal from side 0 into side 1; they must face each other."""
    a0, a1 = side0.normal, side1.normal
    n0, n1 = np.linalg.norm(a0), np.linalg.norm(a1)
    if n0 > 0.0 and n1 > 0.0 and a0 @ a1 > 0.5 * n0 * n1:
        raise ContactError(
            f"the outward normals of {side0.name}, {np.round(a0 / n0, 4).tolist()}, and "
            f"{side1.name}, {np.round(a1 / n1, 4).tolist()}, point the same way; surfaces in "
            "contact face each other. Check the tags, and the cells for negative Jacobians"
        )
    # Neither side may be preferred: the difference of the unit normals, the mean of the centres.
    normal = np.subtract(a0 / n0 if n0 > 0.0 else 0.0, a1 / n1 if n1 > 0.0 else 0.0)
    return plane_with(normal, side0, side1)


def plane_with(normal: Array, side0: Surface, side1: Surface) -> Plane:
    """Plane with a normal, of any length, in the middle of what two surfaces share."""
    normal = normal / np.linalg.norm(normal)
    normal[np.abs(normal) < 4e-16] = 0.0
    normal = normal / np.linalg.norm(normal)
    boxes = [(s.x.min(axis=0), s.x.max(axis=0)) for s in (side0, side1)]
    low, high = np.maximum(boxes[0][0], boxes[1][0]), np.minimum(boxes[0][1], boxes[1][1])
    return Plane(0.5 * (low + high), orthonormal_base(normal))


def outline(s: Array, facets: Array) -> Any:
    """Polygon of a flat surface (a set of intervals in 1D), from the edges of one facet only."""
    import shapely  # in space alone, as below

    return shapely.build_area(
        shapely.multilinestrings(shapely.linestrings(s[outline_edges(facets)]))
    )


def full_forces(s: Array, facets: Array) -> Array:
    """(m, k) integrals of each facet's shape functions over it [area]."""
    x = np.column_stack([s, np.zeros(len(s))])
    return np.linalg.norm(facet_vectors(x, facets), axis=2)


def covered_forces(s: Array, facets: Array, area: Any, thickness: Array | None = None) -> Array:
    """(m, k) integrals of the shape functions of facets (m, k) over nodes s (n, 2) over their part
    inside of a polygon; on a line, s (n, 1), inside of an interval, and with a thickness (n,)."""
    if facets.shape[1] == 2:
        depth = None if thickness is None else thickness[facets]
        return _covered_segments(s[facets][..., 0], area, depth)
    forces = np.zeros(facets.shape)
    inside, partial, pieces = _covered_parts(s, facets, area)
    forces[inside] = full_forces(s, facets[inside])
    if len(partial):
        forces[partial] = _integrate_pieces(s[facets[partial]], pieces)
    return forces


def covered_points(s: Array, facets: Array, area: Any) -> list[tuple[Array, Array, Array]]:
    """Quadrature over the part of facets inside of an area, exact for what second-order shape
    functions need on straight facets.

    Args:
        s: (n, d) nodes in coordinates of the plane [length].
        facets: (m, c) their corners.
        area: a polygon; on a line an interval.

    Returns:
        Of facets wholly inside and of others: facets (e,), reference coordinates (e, g, d) and
        weights (e, g) of points on them [area].
    """
    element = element_of(s.shape[1], facets.shape[1])
    xi, w = element.quadrature
    p = s[facets]
    if s.shape[1] == 1:
        part = _covered_segments(p[..., 0], area).sum(axis=1)
        facet = np.flatnonzero(part > 0.0)
        left, right = p[facet, 0], p[facet, 1]
        a, b = ((np.clip(end, *area) - left) / (right - left) for end in (left, right))
        return [(facet, (a + (b - a) * xi[:, 0])[..., None], part[facet, None] * w)]
    inside, partial, pieces = _covered_parts(s, facets, area)
    facet = np.flatnonzero(inside)
    t = np.einsum("gkd,mki->mgdi", element.shape(xi)[1], p[facet])
    weight = np.abs(cross_plane(t[:, :, 0], t[:, :, 1])) * w
    found = [(facet, np.broadcast_to(xi, (len(facet), *xi.shape)), weight)]
    if len(partial):
        cut, points, weight = _piece_points(p[partial], pieces)
        found.append((partial[cut], points, weight))
    return found


def _covered_parts(s: Array, facets: Array, area: Any) -> tuple[Array, Array, Any]:
    """(m,) whether facets (m, k) lie inside of a polygon; (e,) those that do in part, and these
    parts."""
    import shapely

    shapes = shapely.polygons(s[facets])
    shapely.prepare(area)
    inside = shapely.covers(area, shapes)
    partial = np.flatnonzero(~inside)
    partial = partial[shapely.intersects(area, shapes[partial])]
    if not len(partial):
        return inside, partial, shapes[partial]
    pieces = shapely.intersection(shapes[partial], area)
    # What rounding alone can cut off is no contact, and what it leaves is all of a facet.
    rounding = 1e-13 * np.abs(s).max() * shapely.length(shapes[partial])
    covered = shapely.area(pieces)
    whole = shapely.area(shapes[partial]) - covered <= rounding
    inside[partial[whole]] = True
    cut = ~whole & (covered > rounding)
    return inside, partial[cut], pieces[cut]


def _covered_segments(p: Array, interval: tuple[float, float], depth: Array | None = None) -> Array:
    """The same on a line: p (m, 2) end points, with the thickness there."""
    length = p[:, 1] - p[:, 0]
    a, b = ((np.clip(end, *interval) - p[:, 0]) / length for end in (p[:, 0], p[:, 1]))
    part = np.abs(length) * (b - a)
    part[part < 1e-13 * max(np.abs(p).max(), np.abs(length).max())] = 0.0
    if depth is not None:
        t = (a + (b - a) * _ON_SEGMENT[0][:, None])[..., None]
        N = np.concatenate([1.0 - t, t], axis=2)
        weight = _ON_SEGMENT[1][:, None] * np.einsum("gmk,mk->gm", N, depth)
        return part[:, None] * np.einsum("gm,gmk->mk", weight, N)
    middle = 0.5 * (a + b)
    return np.column_stack([part * (1.0 - middle), part * middle])


def _integrate_pieces(p: Array, pieces: Array) -> Array:
    """Integrate shape functions of facets p (m, k, 2) over one piece (polygons) each."""
    facet, xi, weight = _piece_points(p, pieces)
    out = np.zeros(p.shape[:2])
    np.add.at(out, facet, np.einsum("eg,egk->ek", weight, shape_at(p.shape[1], xi)[0]))
    return out


def _piece_points(p: Array, pieces: Array) -> tuple[Array, Array, Array]:
    """Facets (e,), reference coordinates (e, g, 2) and weights (e, g) [area] of points that
    integrate over one piece (polygons) of each of the facets p (m, k, 2), of each edge of it:
    summed with their signs they make up the piece, also when it is not convex or has holes."""
    import shapely

    polygons, owner = shapely.get_parts(pieces, return_index=True)
    keep = shapely.get_type_id(polygons) == 3
    # Exteriors one way round, holes the other.
    rings, polygon = shapely.get_rings(shapely.normalize(polygons[keep]), return_index=True)
    xy, ring = shapely.get_coordinates(rings, return_index=True)
    same = ring[1:] == ring[:-1]
    facet = owner[keep][polygon[ring[:-1][same]]]
    found = Swept.by(p[facet], xy[:-1][same], xy[1:][same], _TO_CUT)
    x, y = tangents_at(shape_at(p.shape[1], found.points)[1], p[facet])
    weight = found.weights * (x[0] * y[1] - x[1] * y[0])
    # Shapely's exterior rings run clockwise after normalize(); the sign of the sum tells.
    total = np.bincount(facet, weight.sum(axis=1), len(p))
    return facet, found.points, np.where(total < 0.0, -1.0, 1.0)[facet, None] * weight


def common_area(side0: Surface, side1: Surface, plane: Plane) -> Any:
    """Area covered by both surfaces, in plane coordinates: a polygon, in 2D an interval, not
    empty."""
    s = [plane.project(side.x) for side in (side0, side1)]
    facets = (side0.facets, side1.facets)
    if s[0].shape[1] == 1:
        ends = [(q[f].min(), q[f].max()) for q, f in zip(s, facets)]
        low, high = max(e[0] for e in ends), min(e[1] for e in ends)
        empty, area = not low < high, (low, high)
    else:
        import shapely

        area = shapely.intersection(*(outline(q, f) for q, f in zip(s, facets)))
        empty = not area.area > 1e-12 * min(side0.diameter, side1.diameter) ** 2
    if empty:
        boxes = [f"{checks.place(q.min(axis=0))} to {checks.place(q.max(axis=0))}" for q in s]
        raise ContactError(
            f"the surfaces {side0.name} and {side1.name} do not overlap: seen along the normal "
            f"{checks.place(plane.normal)} they span {boxes[0]} and {boxes[1]} in the "
            "contact plane. Check tags, positions and units"
        )
    return area


def nodal_forces(side: Surface, s: Array, area: Any, thickness: Array | None = None) -> Array:
    """(n,) energy-equivalent force of unit pressure on ``area`` at each node of a side, of a
    thickness (n,) there [area]."""
    forces = np.zeros(len(side.x))
    np.add.at(forces, side.facets, covered_forces(s, side.facets, area, thickness))
    return forces
