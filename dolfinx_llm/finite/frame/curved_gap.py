"""Gaps to a curved frame, which stands out beyond its facets: by its nodal normals.

With y(xi) = sum_J N_J y_J on a facet, and n_J the averaged normals of its nodes,

    s(xi) = 1/2 sum_J N_J n_J·(y_J - y(xi)):

half of what planes across n_J through the nodes stand out in the mean, exact where the surface is
quadratic, and 0 on flat facets. Its slope is -n·y' but for what curvature varies: forces along n do
as good as no work where a node slides along the frame. Nodes count about which the frame is drawn
curved: what is drawn flat bends at rims of contact most, where it is not smooth. Facets of second
order are curved themselves, s = 0.

Designed rows pass forces, and move with the frame; where they say a node is they miss the frame by
as much as s, since they reproduce planes alone, at second order paraboloids. So where nodes count a
gap is that to the frame itself, on which N_0 places the node:

    gap = n·(x - sum_J N_J y_J) + w n·sum_J (N - N_0)_J y_J - s,

w the sum of N_0J over the nodes J that count.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, per_item
from dolfinx_llm.finite.frame.jacobians import NodalNormals, coordinates, jacobian
from dolfinx_llm.finite.frame.location import LocationDerivatives, OnFrame
from dolfinx_llm.geometry.element import element_of


def rounded_gap(
    at: OnFrame,
    d: LocationDerivatives,
    y: Array,
    facets: Array,
    normals: NodalNormals,
    rounded: Array,
    columns: tuple[Array, int, int],
    by_rows: Array,
) -> tuple[Array, Array, csr_matrix]:
    """(n,) gaps at places on a frame [length], (n,) w, and (n, width) their derivative by all
    coordinates but for 1 - w times that of what rows say.

    Args:
        at, d: the places, and how they change.
        y: (m, gdim) the frame's nodes [length].
        facets: (f, k) its facets.
        normals: of its nodes.
        rounded: (m,) nodes that count.
        columns: numbers (n, gdim) of the nodes' coordinates, of the frame's first, and of all.
        by_rows: (n,) n·(x - sum_J N_J y_J) with the designed rows [length].
    """
    cells, (of_x, first, width) = facets[at.facet], columns
    (n, k), gdim, count = at.N.shape, y.shape[1], rounded[cells]
    on_frame = coordinates(cells, gdim, first)
    # How far the frame stands out.
    stands_out = count * (element_of(gdim - 1, k).order == 1)
    nn = normals.n[cells] * stands_out[:, :, None]
    arm = y[cells] - np.einsum("nk,nki->ni", at.N, y[cells])[:, None]
    stands = np.einsum("nki,nki->nk", nn, arm)
    mean = np.einsum("nk,nki->ni", at.N, nn)
    slope = np.einsum("nkd,nk->nd", at.dN, stands)
    slope -= np.einsum("ni,nkd,nki->nd", mean, at.dN, y[cells])
    by_n = (at.N * stands_out)[:, :, None] * arm
    by_y = at.N[:, :, None] * (nn - mean[:, None])
    turned = jacobian(by_n.reshape(n, 1, k * gdim), coordinates(cells, gdim), y.size)
    moved = jacobian(by_y.reshape(n, 1, k * gdim), on_frame, width)
    s_z = 0.5 * (turned @ normals.derivative + moved + per_item(slope[:, None]) @ d.xi)
    gap = by_rows - 0.5 * np.einsum("nk,nk->n", at.N, stands)
    if not count.any():
        return gap, np.zeros(n), -s_z
    # What rows miss of it.
    w, apart = np.einsum("nk,nk->n", at.N, count), at.gap - by_rows
    slope = -np.einsum("ni,nkd,nki->nd", at.normal, at.dN, y[cells])
    by_y = -at.N[:, :, None] * at.normal[:, None]
    moved = jacobian(by_y.reshape(n, 1, k * gdim), on_frame, width)
    to_frame = jacobian(at.normal[:, None], of_x, width) + moved + per_item(slope[:, None]) @ d.xi
    fades = per_item(np.einsum("nkd,nk->nd", at.dN, count)[:, None]) @ d.xi
    return gap + w * apart, w, diagonal(w) @ to_frame + diagonal(apart) @ fades - s_z


def raised(
    at: OnFrame, d: LocationDerivatives, rise: Array, own: Array
) -> tuple[Array, csr_matrix]:
    """(n,) by how much gaps of second-order nodes are less since they, and facets of the frame, are
    drawn straight: ``rises``; and (n, width) its derivative.

    Args:
        at, d: the nodes' places on the frame, and how they change.
        rise: (n, k) of the nodes of the frame's facets there [length].
        own: (n,) of the nodes [length].
    """
    slope = np.einsum("nkd,nk->nd", at.dN, rise)
    return np.einsum("nk,nk->n", at.N, rise) + own, per_item(slope[:, None]) @ d.xi
