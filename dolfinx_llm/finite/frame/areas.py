"""Integrals over the covered, or the free, parts of facets, in space each in its own mean plane.

Integrated are the shape functions of control values, ``Element.positive``, on facets that are
straight between their corners: at first order those of the nodes; at second order they are at least
0 as well, and forces at nodes follow from them. A warped quad is seen along its mean normal: the
component along it of int N n dA is exact, and what lies across adds up to zero over its nodes. So
does what vector areas of second-order facets that bend have beyond those of straight ones; where
they are asked for with it, whole facets are integrated exactly as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import per_item, summing
from dolfinx_llm.finite.frame.covered import Covered, integrated, with_thickness
from dolfinx_llm.finite.frame.jacobians import (
    QUARTER,
    area_derivatives,
    coordinates,
    cross_matrix,
    jacobian,
)
from dolfinx_llm.geometry.cells import CORNERS, facet_vectors, vector_areas
from dolfinx_llm.geometry.element import Element, element_of
from dolfinx_llm.geometry.overlap_flat import local_bases
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.geometry.swept import tangents_at

MIDDLES = np.array([[0.5, 0.0], [0.5, 0.5], [0.0, 0.5]])
WHOLE = {  # points and weights on a reference facet, by the number of functions, which integrate
    3: (np.full((1, 2), 1.0 / 3.0), np.array([0.5])),  # N det J and N grad N det J
    4: (CORNERS[4] / np.sqrt(3.0), np.ones(4)),
    6: (MIDDLES, np.full(3, 1.0 / 6.0)),
    9: (CORNERS[4] / np.sqrt(3.0), np.ones(4)),
}


@dataclass(frozen=True, eq=False)
class FacetPlanes:
    """The mean planes of f facets with k corners in space."""

    facets: Array  # (f, k) corners
    element: Element  # of the j functions that are integrated
    centre: Array  # (f, 3) [length]
    axes: Array  # (f, 2, 3) unit vectors in the plane, right-handed with the normal
    normal: Array  # (f, 3) unit
    size: Array  # (f,) [area]
    corners: Array  # (f, k, 2) in the plane [length]
    heights: Array  # (f, k) of the nodes over it [length]
    grown: Array  # (f, 3 k) derivative of the size by the nodes' positions [length]
    turned: Array  # (f, 2, 3 k) the same of the normal's components along the axes [1/length]

    @classmethod
    def of(cls, x: Array, facets: Array, element: Element | None = None) -> FacetPlanes:
        """Planes of facets (f, k) over nodes x (n, 3); the element of functions to be integrated,
        by default the facets' own."""
        area, by_x = vector_areas(x, facets), area_derivatives(x, facets)
        size = np.linalg.norm(area, axis=1)
        bases = local_bases(area / size[:, None])
        axes, normal, centre = bases[:, :2], bases[:, 2], x[facets].mean(axis=1)
        arm = x[facets] - centre[:, None]
        return cls(
            facets,
            element or element_of(2, facets.shape[1]),
            centre,
            axes,
            normal,
            size,
            np.einsum("fai,fki->fka", axes, arm),
            np.einsum("fi,fki->fk", normal, arm),
            np.einsum("fi,fic->fc", normal, by_x),
            np.einsum("fai,fic->fac", axes, by_x) / size[:, None, None],
        )

    def seen(self, i: Array, p: Array) -> tuple[Array, Array]:
        """(n, m, 2) points p (n, m, 3) in the planes of facets i (n,), and their heights (n, m)."""
        arm = p - self.centre[i][:, None]
        return (
            np.einsum("nai,nmi->nma", self.axes[i], arm),
            np.einsum("ni,nmi->nm", self.normal[i], arm),
        )

    def in_space(self, i: Array, by_own: Array, by_other: Array, heights: Array) -> Array:
        """Derivatives by positions in space, of derivatives by places in planes of facets i (n,).

        Places in a plane are T (x - c): they change by T dx, and by -(T dn) times the height, up to
        a rigid motion in the plane.

        Args:
            i: facets.
            by_own: (n, r, k, 2) by places of the facets' nodes.
            by_other: (n, r, m, 2) by places of m other points.
            heights: (n, m) of these points.

        Returns:
            (n, r, 3 k + 3 m) by positions of nodes, and of the other points.
        """
        n, r, k, _ = by_own.shape
        both = np.concatenate([by_own, by_other], axis=2)
        level = np.concatenate([self.heights[i], heights], axis=1)
        found = both.reshape(n, r * both.shape[2], 2) @ self.axes[i]
        found = found.reshape(n, r, 3 * both.shape[2])
        lean = np.einsum("nrpa,np->nra", both, level)
        found[:, :, : 3 * k] -= np.einsum("nra,nac->nrc", lean, self.turned[i])
        return found

    def whole(self) -> tuple[Array, Array]:
        """(f, j) integrals of the shape functions over whole facets, over their sizes, and
        (f, j, 3 k) derivatives by the nodes' positions [1 / length]."""
        f, j = len(self.facets), self.element.nodes
        xi, weights = WHOLE[j]
        values, by_own = plane_integrals(
            self.element,
            self.corners,
            np.broadcast_to(xi, (f, *xi.shape)),
            np.broadcast_to(weights, (f, len(xi))),
        )
        i = np.arange(f)
        change = self.in_space(i, by_own, np.zeros((f, j, 0, 2)), np.zeros((f, 0)))
        return values / self.size[:, None], self.over_size(i, values, change)

    def over_size(self, i: Array, values: Array, change: Array) -> Array:
        """Derivatives of values (n, j) over the sizes of facets i, of the values' (n, j, 3 k)."""
        size = self.size[i][:, None, None]
        return change / size - values[:, :, None] * self.grown[i][:, None] / size**2


def plane_integrals(
    element: Element, corners: Array, xi: Array, weights: Array
) -> tuple[Array, Array]:
    """Integrals of N_J (n, j) over parts of plane facets that move with them, and their derivatives
    (n, j, k, 2) by the corners: int N_J grad N_K.

    Args:
        element: whose functions N_J of control values are integrated.
        corners: (n, k, 2) of the facets [length].
        xi: (n, g, 2) points in reference coordinates.
        weights: (n, g) of these points there.
    """
    (n, g, _), k = xi.shape, corners.shape[1]
    N, dN = element_of(2, k).shape(xi.reshape(-1, 2))
    N = N if element.nodes == k else element.positive(xi.reshape(-1, 2))
    N, dN = N.reshape(n, g, element.nodes), dN.reshape(n, g, k, 2)
    (x_xi, x_eta), (y_xi, y_eta) = tangents_at(dN, corners)
    across = np.stack(  # grad N_K det J
        [
            dN[..., 0] * y_eta[..., None] - dN[..., 1] * y_xi[..., None],
            dN[..., 1] * x_xi[..., None] - dN[..., 0] * x_eta[..., None],
        ],
        axis=-1,
    )
    values = np.einsum("ng,ngj->nj", weights * (x_xi * y_eta - x_eta * y_xi), N)
    weighted = np.swapaxes(weights[:, :, None] * N, 1, 2)
    return values, (weighted @ across.reshape(n, g, 2 * k)).reshape(n, element.nodes, k, 2)


def everything(x: Array, surface: Surface, first: int, width: int) -> Covered:
    """Whole facets; arguments as for ``surface_integrals``."""
    f, gdim = len(surface.cells), x.shape[1]
    if gdim == 2:
        j = integrated(surface) + 1
        return Covered(np.full((f, j), 1.0 / j), csr_matrix((f * j, width)))
    share, change = FacetPlanes.of(x, surface.facets, surface.element).whole()
    return Covered(share, jacobian(change, coordinates(surface.facets, gdim, first), width))


def surface_integrals(
    x: Array,
    surface: Surface,
    covered: Covered,
    first: int,
    sizes: bool = False,
    bent: bool = False,
) -> tuple[Array, csr_matrix]:
    """(n, gdim) integrals of the shape functions over parts of a surface, as vector areas; (n, 1)
    as areas.

    Args:
        x: (n, gdim) nodes [length].
        surface: with f facets of k corners and j nodes.
        covered: parts of them.
        first: number of the first of the nodes' coordinates.
        sizes: areas, not vector areas.
        bent: vector areas of facets as they are, not straight between their corners.

    Returns:
        Values [area], and their derivatives (n r, width) by all coordinates [area / length].
    """
    facets, covered = surface.facets, with_thickness(covered, x, surface, first)
    (n, gdim), (f, j) = x.shape, surface.cells.shape
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
    change = change + _by_nodes(stretched, facets, first, width)
    nodes = surface.cells if bent else facets
    if not sizes and nodes.shape[1] > gdim:
        part = covered.share.sum(axis=1)
        beyond, by_beyond = (np.pad(a, [(0, 0), (0, j - nodes.shape[1])] + [(0, 0)] * (a.ndim - 2))
                             for a in _beyond_plane(x, facets, nodes))  # fmt: skip
        value = value + part[:, None, None] * beyond
        change = change + _by_nodes(part[:, None, None, None] * by_beyond, nodes, first, width)
        total = summing(np.repeat(np.arange(f), j), f) @ covered.derivative
        change = change + per_item(beyond.reshape(f, j * r, 1)) @ total
    rows = coordinates(surface.cells, r).ravel()
    gather = summing(rows, n * r)
    return (gather @ value.ravel()).reshape(n, r), gather @ change


def _by_nodes(blocks: Array, nodes: Array, first: int, width: int) -> csr_matrix:
    """(f j r, width) matrix of derivatives (f, j, r, gdim k) by the positions of nodes (f, k)."""
    f, j, r, c = blocks.shape
    places = coordinates(nodes, c // nodes.shape[1], first)
    return jacobian(blocks.reshape(f, j * r, c), places, width)


def _beyond_plane(x: Array, facets: Array, nodes: Array) -> tuple[Array, Array]:
    """(f, j, gdim) what int N_J n dA over whole facets with nodes (f, j), warped or bent, has
    beyond that over straight ones in the mean plane of the corners (f, k), and (f, j, gdim, gdim j)
    derivatives; of a part of one the part of this is taken. It adds up to zero over the nodes, and
    makes the moment of a pressure around a body zero."""
    (f, k), (_, j), gdim = facets.shape, nodes.shape, x.shape[1]
    element = element_of(gdim - 1, j)
    xi, weight = WHOLE[4] if element.order == 1 else element.quadrature
    dN = element.shape(xi)[1]
    N = weight[:, None] * element.positive(xi)
    if gdim == 2:  # n is QUARTER t
        across = np.broadcast_to(QUARTER, (f, 1, 2, 2))
        by_x = np.einsum("gj,gk,fgil->fjikl", N, dN[..., 0], across)
    else:  # d(t_1 x t_2) = dx_K x (dN_K,1 t_2 - dN_K,2 t_1)
        t = np.einsum("gkd,fki->fgdi", dN, x[nodes])
        w = np.einsum("gj,gk,fgi->fjki", N, dN[..., 0], t[:, :, 1])
        w -= np.einsum("gj,gk,fgi->fjki", N, dN[..., 1], t[:, :, 0])
        by_x = np.moveaxis(cross_matrix(w), 2, 3)
    by_x = by_x.reshape(f, j, gdim, gdim * j)
    exact = np.einsum("fki,kj->fji", facet_vectors(x, nodes), element.bernstein)
    area, by_corners = vector_areas(x, facets), area_derivatives(x, facets)
    share, by_share = np.full((f, j), 1.0 / j), np.zeros((f, j, gdim * k))
    if gdim == 3:
        share, by_share = FacetPlanes.of(x, facets, element).whole()
    by_x[..., : gdim * k] -= np.einsum("fjc,fi->fjic", by_share, area)
    by_x[..., : gdim * k] -= share[:, :, None, None] * by_corners[:, None]
    return exact - share[:, :, None] * area[:, None], by_x
