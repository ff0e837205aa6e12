"""How far a curved frame stands out beyond its facets, by its nodal normals.

With y(xi) = sum_J N_J y_J on a facet, and n_J the averaged normals of its nodes,

    s(xi) = 1/2 sum_J N_J n_J·(y_J - y(xi)):

half of what planes across n_J through the nodes stand out in the mean, exact where the surface is
quadratic, and 0 on flat facets. Its slope is -n·y' but for what curvature varies: forces along n do
as good as no work where a node slides along the frame. Nodes count about which the frame is drawn
curved: what is drawn flat bends at rims of contact most, where it is not smooth.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import per_item
from dolfinx_llm.finite.jacobians import NodalNormals, coordinates, jacobian
from dolfinx_llm.finite.location import LocationDerivatives, OnFrame


def roundness(
    at: OnFrame,
    d: LocationDerivatives,
    y: Array,
    facets: Array,
    normals: NodalNormals,
    rounded: Array,
    columns: tuple[int, int],
) -> tuple[Array, csr_matrix]:
    """(n,) s at places on a frame [length], and its derivative (n, width) by all coordinates.

    Args:
        at, d: the places, and how they change.
        y: (m, gdim) the frame's nodes [length].
        facets: (f, k) its facets.
        normals: of its nodes.
        rounded: (m,) nodes that count.
        columns: number of the frame's first coordinate, and of all.
    """
    cells, (first, width) = facets[at.facet], columns
    (n, k), gdim = at.N.shape, y.shape[1]
    nn = normals.n[cells] * rounded[cells][:, :, None]
    arm = y[cells] - np.einsum("nk,nki->ni", at.N, y[cells])[:, None]
    stands = np.einsum("nki,nki->nk", nn, arm)
    mean = np.einsum("nk,nki->ni", at.N, nn)
    slope = np.einsum("nkd,nk->nd", at.dN, stands)
    slope -= np.einsum("ni,nkd,nki->nd", mean, at.dN, y[cells])
    by_n = (at.N * rounded[cells])[:, :, None] * arm
    by_y = at.N[:, :, None] * (nn - mean[:, None])
    turned = jacobian(by_n.reshape(n, 1, k * gdim), coordinates(cells, gdim), y.size)
    moved = jacobian(by_y.reshape(n, 1, k * gdim), coordinates(cells, gdim, first), width)
    found = turned @ normals.derivative + moved + per_item(slope[:, None]) @ d.xi
    return 0.5 * np.einsum("nk,nk->n", at.N, stands), 0.5 * found
