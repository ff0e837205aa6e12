"""Second-order bodies on meshes of first order: nodes between corners lie below curved surfaces.

Facets are straight there, and cut off what a surface stands out beyond them, h² / 8R. Corners lie
on the surface, nodes between them below it by that much, which is as large as what contact presses
them in by: pressures at nodes would be off by 50 to 1,000 %. At finite deformation gaps are told
from the smooth surface through the corners instead; linear problems warn.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.design.quadric import SmoothSurface
from dolfinx_llm.geometry.cells import unit_normals
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.neighbours import neighbours
from dolfinx_llm.geometry.surface import Surface

ROUND = 1e-3, 0.55  # [rad] between facets that are drawn of a curved surface
STRAIGHT_WITHIN = 1e-6  # of its size: what lies off a facet that is straight


def rises(surface: Surface) -> Array:
    """(n,) by how much nodes of straight facets lie below the smooth surface through the corners;
    0 at corners, where all is flat, and of facets that are drawn curved [length]."""
    element, x, cells = surface.element, surface.X, surface.cells
    rise, c = np.zeros(len(x)), element.corners
    if element.order == 1:
        return rise
    corners, facets = np.unique(cells[:, :c], return_inverse=True)
    facets = facets.reshape(-1, c)
    i, j = neighbours(facets)
    normal = unit_normals(x[corners], facets)
    angle = np.linalg.norm(normal[i] - normal[j], axis=1)
    smooth, bent = angle < ROUND[1], np.zeros(len(facets), dtype=bool)
    round_ones = smooth & (angle > ROUND[0])
    bent[i[round_ones]] = bent[j[round_ones]] = True
    straight = element.between(x[cells[:, :c]])
    size = np.ptp(straight[bent], axis=1).max(initial=0.0)
    if not bent.any() or np.abs(x[cells] - straight)[bent].max() > STRAIGHT_WITHIN * size:
        return rise
    graph = csr_matrix((np.ones(smooth.sum()), (i[smooth], j[smooth])), (len(facets),) * 2)
    label, found = connected_components(graph, directed=False)[1], np.zeros(len(x))
    for piece in np.unique(label[bent]):
        own = np.flatnonzero(label == piece)
        used, of = np.unique(facets[own], return_inverse=True)
        through = SmoothSurface.through(Frame(x[corners[used]], of.reshape(-1, c)))
        nodes, first = np.unique(cells[own[bent[own]]], return_index=True)
        cell, place = np.divmod(first, cells.shape[1])
        at = of.reshape(-1, c)[np.flatnonzero(bent[own])[cell]]
        index = np.repeat(np.arange(len(nodes)), c), at.ravel()
        N = csr_matrix((element.linear[place].ravel(), index), (len(nodes), len(used)))
        point, n = through.at(N, x[nodes])
        rise[nodes] += np.einsum("ni,ni->n", point - x[nodes], n)
        found[nodes] += 1.0
    rise[corners] = 0.0
    return rise / np.maximum(found, 1.0)
