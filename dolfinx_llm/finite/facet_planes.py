"""Facets in space, each in its own mean plane, and integrals of shape functions there: those of
control values, ``Element.positive``, of facets that are straight between their corners.

A warped quad is seen along its mean normal: the component along it of int N n dA is exact, and what
lies across adds up to zero over its nodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_llm.finite.normals import area_derivatives
from dolfinx_llm.geometry.cells import CORNERS, vector_areas
from dolfinx_llm.geometry.element import Element, element_of
from dolfinx_llm.geometry.overlap_flat import local_bases

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

    facets: np.ndarray  # (f, k) corners
    element: Element  # of the j functions that are integrated
    centre: np.ndarray  # (f, 3) [length]
    axes: np.ndarray  # (f, 2, 3) unit vectors in the plane, right-handed with the normal
    normal: np.ndarray  # (f, 3) unit
    size: np.ndarray  # (f,) [area]
    corners: np.ndarray  # (f, k, 2) in the plane [length]
    heights: np.ndarray  # (f, k) of the nodes over it [length]
    grown: np.ndarray  # (f, 3 k) derivative of the size by the nodes' positions [length]
    turned: np.ndarray  # (f, 2, 3 k) the same of the normal's components along the axes [1/length]

    @classmethod
    def of(cls, x: np.ndarray, facets: np.ndarray, element: Element | None = None) -> FacetPlanes:
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

    def seen(self, i: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, m, 2) points p (n, m, 3) in the planes of facets i (n,), and their heights (n, m)."""
        arm = p - self.centre[i][:, None]
        return (
            np.einsum("nai,nmi->nma", self.axes[i], arm),
            np.einsum("ni,nmi->nm", self.normal[i], arm),
        )

    def in_space(
        self, i: np.ndarray, by_own: np.ndarray, by_other: np.ndarray, heights: np.ndarray
    ) -> np.ndarray:
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
        found = np.einsum("nrpa,nai->nrpi", both, self.axes[i]).reshape(n, r, 3 * both.shape[2])
        lean = np.einsum("nrpa,np->nra", both, level)
        found[:, :, : 3 * k] -= np.einsum("nra,nac->nrc", lean, self.turned[i])
        return found

    def whole(self) -> tuple[np.ndarray, np.ndarray]:
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

    def over_size(self, i: np.ndarray, values: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Derivatives of values (n, j) over the sizes of facets i, of the values' (n, j, 3 k)."""
        size = self.size[i][:, None, None]
        return change / size - values[:, :, None] * self.grown[i][:, None] / size**2


def plane_integrals(
    element: Element, corners: np.ndarray, xi: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Integrals of N_J (n, j) over parts of plane facets that move with them, and their derivatives
    (n, j, k, 2) by the corners: int N_J grad N_K.

    Args:
        element: whose functions N_J of control values are integrated.
        corners: (n, k, 2) of the facets [length].
        xi: (n, g, 2) points in reference coordinates.
        weights: (n, g) of these points there.
    """
    (n, g, _), k = xi.shape, corners.shape[1]
    dN = element_of(2, k).shape(xi.reshape(-1, 2))[1].reshape(n, g, k, 2)
    N = element.positive(xi.reshape(-1, 2)).reshape(n, g, element.nodes)
    (x_xi, x_eta), (y_xi, y_eta) = np.einsum("ngkd,nki->idng", dN, corners)
    across = np.stack(  # grad N_K det J
        [
            dN[..., 0] * y_eta[..., None] - dN[..., 1] * y_xi[..., None],
            dN[..., 1] * x_xi[..., None] - dN[..., 0] * x_eta[..., None],
        ],
        axis=-1,
    )
    values = np.einsum("ng,ngj->nj", weights * (x_xi * y_eta - x_eta * y_xi), N)
    return values, np.einsum("ngj,ngki->njki", weights[:, :, None] * N, across)
