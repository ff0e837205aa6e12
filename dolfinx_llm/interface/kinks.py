"""Jumps of slopes where second-order facets meet: what a field that is smooth has next to none of.

A pressure is read from forces as p with ∫ N_p p dA = F_p. Forces of bodies are as exact as their
stresses, but what they say of the difference between nodes at corners and in the middle of edges,
which carries no resultant, is small and is found with errors of its own size: corners of 6-node
triangles came out low, by 0.4 h² Δp. A field of second order that is smooth has no jumps of slopes
between facets: a small part of their squares added to those of p (as in interior penalty methods,
Burman and Hansbo 2004) takes such errors away. Linear and quadratic fields have none, resultants
and moments stay, and the jumps of a smooth field fall with h².
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.geometry.cells import shape_functions
from dolfinx_llm.geometry.element import CORNERS, Element
from dolfinx_llm.geometry.loads import assembled

CREASE = 0.7  # cosine of the angle between facets from which on there is an edge of the body


def kinks(x: np.ndarray, cells: np.ndarray, element: Element) -> csr_matrix:
    """(n, n) sums of ∫ h³ [∂N/∂ν] [∂N/∂ν] over what facets (m, k) with nodes at x (n, gdim) share,
    edges or in 2D nodes; ν points out of a facet along it, h is the smaller one's extent along ν.
    """
    n = len(x)
    slopes, out, size, weight, key = (np.concatenate(a) for a in zip(*_sides(x, cells, element)))
    order = np.lexsort(key.T)
    same = (key[order[1:]] == key[order[:-1]]).all(axis=1)
    one, two = order[:-1][same], order[1:][same]
    flat = np.einsum("sgi,sgi->sg", out[one], out[two]).max(axis=1) < -CREASE
    one, two = one[flat], two[flat]
    nodes = np.tile(cells, (len(key) // max(len(cells), 1), 1))
    nodes = np.concatenate([nodes[one], nodes[two]], axis=1)
    jump = np.concatenate([slopes[one], slopes[two]], axis=2)
    scale = weight[one] * np.minimum(size[one], size[two])[:, None] ** 3
    blocks = np.einsum("sg,sgk,sgl->skl", scale, jump, jump)
    return assembled(blocks, nodes, n) if len(blocks) else csr_matrix((n, n))


def _sides(x: np.ndarray, cells: np.ndarray, element: Element) -> list[tuple[np.ndarray, ...]]:
    """Per side of the facets, at g points: slopes of the shape functions along ν (m, g, k), ν
    (m, g, gdim), extents (m,), weights (m, g) and the nodes at its ends (m, 2)."""
    corner = CORNERS[element.corners]
    found: list[tuple[np.ndarray, ...]] = []
    t, w = np.polynomial.legendre.leggauss(2 * element.dim - 1)
    ends = element.edges if element.dim > 1 else np.array([[0, 0], [1, 1]])
    reach = 2.0 if element.corners == 4 else element.corners  # from the centre, of the extent
    for side in ends:
        key = cells[:, side]
        turned = key[:, 0] > key[:, 1]  # points from the same end for both facets
        s = np.where(turned[:, None], -t, t)[..., None]
        a, b = corner[side]
        xi = 0.5 * ((1.0 - s) * a + (1.0 + s) * b)
        N, dN = shape_functions(element.nodes, xi.reshape(-1, element.dim))
        N, dN = N.reshape(*xi.shape[:2], -1), dN.reshape(*xi.shape[:2], -1, element.dim)
        p = x[cells]
        tangents = np.einsum("mgkd,mki->mgdi", dN, p)
        across, length = _across(tangents, b - a)
        middle = np.einsum("mgk,mki->mgi", N, p).mean(axis=1)
        away = middle - p[:, : element.corners].mean(axis=1)
        extent = reach * np.einsum("mi,mgi->mg", away, across).mean(axis=1)
        across = across * np.sign(extent)[:, None, None]
        metric = np.einsum("mgdi,mgei->mgde", tangents, tangents)
        along = np.einsum("mgdi,mgi->mgd", tangents, across)
        slope = np.einsum("mgkd,mgd->mgk", dN, np.linalg.solve(metric, along[..., None])[..., 0])
        found.append((slope, across, np.abs(extent), 0.5 * w * length, np.sort(key, axis=1)))
    return found


def _across(tangents: np.ndarray, way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (m, g, gdim) along facets and across a side of theirs that runs along ``way``
    (d,), whose tangents are (m, g, d, gdim), and its length per reference length (m, g)."""
    along = np.einsum("d,mgdi->mgi", way, tangents)
    if tangents.shape[2] == 1:
        line = tangents[:, :, 0]
        return line / np.linalg.norm(line, axis=2, keepdims=True), np.ones(line.shape[:2])
    length = np.linalg.norm(along, axis=2)
    across = np.cross(along, np.cross(tangents[:, :, 0], tangents[:, :, 1]))
    return across / np.linalg.norm(across, axis=2, keepdims=True), length
