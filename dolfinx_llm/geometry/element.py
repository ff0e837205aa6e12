"""Elements of surfaces: nodes of facets and frame cells, shape functions of first and second order.

Nodes of a cell are its corners (of quads in cyclic order), then the middles of the edges from each
corner to the next, then the centre of a quad, as gmsh counts them: segments of 2 or 3 nodes,
triangles of 3 or 6, quads of 4 or 9. Segments lie on [0, 1], quads on [-1, 1]².
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from dolfinx_llm.base.arrays import Array

# Reference coordinates of the corners of segments, triangles and quads, these in cyclic order
# (paper, (23)).
CORNERS = {
    2: np.array([[0.0], [1.0]]),
    3: np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
    4: np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]),
}
# Dimension and number of nodes to number of corners and order.
ELEMENTS = {
    (1, 2): (2, 1),
    (1, 3): (2, 2),
    (2, 3): (3, 1),
    (2, 4): (4, 1),
    (2, 6): (3, 2),
    (2, 9): (4, 2),
}


# The same to the first-order cells between all nodes.
PARTS = {
    (1, 2): np.array([[0, 1]]),
    (1, 3): np.array([[0, 2], [2, 1]]),
    (2, 3): np.array([[0, 1, 2]]),
    (2, 4): np.array([[0, 1, 2, 3]]),
    (2, 6): np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]),
    (2, 9): np.array([[0, 4, 8, 7], [4, 1, 5, 8], [8, 5, 2, 6], [7, 8, 6, 3]]),
}


@dataclass(frozen=True)
class Element:
    """A kind of facet or frame cell."""

    dim: int  # of the cell: 1 or 2
    nodes: int  # of a cell, k

    @property
    def corners(self) -> int:
        """Number of corners, the first nodes of a cell."""
        return ELEMENTS[self.dim, self.nodes][0]

    @property
    def order(self) -> int:
        """Degree of the polynomials that the shape functions reproduce."""
        return ELEMENTS[self.dim, self.nodes][1]

    @cached_property
    def edges(self) -> Array:
        """(e, 2) corners at the ends of each edge, in the order of the edges' nodes."""
        at = np.arange(self.corners if self.dim == 2 else 1)
        return np.column_stack([at, (at + 1) % self.corners])

    @cached_property
    def linear(self) -> Array:
        """(k, c) shape functions of the corners at the nodes."""
        c, out = self.corners, np.zeros((self.nodes, self.corners))
        out[:c] = np.eye(c)
        if self.order == 2:
            middles = out[c : c + len(self.edges)]
            np.put_along_axis(middles, self.edges, 0.5, axis=1)
            out[c + len(self.edges) :] = 1.0 / c
        return out

    @cached_property
    def bernstein(self) -> Array:
        """(k, k) E: nodal values from control values, by which shape functions are Bernstein's."""
        c, e = self.corners, len(self.edges)
        out = np.eye(self.nodes)
        if self.order == 2:
            out[c : c + e, :c] = 0.5 * self.linear[c : c + e]
            out[c : c + e, c : c + e] *= 0.5
            out[c + e :] = [1 / 16] * c + [1 / 8] * e + [1 / 4] * (self.nodes - c - e)
        return out

    @cached_property
    def quadrature(self) -> tuple[Array, Array]:
        """Points (g, d) and weights (g,) on the reference cell, exact for products of three shape
        functions and the Jacobian of straight cells."""
        t, w = np.polynomial.legendre.leggauss(5)
        s, w = (t + 1.0) / 2.0, w / 2.0
        if self.dim == 1:
            return s[:, None], w
        a, b = (g.ravel() for g in np.meshgrid(s, s, indexing="ij"))
        weight = np.outer(w, w).ravel()
        if self.corners == 4:
            return 2.0 * np.column_stack([a, b]) - 1.0, 4.0 * weight
        return np.column_stack([a * (1.0 - b), a * b]), a * weight  # Duffy's triangle

    @property
    def parts(self) -> Array:
        """(s, c) nodes of the first-order cells that have these nodes as corners."""
        return PARTS[self.dim, self.nodes]

    def between(self, corners: Array) -> Array:
        """(n, k, ...) positions of the nodes of straight cells with corners (n, c, ...)."""
        return np.einsum("kc,nc...->nk...", self.linear, corners)

    def permuted(self, cells: Array, corner: Array) -> Array:
        """(n, k) cells whose corners are the given ones of before, (n, c), along the cycle."""
        if self.order == 1:
            return np.take_along_axis(cells, corner, axis=1)
        c, ends = self.corners, corner[:, self.edges]
        forward = ends[..., 1] == (ends[..., 0] + 1) % c
        edge = np.where(forward, ends[..., 0], ends[..., 1]) % len(self.edges)
        rest = np.arange(c + len(self.edges), self.nodes)
        rest = np.broadcast_to(rest, (len(cells), len(rest)))
        return np.take_along_axis(cells, np.column_stack([corner, c + edge, rest]), axis=1)

    def positive(self, xi: Array) -> Array:
        """(n, k) shape functions of control values at xi (n, d): Bernstein's, at least 0."""
        return self.shape(xi)[0] @ self.bernstein

    def shape(self, xi: Array) -> tuple[Array, Array]:
        """N (n, k) and dN (n, k, d) at reference coordinates xi (n, d), (23)."""
        if self.order == 1:
            return _linear(self.nodes, xi)
        if self.corners == 4:
            return _biquadratic(self.linear @ CORNERS[4], xi)
        L, dL = _linear(self.corners, xi)
        a, b = self.edges.T
        N = np.column_stack([L * (2.0 * L - 1.0), 4.0 * L[:, a] * L[:, b]])
        d_edge = 4.0 * (L[:, a, None] * dL[:, b] + L[:, b, None] * dL[:, a])
        return N, np.concatenate([(4.0 * L - 1.0)[..., None] * dL, d_edge], axis=1)


@cache
def element_of(dim: int, nodes: int) -> Element:
    """The element of a dimension with so many nodes."""
    return Element(dim, nodes)


def shape_functions(k: int, xi: Array) -> tuple[Array, Array]:
    """N (n, k) and dN (n, k, d) of cells with k nodes at reference coordinates xi (n, d)."""
    return element_of(xi.shape[1], k).shape(xi)


def _linear(k: int, xi: Array) -> tuple[Array, Array]:
    n = len(xi)
    if k == 4:
        # Column by column: of many points, tiny axes cost more than all that is done with them.
        (a, b), N, dN = xi.T, np.empty((n, 4)), np.empty((n, 4, 2))
        ends = (1.0 - a, 1.0 + a), (0.25 * (1.0 - b), 0.25 * (1.0 + b))
        for j, (s, t) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
            along, across = ends[0][s], ends[1][t]
            np.multiply(along, across, out=N[:, j])
            dN[:, j, 0] = across if s else -across
            np.multiply(along, 0.25 if t else -0.25, out=dN[:, j, 1])
        return N, dN
    N = np.column_stack([1.0 - xi.sum(axis=1), xi])
    dN = np.vstack([-np.ones(k - 1), np.eye(k - 1)])
    return N, np.broadcast_to(dN, (n, k, k - 1))


def _biquadratic(points: Array, xi: Array) -> tuple[Array, Array]:
    """Products of a parabola along each axis, for nodes (9, 2) at -1, 0 and 1."""
    x = xi[:, None, :]
    a = np.where(points == 0.0, 1.0 - x * x, 0.5 * x * (x + points))
    d = np.where(points == 0.0, -2.0 * x, x + 0.5 * points)
    return a[..., 0] * a[..., 1], np.stack([d[..., 0] * a[..., 1], a[..., 0] * d[..., 1]], axis=2)
