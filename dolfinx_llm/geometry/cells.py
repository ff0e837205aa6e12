"""Segments, triangles and quads: shape functions, vector areas, bases."""

from collections.abc import Sequence
from itertools import chain

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.element import CORNERS as CORNERS
from dolfinx_llm.geometry.element import element_of
from dolfinx_llm.geometry.element import shape_functions as shape_functions

CREASED = 1.0  # [rad] between normals of cells, from which on an edge is none of a smooth surface


def closest_on_sides(p: Array, x: Array) -> Array:
    """Reference coordinates (n, 2) of the points closest to x on the sides of triangles p."""
    side = np.roll(p, -1, axis=1) - p
    d = x[:, None] - p
    t = np.einsum("nki,nki->nk", d, side) / np.einsum("nki,nki->nk", side, side)
    t = np.clip(t, 0.0, 1.0)
    best = np.linalg.norm(d - t[..., None] * side, axis=2).argmin(axis=1)
    n = np.arange(len(x))
    t = t[n, best]
    return np.stack([[t, 0.0 * t], [1.0 - t, t], [0.0 * t, 1.0 - t]])[best, :, n]


def gauss(n: int) -> tuple[Array, Array]:
    """Points (n,) and weights (n,) on [0, 1], exact for polynomials of degree 2 n - 1."""
    s, w = np.polynomial.legendre.leggauss(n)
    return (s + 1.0) / 2.0, w / 2.0


def joined_lists(found: Sequence[list[int]]) -> Array:
    """One array of many lists of numbers."""
    return np.fromiter(chain.from_iterable(found), np.int64)


def repeated_for(of: Array, found: Sequence[list[int]]) -> Array:
    """To whom, of (n,), the numbers of each list belong."""
    return np.repeat(of, [len(f) for f in found])


def vector_areas(x: Array, cells: Array) -> Array:
    """Normal times area of every cell, (n_cells, 3); of segments normal times length, (n_cells, 2).
    Triangles and quads may also be given in plane coordinates (m, 2)."""
    p = x[cells]
    if cells.shape[1] == 2:
        t = p[:, 1] - p[:, 0]
        return np.column_stack([-t[:, 1], t[:, 0]])
    if x.shape[1] == 2:
        p = np.concatenate([p, np.zeros_like(p[..., :1])], axis=2)
    if cells.shape[1] == 3:
        return 0.5 * cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    return 0.5 * cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1])


def cross(a: Array, b: Array) -> Array:
    """(..., 3) a × b: NumPy's own takes three times as long for few vectors."""
    turned, back = [1, 2, 0], [2, 0, 1]
    found: Array = a[..., turned] * b[..., back] - a[..., back] * b[..., turned]
    return found


def unit(vectors: Array) -> Array:
    """(n, gdim) vectors over their lengths."""
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def unit_normals(x: Array, cells: Array) -> Array:
    """(n_cells, gdim) unit normals, along ``vector_areas``."""
    return unit(vector_areas(x, cells))


def outline_edges(facets: Array) -> Array:
    """(e, 2) edges of one facet only, (e, 1) end nodes of segments; empty on closed surfaces."""
    if facets.shape[1] == 2:
        nodes, count = np.unique(facets, return_counts=True)
        return nodes[count == 1][:, None]
    start, end = facets.ravel(), np.roll(facets, -1, axis=1).ravel()
    number = np.minimum(start, end) * (facets.max(initial=0) + 1) + np.maximum(start, end)
    _, first, count = np.unique(number, return_index=True, return_counts=True)
    return np.column_stack([start, end])[first[count == 1]]


def connected(cells: Array, n: int) -> tuple[Array, Array]:
    """(m,), (n,) the connected part of each cell (m, k) and of each node: cells hang together by
    nodes."""
    m, k = cells.shape
    starts = k * np.minimum(np.arange(m + n + 1, dtype=np.int32), m)  # rows of nodes are empty
    nodes = (m + cells.ravel()).astype(np.int32)
    graph = csr_matrix((np.ones(m * k), nodes, starts), (m + n, m + n))
    part = connected_components(graph, directed=False)[1]
    return part[:m], part[m:]


def facets_around(facets: Array, m: int) -> csr_matrix:
    """(m, f) ones where a facet (f, k) has a node."""
    f, k = facets.shape
    return csr_matrix((np.ones(f * k), (facets.ravel(), np.repeat(np.arange(f), k))), (m, f))


def turns(x: Array, cells: Array) -> Array:
    """(n_cells,) by how much cells turn at most against those about them, but for sharp edges, as
    the tangent of the angle."""
    beside, normals = facets_around(cells, len(x)), unit_normals(x, cells)
    i, j = (beside.T @ beside).nonzero()
    cosine = np.minimum(np.einsum("ni,ni->n", normals[i], normals[j]), 1.0)
    smooth = cosine > np.cos(CREASED)
    found = np.zeros(len(cells))
    np.maximum.at(found, i[smooth], np.tan(np.arccos(cosine[smooth])))
    return found


def areas_around(x: Array, facets: Array, cells: Array | None = None) -> Array:
    """(m, gdim) sums of the vector areas of the facets (f, k) around each node, of those of cells
    (f, j) where these have more nodes than the facets' corners [area]."""
    total = np.zeros_like(x)
    np.add.at(total, facets if cells is None else cells, vector_areas(x, facets)[:, None])
    return total


def cross_plane(a: Array, b: Array) -> Array:
    """(...) cross products of vectors (..., 2) in the plane, which NumPy 2 has no more."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def facet_vectors(x: Array, facets: Array, thickness: Array | None = None) -> Array:
    """(m, k, gdim) integrals of N n dA over each facet (m, k), exact also on warped quads and on
    bent facets of second order; in the plane with a thickness (n,) of the nodes [area]."""
    k = facets.shape[1]
    element = element_of(x.shape[1] - 1, k)
    if thickness is None and element.order == 1 and k < 4:
        return np.repeat((vector_areas(x, facets) / k)[:, None, :], k, axis=1)
    xi, w = element.quadrature
    if element.order == 1 and k == 4:  # 2 x 2 points integrate N det J, of degree 2 in each way
        xi, w = CORNERS[4] / np.sqrt(3.0), np.ones(4)
    N, dN = element.shape(xi)
    normal = facet_normals(x, facets, dN)
    if thickness is not None:
        normal = normal * np.einsum("gk,mk->mg", N, thickness[facets])[..., None]
    return np.einsum("mgi,gk->mki", normal, w[:, None] * N)


def facet_mass(x: Array, facets: Array, thickness: Array | None = None) -> Array:
    """(m, k, k) integrals of N N dA over each facet (m, k), whole and maybe bent; in the plane with
    a thickness (n,) of the nodes [area]."""
    element = element_of(x.shape[1] - 1, facets.shape[1])
    xi, w = element.quadrature
    N, dN = element.shape(xi)
    area = w * np.linalg.norm(facet_normals(x, facets, dN), axis=2)
    if thickness is not None:
        area = area * np.einsum("gk,mk->mg", N, thickness[facets])
    return np.einsum("mg,gk,gl->mkl", area, N, N)


def facet_normals(x: Array, facets: Array, dN: Array) -> Array:
    """(m, g, gdim) normals of facets (m, k), of the size of the Jacobian, where shape functions
    have the slopes dN (g, k, d), or (m, g, k, d)."""
    dN = np.broadcast_to(dN, (len(facets), *dN.shape[-3:]))
    t = np.einsum("mgkd,mki->mgdi", dN, x[facets])
    if x.shape[1] == 2:
        return np.stack([-t[:, :, 0, 1], t[:, :, 0, 0]], axis=2)
    return cross(t[:, :, 0], t[:, :, 1])


def cell_sizes(x: Array, cells: Array) -> Array:
    """(n_cells,) square root of every cell's area, length of segments [length]."""
    area = np.linalg.norm(vector_areas(x, cells), axis=1)
    return area if cells.shape[1] == 2 else np.sqrt(area)


def corner_jacobians(x: Array, cells: Array) -> Array:
    """(n_cells, k) Jacobian at the corners over the cell's mean; of a warped quad, along its
    mean normal."""
    p = x[cells]
    if cells.shape[1] == 2:
        length = np.linalg.norm(p[:, 1] - p[:, 0], axis=1)
        return np.column_stack([length, length]) / max(length.mean(), 1e-300)
    area = vector_areas(x, cells)
    size = np.linalg.norm(area, axis=1)
    if cells.shape[1] == 3:
        side = np.linalg.norm(p - np.roll(p, -1, axis=1), axis=2).max(axis=1)
        return np.repeat((size / np.maximum(side, 1e-300) ** 2)[:, None], 3, axis=1)
    corner = cross(np.roll(p, -1, axis=1) - p, np.roll(p, 1, axis=1) - p)
    normal = area / np.maximum(size, 1e-300)[:, None]
    return np.einsum("cki,ci->ck", corner, normal) / np.maximum(size, 1e-300)[:, None]


def points_of(x: Array, cells: Array, xi: Array) -> tuple[Array, ...]:
    """Shape functions (n, k), positions (n, gdim) and tangents (n, d, gdim), the derivatives by the
    reference coordinates, at one point xi (n, d) of each of the cells (n, k), (23)."""
    N, dN = shape_functions(cells.shape[1], xi)
    p = x[cells]
    return N, np.einsum("nk,nki->ni", N, p), np.einsum("nkd,nki->ndi", dN, p)


def bases(tangents: Array) -> Array:
    """(n, gdim, gdim) right-handed orthonormal bases, rows (t1, t2, n), or (t1, n) in 2D, of
    tangents (n, d, gdim): the paper's (9)."""
    t1 = tangents[:, 0] / np.linalg.norm(tangents[:, 0], axis=1, keepdims=True)
    if tangents.shape[2] == 2:
        return np.stack([t1, np.column_stack([-t1[:, 1], t1[:, 0]])], axis=1)
    n = cross(tangents[:, 0], tangents[:, 1])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return np.stack([t1, cross(n, t1), n], axis=1)


def rigid_modes(x: Array, components: int = 0) -> Array:
    """(n, gdim, 3 or 6) translations and rotations of points x (n, gdim); of a field with one of
    ``components`` the constant (n, 1, 1)."""
    n, gdim = x.shape
    if components == 1:
        return np.ones((n, 1, 1))
    modes = np.zeros((n, gdim, 3 * (gdim - 1)))
    modes[:, :, :gdim] = np.eye(gdim)
    for k, (i, j) in enumerate([(0, 1), (1, 2), (2, 0)][: 2 * gdim - 3]):
        modes[:, i, gdim + k] = -x[:, j]
        modes[:, j, gdim + k] = x[:, i]
    return modes


def middle_jacobians(x: Array, cells: Array) -> Array:
    """(n_cells,) determinants of bodies' cells (n_cells, k) in the middle, in dolfinx's order of
    nodes x (n, gdim): positive or negative with their orientation [volume]."""
    p, gdim = x[cells], x.shape[1]
    if cells.shape[1] == gdim + 1:
        return np.linalg.det(p[:, 1:] - p[:, :1])
    end = np.arange(cells.shape[1])[None, :] >> np.arange(gdim)[:, None] & 1  # along each axis
    return np.linalg.det(np.einsum("ak,cki->cai", (2.0 * end - 1.0) / 2 ** (gdim - 1), p))
