"""Area that two curved surfaces share, as vector areas of their nodes (design, 2 'Vector form').

Each surface keeps its own facets: a facet is covered where its points project onto the other
surface along its own normal. Only facets at the other's outline are clipped, each in its own
tangent plane (Shapely); closed surfaces have no outline.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.geometry.cells import bases, facet_vectors, outline_edges, unit_normals
from dolfinx_llm.geometry.facing import Facets
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.overlap_flat import covered_forces, orthonormal_base
from dolfinx_llm.geometry.surface import Surface

FACING = -0.5  # cosine between the outward normals of facets that face each other, at most
FARTHEST = 0.5  # distance between the surfaces, in facets, at most


def is_flat(surface: Surface, tolerance: float) -> bool:
    """Whether all nodes lie within ``tolerance`` [length] along some direction."""
    x = surface.x - surface.x.mean(axis=0)
    normal = np.linalg.svd(x, full_matrices=False)[2][-1]
    return bool(np.ptp(x @ normal) <= tolerance)


def vector_areas_in_contact(side0: Surface, side1: Surface, may_part: bool = False) -> list[Array]:
    """Per side (n_i, gdim) vector areas a_p of its nodes, out of it, over what both surfaces cover:
    zero at nodes without contact [area]. They lie no more than FARTHEST facets apart, but where
    they may part.

    Raises:
        ContactError: the surfaces face the same way, lie too far apart, or do not overlap.
    """
    reach = np.inf if may_part else FARTHEST
    vectors = [_covered(side, other, reach) for side, other in ((side0, side1), (side1, side0))]
    require_overlap((side0, side1), vectors)
    return vectors


def require_overlap(sides: Sequence[Surface], vectors: Sequence[Array]) -> None:
    """Refuse sides whose vector areas in contact (n_i, gdim) are none."""
    if all(np.abs(a).any() for a in vectors):
        return
    side, other = sides
    boxes = [
        f"{checks.place(s.x.min(axis=0))} to {checks.place(s.x.max(axis=0))}" for s in (side, other)
    ]
    raise ContactError(
        f"the surfaces {side.name} and {other.name} do not overlap: no facet of one projects onto "
        f"the other. They span {boxes[0]} and {boxes[1]}. Check tags, positions and units"
    )


def _covered(side: Surface, other: Surface, reach: float) -> Array:
    """(n, gdim) vector areas of a side's nodes over what the other covers."""
    p, normal = side.x[side.facets], unit_normals(side.x, side.facets)
    whole, cut = covered_facets(side, other, reach)
    vectors = np.zeros(p.shape)
    vectors[whole] = facet_vectors(side.x, side.facets[whole], side.thickness)
    cell = np.arange(p.shape[1])[None, :]
    for f, s, pieces in cut:
        depth = None if side.thickness is None else side.thickness[side.facets[f]]
        part = np.sum([covered_forces(s, cell, piece, depth) for piece in pieces], axis=0)
        vectors[f] = part[0][:, None] * normal[f]
    a = np.zeros_like(side.x)
    np.add.at(a, side.facets, vectors)
    return a


def covered_facets(
    side: Surface, other: Surface, reach: float, as_is: bool = False
) -> tuple[Array, list[tuple[int, Array, list[Any]]]]:
    """What of a side's facets the other one covers.

    Args:
        side, other: the surfaces.
        reach: distance over the facets' size, up to which they touch.
        as_is: outlines that all but agree count as two, and nothing that lies farther apart or
            faces the same way is refused.

    Returns:
        (m,) whether the whole of each facet; of those that the other's outline cuts the number,
        corners (c, gdim - 1) in the facet's own plane, and pieces: intervals, or polygons.
    """
    side, other = side.of_corners(), other.of_corners()
    surface, p, own = Frame(other.x, other.facets), side.x[side.facets], Facets.of(side)
    centre, radius, normal = own.centre, own.radius, own.normal
    at = surface.locate(centre)
    _, y, tangents = surface.evaluate(at.cell, at.xi)
    facing = np.einsum("fi,fi->f", normal, bases(tangents)[:, -1])
    border = _near_outline(other, centre, radius)
    gap = np.linalg.norm(centre - y, axis=1)
    within = gap <= reach * np.maximum(2.0 * radius, surface.cell_size[at.cell])
    inside = (at.outside < 0.5) & ~border
    if not as_is:
        _check(side, other, inside, facing, gap, within, 2.0 * radius)
    whole = inside & within & (facing < FACING)
    clip: Any = _Clip(other, side, as_is) if border.any() else None
    cut = []
    for f in np.flatnonzero(border):  # the few facets at the outline
        s, pieces = clip(p[f], normal[f], radius[f], gap[f] if reach > FARTHEST else 0.0)
        if pieces is None:
            whole[f] = True
        elif pieces:
            cut.append((f, s, pieces))
    return whole, cut


def _check(
    side: Surface,
    other: Surface,
    inside: Array,
    facing: Array,
    gap: Array,
    within: Array,
    size: Array,
) -> None:
    """Where a side projects onto the other, they must face each other and be close."""
    opposed = inside & (facing < FACING)
    if (inside & (facing > -FACING) & within).any() or (inside.any() and not opposed.any()):
        worst, at = _worst(side, np.where(inside, facing, -2.0))
        raise ContactError(
            f"{side.name} and {other.name} do not face each other: at {at} their outward normals "
            f"have the cosine {facing[worst]:.3f}, facing surfaces have -1; above "
            f"{-FACING} they point the same way. Check the tags, and the cells for negative "
            "Jacobians"
        )
    far = opposed & ~within
    if far.any():
        worst, at = _worst(side, np.where(far, gap / size, -1.0))
        raise ContactError(
            f"{side.name} and {other.name} are too far apart: at {at} they lie {gap[worst]:.3g} "
            f"from each other, where facets have the size {size[worst]:.3g} (allowed: {FARTHEST} "
            f"of the larger facet); {int(far.sum())} facets do. Check positions and units, or tag "
            "only what is in contact"
        )


def _worst(side: Surface, value: Array) -> tuple[int, list[float]]:
    """The facet with the largest value (m,), and its centre."""
    worst = int(value.argmax())
    return worst, checks.place(side.x[side.facets[worst]].mean(axis=0))


def _near_outline(other: Surface, centre: Array, radius: Array) -> Array:
    """(m,) whether facets (centre, radius) come near the other surface's outline."""
    edges = outline_edges(other.facets)
    if not len(edges):
        return np.zeros(len(centre), dtype=bool)
    ends = other.x[edges]
    half = np.linalg.norm(ends[:, -1] - ends[:, 0], axis=1) / 2.0
    # An edge by points no farther apart than the smallest facet, so that few facets are clipped.
    parts = int(np.clip(np.ceil(half.max() / radius.min()), 1, 50))
    t = (np.arange(parts) + 0.5) / parts
    points = ends[:, :1] + t[:, None] * (ends[:, -1:] - ends[:, :1])
    distance, _ = cKDTree(points.reshape(-1, centre.shape[1])).query(centre)
    return distance <= 1.5 * radius + 1.01 * half.max() / parts


class _Clip:
    """Cuts facets with the projection of another surface's facets nearby."""

    def __init__(self, other: Surface, side: Surface, as_is: bool) -> None:
        self.joined = not as_is
        self.p, discs = other.x[other.facets], Facets.of(other)
        self.radius, self.normal = discs.radius.max(), discs.normal
        # How far the outline's nodes lie off this side, along its normal.
        nodes = np.unique(outline_edges(other.facets))
        surface = Frame(side.x, side.facets)
        at = surface.locate(other.x[nodes])
        _, y, tangents = surface.evaluate(at.cell, at.xi)
        off = np.zeros(len(other.x))
        off[nodes] = np.abs(np.einsum("ni,ni->n", other.x[nodes] - y, bases(tangents)[:, -1]))
        self.off = off[other.facets].max(axis=1)
        self.tree = cKDTree(discs.centre)

    def __call__(
        self, p: Array, normal: Array, radius: float, gap: float
    ) -> tuple[Array, list[Any] | None]:
        """The facet p (k, gdim) in its plane, (k, gdim - 1), and pieces of it that are covered;
        None: all of it."""
        gdim = p.shape[1]
        centre = p.mean(axis=0)
        reach = 1.5 * (radius + self.radius) + gap
        near = np.array(self.tree.query_ball_point(centre, reach), int)
        base = orthonormal_base(normal)[:-1]
        height = (self.p[near] - centre) @ normal
        facing = self.normal[near] @ normal
        close = np.abs(height).min(axis=1) <= 2.0 * FARTHEST * max(radius, self.radius) + gap
        keep = (facing < FACING) & close
        s = (p - centre) @ base.T
        if not keep.any():
            return s, []
        # Ends that lie a gap apart are the same line; seen along this facet's normal they differ
        # by gap times tilt.
        tilt = np.sqrt(1.0 - np.clip(facing[keep].max(), -1.0, 0.0) ** 2)
        margin = self.joined * (1e-9 * radius + 0.75 * self.off[near[keep]].max() * tilt)
        t = (self.p[near[keep]] - centre) @ base.T
        if gdim == 2:
            return s, _merged(t[..., 0], margin)
        import shapely  # in space alone

        cover = shapely.union_all(shapely.polygons(t)).buffer(margin, join_style="mitre")
        return s, None if cover.covers(shapely.polygons(s)) else [cover]


def _merged(t: Array, margin: float) -> list[tuple[float, float]]:
    """Union of intervals t (n, 2), each grown by a margin."""
    merged: list[list[float]] = []
    for low, high in sorted((a.min() - margin, a.max() + margin) for a in t):
        if merged and low <= merged[-1][1]:
            merged[-1][1] = max(merged[-1][1], high)
        else:
            merged.append([low, high])
    return [(low, high) for low, high in merged]
