"""Vector areas of facets and averaged normals of nodes, with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.sparse import per_item
from dolfinx_llm.finite.jacobians import coordinates, cross_matrix, jacobian
from dolfinx_llm.geometry.cells import areas_around

QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])  # turns by 90 degrees


@dataclass(frozen=True, eq=False)
class NodalNormals:
    """Averaged normals of a surface's nodes, weighted by vector areas of the facets around."""

    n: np.ndarray  # (m, gdim) unit, out of the body
    derivative: csr_matrix  # (m gdim, width) by all coordinates of the interface [1 / length]


def area_derivatives(x: np.ndarray, facets: np.ndarray) -> np.ndarray:
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


def nodal_normals(x: np.ndarray, facets: np.ndarray, first: int, width: int) -> NodalNormals:
    """Normals of the nodes, along ``areas_around``, with their derivatives.

    Args:
        x: (m, gdim) positions [length].
        facets: (f, k) nodes of each facet; vector areas point out of the body.
        first: number of the first of the nodes' coordinates.
        width: number of all coordinates.
    """
    (m, gdim), (f, k) = x.shape, facets.shape
    total = areas_around(x, facets)
    size = np.linalg.norm(total, axis=1)
    n = total / size[:, None]
    areas = jacobian(area_derivatives(x, facets), coordinates(facets, gdim, first), width)
    rows = coordinates(facets, gdim).reshape(f, k, gdim)
    cols = np.broadcast_to(coordinates(np.arange(f)[:, None], gdim)[:, None], rows.shape)
    gather = csr_matrix((np.ones(rows.size), (rows.ravel(), cols.ravel())), (m * gdim, f * gdim))
    project = (np.eye(gdim) - n[:, :, None] * n[:, None, :]) / size[:, None, None]
    return NodalNormals(n, per_item(project) @ (gather @ areas))
