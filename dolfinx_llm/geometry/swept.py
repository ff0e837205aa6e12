"""Quadrature over parts of straight facets in a plane that polygons bound, edge by edge.

Seen from the origin of the reference facet every edge sweeps over a part of it: points lie on lines
from there to points of the edge. Along these lines shape functions are polynomials, so that the
inverse map of a distorted quadrilateral, which is none, is needed on edges alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.cells import gauss
from dolfinx_llm.geometry.element import shape_functions

# Along an edge of facets of k corners: polynomials of degree 8 are exact on triangles; the inverse
# map of quadrilaterals is smooth, and integrated to rounding where corners are moved by a third.
_EDGE_POINTS = {3: gauss(6), 4: gauss(24)}

# Positions in a cell of k corners as coefficients of 1, r, s and r s: (4, k).
_MONOMIALS = {
    3: np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0], [0.0, 0.0, 0.0]]),
    4: 0.25 * np.array([[1, 1, 1, 1], [-1, 1, 1, -1], [-1, -1, 1, 1], [1, -1, 1, -1.0]]),
}


@dataclass(frozen=True, eq=False)
class Swept:
    """e edges in the planes of facets, and points that integrate over what each sweeps over."""

    along: Array  # (s,) weights of points on an edge, 0 to 1
    x: Array  # (e, s, 2) these points in the plane [length]
    xi: Array  # (e, s, 2) their reference coordinates
    N: Array  # (e, s, k) shape functions there
    points: Array  # (e, g, 2) reference coordinates of points inside
    weights: Array  # (e, g) their signed weights, by area of the reference facet

    @classmethod
    def by(cls, corners: Array, a: Array, b: Array, to_edge: tuple[Array, Array]) -> Swept:
        """Edges from a to b (e, 2) in facets of corners (e, k, 2).

        Args:
            to_edge: points and weights on [0, 1] from the reference facet's origin to an edge.
        """
        (s, ws), (r, wr), side = _EDGE_POINTS[corners.shape[1]], to_edge, b - a
        x = a[:, None] + s[:, None] * side[:, None]
        xi = reference_coordinates(corners, x)
        N, dN = shape_at(corners.shape[1], xi)
        (x_xi, x_eta), (y_xi, y_eta) = tangents_at(dN, corners)
        u, v = side[:, None, 0], side[:, None, 1]
        # xi x dxi/ds, of dxi/ds = (x')⁻¹ side.
        sweep = xi[..., 0] * (x_xi * v - y_xi * u) - xi[..., 1] * (y_eta * u - x_eta * v)
        sweep /= x_xi * y_eta - x_eta * y_xi
        points = (r[:, None] * xi[:, :, None]).reshape(len(xi), len(s) * len(r), 2)
        weights = ((ws * sweep)[:, :, None] * (r * wr)).reshape(points.shape[:2])
        return cls(ws, x, xi, N, points, weights)


def tangents_at(dN: Array, corners: Array) -> Array:
    """(2, 2, n, g) derivatives of each place in a plane by each reference coordinate, of shape
    functions' dN (n, g, k, 2) at g points of facets with corners (n, k, 2)."""
    n, g, k, d = dN.shape
    found = np.swapaxes(dN, 2, 3).reshape(n, g * d, k) @ corners
    return found.reshape(n, g, d, 2).transpose(3, 2, 0, 1)


def shape_at(k: int, xi: Array) -> tuple[Array, Array]:
    """N (n, g, k) and dN (n, g, k, 2) of facets of k corners at points xi (n, g, 2)."""
    N, dN = shape_functions(k, xi.reshape(-1, 2))
    return N.reshape(*xi.shape[:2], k), dN.reshape(*xi.shape[:2], k, 2)


def reference_coordinates(p: Array, x: Array) -> Array:
    """(e, g, 2) reference coordinates of plane points x (e, g, 2) in cells p (e, k, 2)."""
    (e, g, _), k = x.shape, p.shape[1]
    # c0 + c1 r + c2 s + c3 r s, component by component: far quicker than small sums point by point.
    c0, c1, c2, c3 = np.einsum("ik,ekd->ide", _MONOMIALS[k], p)[..., None]
    target = np.moveaxis(x, 2, 0) - c0
    r, s = np.zeros((2, e, g))
    for _ in range(1 if k == 3 else 25):
        (a, b), (c, d) = c1 + s * c3, c2 + r * c3  # tangents
        u, v = target - r * c1 - s * (c2 + r * c3)
        det = a * d - b * c
        step = np.stack([u * d - v * c, a * v - b * u]) / det
        r, s = r + step[0], s + step[1]
        if np.abs(step).max(initial=0.0) < 1e-9:  # quadratic: what is left is rounding
            break
    return np.stack([r, s], axis=2)
