"""What two surfaces may touch with: flat sides that are tied, facets that face each other.

Surfaces that may part are treated in their common plane as long as they tilt little against it;
those that follow each other, as a pin does its bore, as curved ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.geometry.cells import vector_areas
from dolfinx_llm.geometry.overlap_flat import Plane
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.geometry.surface import Surface

TILT = 30.0  # [degree] up to which surfaces that may part are treated in their common plane


def facing(sides: Sequence[Surface], plane: Plane, notes: list) -> tuple[Surface, ...]:
    """The facets of surfaces that may part which tilt at most TILT against their common plane."""
    out = []
    for side, sign in zip(sides, (1.0, -1.0)):
        area = vector_areas(side.x, side.facets)
        cosine = sign * (area @ plane.normal) / np.linalg.norm(area, axis=1)
        keep = cosine >= np.cos(np.radians(TILT))
        if not keep.any():
            raise ContactError(
                f"no facet of {side.name} lies within {TILT:g}° of the plane with the normal "
                f"{plane.normal.round(6).tolist()} between the two surfaces. Tag only the parts "
                "of both surfaces that may touch"
            )
        if not keep.all():
            notes.append(f"{(~keep).sum()} facets of {side.name} left out: tilted beyond {TILT:g}°")
        out.append(replace(side, facets=side.facets[keep]))
    return tuple(out)


def conformal(sides: Sequence[Surface]) -> bool:
    """Whether two curved surfaces follow each other, as a pin does its bore: facets tilted beyond
    TILT against the mean plane mostly face the nearest facet of the other side."""
    areas = [vector_areas(side.x, side.facets) for side in sides]
    normals = [a / np.linalg.norm(a, axis=1)[:, None] for a in areas]
    centres = [side.x[side.facets].mean(axis=1) for side in sides]
    limit, mean = np.cos(np.radians(TILT)), areas[0].sum(axis=0) - areas[1].sum(axis=0)
    size, length = np.linalg.norm(areas[0], axis=1).sum(), np.linalg.norm(mean)
    tilted = np.ones(len(centres[0]), dtype=bool)
    if length > 1e-6 * size:
        tilted = normals[0] @ (mean / length) < limit
    nearest = cKDTree(centres[1]).query(centres[0])[1]
    facing = np.einsum("fi,fi->f", normals[0], normals[1][nearest]) < -limit
    return bool(tilted.any() and facing[tilted].mean() > 0.5)


def rim(pairs: ContactPairs, whole: Surface) -> np.ndarray:
    """(n,) whether a facet of the tagged surface next to a node of the pairs is left out."""
    n = len(whole.x)
    facets = [np.bincount(f.ravel(), minlength=n) for f in (whole.facets, pairs.surface.facets)]
    return (facets[0] > facets[1])[pairs.nodes]


def check_flat(sides: Sequence[Surface], plane: Plane) -> None:
    """Require flat sides parallel to each other, closer than a facet's size."""
    size = max(side.diameter for side in sides)
    heights = [plane.height(side.x) for side in sides]
    for side, height in zip(sides, heights):
        if np.ptp(height) > 1e-6 * size:
            raise ContactError(
                f"{side.name} is flat, but not parallel to the other side: its nodes lie within "
                f"{np.ptp(height):.3g} along the normal {plane.normal.round(6).tolist()} (allowed "
                f"{1e-6 * size:.3g}). Check the geometry"
            )
    gap = heights[1].mean() - heights[0].mean()
    areas = [np.linalg.norm(vector_areas(side.x, side.facets), axis=1).max() for side in sides]
    facet = max(areas) ** (1.0 / (len(plane.origin) - 1))
    if abs(gap) > facet:
        raise ContactError(
            f"the surfaces {sides[0].name} and {sides[1].name} lie {gap:.3g} apart along the "
            f"normal, more than the largest facet's size, {facet:.3g}; Tied() is for surfaces that "
            "touch. Check tags, positions and units"
        )
