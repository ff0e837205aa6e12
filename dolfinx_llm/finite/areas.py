"""Integrals over the covered, or the free, parts of facets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.finite.facet_planes import FacetPlanes
from dolfinx_llm.finite.jacobians import coordinates, jacobian, per_item, summing
from dolfinx_llm.finite.normals import area_derivatives
from dolfinx_llm.geometry.cells import vector_areas


@dataclass(frozen=True, eq=False)
class Covered:
    """Covered parts of facets: integrals of shape functions there, over the facet's size."""

    share: np.ndarray  # (f, k); their sum is 1 where the whole facet is covered
    derivative: csr_matrix  # (k f, width) by all coordinates [1 / length]

    def without(self, other: Covered) -> Covered:
        """What of these parts does not belong to other ones, which lie in them."""
        return Covered(self.share - other.share, (self.derivative - other.derivative).tocsr())


def everything(x: np.ndarray, facets: np.ndarray, first: int, width: int) -> Covered:
    """Whole facets; arguments as for ``surface_integrals``."""
    (f, k), gdim = facets.shape, x.shape[1]
    if gdim == 2:
        return Covered(np.full((f, k), 1.0 / k), csr_matrix((f * k, width)))
    share, change = FacetPlanes.of(x, facets).whole()
    return Covered(share, jacobian(change, coordinates(facets, gdim, first), width))


def surface_integrals(
    x: np.ndarray, facets: np.ndarray, covered: Covered, first: int, sizes: bool = False
) -> tuple[np.ndarray, csr_matrix]:
    """(n, gdim) integrals of the shape functions over parts of a surface, as vector areas; (n, 1)
    as areas.

    Args:
        x: (n, gdim) nodes [length].
        facets: (f, k) of the surface.
        covered: parts of them.
        first: number of the first of the nodes' coordinates.
        sizes: areas, not vector areas.

    Returns:
        Values [area], and their derivatives (n r, width) by all coordinates [area / length].
    """
    (n, gdim), (f, k) = x.shape, facets.shape
    width = covered.derivative.shape[1]
    area, by_x = vector_areas(x, facets), area_derivatives(x, facets)
    if sizes:
        size = np.linalg.norm(area, axis=1)[:, None]
        by_x = np.einsum("fi,fic->fc", area / size, by_x)[:, None]
        area = size
    r = area.shape[1]
    value = covered.share[:, :, None] * area[:, None]  # (f, k, r)
    stretched = (covered.share[:, :, None, None] * by_x[:, None]).reshape(f, k * r, -1)
    change = jacobian(stretched, coordinates(facets, gdim, first), width)
    weights = np.broadcast_to(area[:, None, :, None], (f, k, r, 1)).reshape(f * k, r, 1)
    change = change + per_item(weights) @ covered.derivative
    rows = coordinates(facets, r).ravel()
    gather = summing(rows, n * r)
    return (gather @ value.ravel()).reshape(n, r), (gather @ change).tocsr()
