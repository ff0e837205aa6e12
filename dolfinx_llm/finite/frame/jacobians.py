"""Derivatives by the positions of all nodes of an interface, as sparse matrices.

What is found per pair or facet depends on the positions of a few nodes. Its derivative is a dense
block per item, with the numbers of the coordinates that it knows; chains of derivatives are
products of sparse matrices. Here are those of vector areas and of averaged normals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import per_component, per_item
from dolfinx_llm.geometry.cells import facets_around, vector_areas

QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])  # turns by 90 degrees


def jacobian(blocks: Array, columns: Array, width: int) -> csr_matrix:
    """(n r, width) matrix of blocks.

    Args:
        blocks: (n, r, c) derivatives of r values per item by c coordinates.
        columns: (n, c) numbers of these coordinates; repeated ones add up.
        width: number of all coordinates.
    """
    n, r, c = blocks.shape
    order = np.argsort(columns, axis=1, kind="stable")  # once for all rows of an item
    # SciPy's own kind of index: it looks for the largest of any other, again and again.
    index = np.take_along_axis(columns, order, axis=1).astype(np.int32)[:, None].repeat(r, axis=1)
    blocks = np.take_along_axis(blocks, order[:, None], axis=2)
    starts = np.arange(n * r + 1, dtype=np.int32) * c
    matrix = csr_matrix((blocks.ravel(), index.ravel(), starts), (n * r, width))
    matrix.has_sorted_indices = True
    matrix.sum_duplicates()
    return matrix


def coordinates(nodes: Array, gdim: int, first: int = 0) -> Array:
    """(..., k gdim) numbers of the coordinates of nodes (..., k); the first node's is ``first``."""
    found = first + gdim * nodes[..., None] + np.arange(gdim)
    return found.reshape(*nodes.shape[:-1], nodes.shape[-1] * gdim)


def cross_matrix(w: Array) -> Array:
    """(..., 3, 3) matrix of v -> v x w for w (..., 3); (..., 1, 2) of v -> v x w in the plane."""
    if w.shape[-1] == 2:
        return np.stack([w[..., 1], -w[..., 0]], axis=-1)[..., None, :]
    zero = np.zeros(w.shape[:-1])
    rows = [
        [zero, w[..., 2], -w[..., 1]],
        [-w[..., 2], zero, w[..., 0]],
        [w[..., 1], -w[..., 0], zero],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


@dataclass(frozen=True, eq=False)
class NodalNormals:
    """Averaged normals of a surface's nodes, weighted by vector areas of the facets around."""

    n: Array  # (m, gdim) unit, out of the body
    derivative: csr_matrix  # (m gdim, width) by all coordinates of the interface [1 / length]


def area_derivatives(x: Array, facets: Array) -> Array:
    """(f, gdim, k gdim) derivatives of the facets' vector areas by their nodes' positions.

    Args:
        x: (m, gdim) positions [length].
        facets: (f, k) nodes.
    """
    f, k = facets.shape
    if k == 2:
        return np.broadcast_to(np.hstack([-QUARTER, QUARTER]), (f, 2, 4))
    p = x[facets]
    across = np.roll(p, -1, axis=1) - np.roll(p, 1, axis=1)
    return 0.5 * np.moveaxis(cross_matrix(across), 1, 2).reshape(f, 3, 3 * k)


def nodal_normals(
    x: Array, facets: Array, first: int, width: int, weights: csr_matrix | None = None
) -> NodalNormals:
    """Normals of the nodes, along ``areas_around``, with their derivatives.

    Args:
        x: (m, gdim) positions [length].
        facets: (f, k) nodes of each facet; vector areas point out of the body.
        first: number of the first of the nodes' coordinates.
        width: number of all coordinates.
        weights: (m, f) of the facets' vector areas in each node's normal; None: those around it.
    """
    m, gdim = x.shape
    weights = facets_around(facets, m) if weights is None else weights
    total = weights @ vector_areas(x, facets)
    size = np.linalg.norm(total, axis=1)
    n = total / size[:, None]
    areas = jacobian(area_derivatives(x, facets), coordinates(facets, gdim, first), width)
    project = (np.eye(gdim) - n[:, :, None] * n[:, None, :]) / size[:, None, None]
    return NodalNormals(n, per_item(project) @ (per_component(weights, gdim) @ areas))
