"""How far two surfaces lie apart as drawn, and how deep one lies inside of the other's body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_llm.geometry.cells import bases, cell_sizes, points_of
from dolfinx_llm.geometry.location import ClosestPoints
from dolfinx_llm.geometry.overlap_flat import outline_edges
from dolfinx_llm.geometry.surface import Surface

DEPTH = 1e-9  # of the surface's size: depths below are none


@dataclass(frozen=True, eq=False)
class Separation:
    """The nodes of one side against the other surface; n nodes."""

    distance: np.ndarray  # (n,) from the closest point of the other surface [length]
    depth: np.ndarray  # (n,) how deep each lies inside of the other body, 0 outside [length]
    over: np.ndarray  # (n,) whether its closest point is inside of a facet, not at an edge
    size: np.ndarray  # (n,) of the facets there, the larger of both sides' [length]


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


def _heights(x: np.ndarray, surface: Surface) -> tuple[np.ndarray, ...]:
    """Of points their height over the closest facet, distance, closest point, its facet and whether
    it lies inside of it."""
    at = ClosestPoints(surface.x, surface.facets).locate(x)
    _, y, tangents = points_of(surface.x, surface.facets[at.cell], at.xi)
    height = np.einsum("ni,ni->n", x - y, bases(tangents)[:, -1])
    return height, np.linalg.norm(x - y, axis=1), y, at.cell, at.outside <= 0.0


def facet_sizes(surface: Surface) -> np.ndarray:
    """(n,) size of the largest facet at each node [length]."""
    size = np.zeros(len(surface.x))
    of = cell_sizes(surface.x, surface.facets)
    np.maximum.at(size, surface.facets, of[:, None])
    return size
