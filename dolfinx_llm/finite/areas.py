"""Integrals over the covered, or the free, parts of facets.

Integrated are the shape functions of control values, ``Element.positive``, on facets that are
straight between their corners: at first order those of the nodes; at second order they are at least
0 as well, and forces at nodes follow from them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.sparse import per_item, summing
from dolfinx_llm.finite.facet_planes import WHOLE, FacetPlanes
from dolfinx_llm.finite.jacobians import coordinates, cross_matrix, jacobian
from dolfinx_llm.finite.normals import area_derivatives
from dolfinx_llm.geometry.cells import facet_vectors, shape_functions, vector_areas
from dolfinx_llm.geometry.surface import Surface


@dataclass(frozen=True, eq=False)
class Covered:
    """Covered parts of facets: integrals of shape functions there, over the facet's size."""

    share: np.ndarray  # (f, j); their sum is 1 where the whole facet is covered
    derivative: csr_matrix  # (j f, width) by all coordinates [1 / length]

    def without(self, other: Covered) -> Covered:
        """What of these parts does not belong to other ones, which lie in them."""
        return Covered(self.share - other.share, self.derivative - other.derivative)


def everything(x: np.ndarray, surface: Surface, first: int, width: int) -> Covered:
    """Whole facets; arguments as for ``surface_integrals``."""
    (f, j), gdim = surface.cells.shape, x.shape[1]
    if gdim == 2:
        return Covered(np.full((f, j), 1.0 / j), csr_matrix((f * j, width)))
    share, change = FacetPlanes.of(x, surface.facets, surface.element).whole()
    return Covered(share, jacobian(change, coordinates(surface.facets, gdim, first), width))


def surface_integrals(
    x: np.ndarray, surface: Surface, covered: Covered, first: int, sizes: bool = False
) -> tuple[np.ndarray, csr_matrix]:
    """(n, gdim) integrals of the shape functions over parts of a surface, as vector areas; (n, 1)
    as areas.

    Args:
        x: (n, gdim) nodes [length].
        surface: with f facets of k corners and j nodes.
        covered: parts of them.
        first: number of the first of the nodes' coordinates.
        sizes: areas, not vector areas.

    Returns:
        Values [area], and their derivatives (n r, width) by all coordinates [area / length].
    """
    facets = surface.facets
    (n, gdim), (f, k), j = x.shape, facets.shape, surface.cells.shape[1]
    width = covered.derivative.shape[1]
    area, by_x = vector_areas(x, facets), area_derivatives(x, facets)
    if sizes:
        size = np.linalg.norm(area, axis=1)[:, None]
        by_x = np.einsum("fi,fic->fc", area / size, by_x)[:, None]
        area = size
    r = area.shape[1]
    value = covered.share[:, :, None] * area[:, None]  # (f, j, r)
    stretched = covered.share[:, :, None, None] * by_x[:, None]  # (f, j, r, gdim k)
    weights = np.broadcast_to(area[:, None, :, None], (f, j, r, 1)).reshape(f * j, r, 1)
    change = per_item(weights) @ covered.derivative
    if k == 4 and not sizes:
        part = covered.share.sum(axis=1)
        across, by_nodes = (np.pad(a, [(0, 0), (0, j - k)] + [(0, 0)] * (a.ndim - 2))
                            for a in _across_warped(x, facets))  # at corners  # fmt: skip
        value = value + part[:, None, None] * across
        stretched = stretched + part[:, None, None, None] * by_nodes
        total = summing(np.repeat(np.arange(f), j), f) @ covered.derivative
        change = change + per_item(across.reshape(f, j * r, 1)) @ total
    places = coordinates(facets, gdim, first)
    change = change + jacobian(stretched.reshape(f, j * r, -1), places, width)
    rows = coordinates(surface.cells, r).ravel()
    gather = summing(rows, n * r)
    return (gather @ value.ravel()).reshape(n, r), gather @ change


def _across_warped(x: np.ndarray, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(f, 4, 3) what int N_J n dA over a warped quad has across its mean normal, and (f, 4, 3, 12)
    derivatives; over a part of it the part of this is taken. It adds up to zero over the nodes, and
    makes the moment of a pressure around a body zero."""
    xi, _ = WHOLE[4]
    N, dN = shape_functions(4, xi)
    t = np.einsum("gkd,fki->fgdi", dN, x[facets])
    # d(t_1 x t_2) = dx_K x (dN_K,1 t_2 - dN_K,2 t_1)
    w = np.einsum("gk,fgi->fgki", dN[..., 0], t[:, :, 1])
    w -= np.einsum("gk,fgi->fgki", dN[..., 1], t[:, :, 0])
    by_x = cross_matrix(np.einsum("gj,fgki->fjki", N, w))  # (f, j, k, i, i)
    by_x = np.moveaxis(by_x, 2, 3).reshape(len(facets), 4, 3, 12)
    area, share = vector_areas(x, facets), FacetPlanes.of(x, facets).whole()
    exact = facet_vectors(x, facets)
    mean = share[0][:, :, None] * area[:, None]
    by_mean = np.einsum("fjc,fi->fjic", share[1], area)
    by_mean += share[0][:, :, None, None] * area_derivatives(x, facets)[:, None]
    return exact - mean, by_x - by_mean
