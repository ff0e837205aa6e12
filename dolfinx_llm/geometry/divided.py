"""Surfaces with their facets divided into smaller ones, whose nodes go with those of the whole
facets: the shape stays as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix, identity, vstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.element import CORNERS, Element
from dolfinx_llm.geometry.location import UNFELT
from dolfinx_llm.geometry.surface import Surface

TOLD_TO = 9  # digits of points' sums of random numbers, which tell them apart wherever they lie


def divided(surface: Surface, parts: Array) -> tuple[Surface, csr_matrix]:
    """The surface, its own n nodes first, and (n', n) shape functions at its nodes.

    Args:
        surface: as drawn.
        parts: (f,) into how many parts each facet's edges go; in space all alike, or nodes of one
            would lie amid edges of the next.
    """
    element, n = surface.element, len(surface.x)
    k, of_nodes, rows = element.nodes, np.random.default_rng(0).random((n, 2)), []
    for count in np.unique(parts):
        corners = _corners(element, int(count))
        N = element.shape(element.between(corners).reshape(len(corners) * k, -1))[0]
        cells = np.repeat(surface.cells[parts == count], len(N), axis=0)
        values = np.tile(N, (len(cells) // len(N), 1))
        at = np.repeat(np.arange(len(cells)), k), cells.ravel()
        rows.append(csr_matrix((values.ravel(), at), (len(cells), n)))
    every = vstack([identity(n, format="csr"), *rows], format="csr")
    _, first, same = np.unique(
        np.round(every @ of_nodes, TOLD_TO), axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first)
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.arange(len(order))
    cells, shares = number[same.ravel()[n:]].reshape(-1, k), every[first[order]]
    shares.data[np.abs(shares.data) < UNFELT] = 0.0
    shares.eliminate_zeros()
    near = np.asarray(shares.argmax(axis=1)).ravel()
    return replace(
        surface,
        x=shares @ surface.x,
        facets=cells[:, : element.corners],
        elements=None if surface.elements is None else cells,
        dofs=surface.dofs[near],
        owner=surface.owner[near],
        drawn=None if surface.drawn is None else shares @ surface.drawn,
    ), shares


def _corners(element: Element, parts: int) -> Array:
    """(s, c, d) reference coordinates of the corners of a cell's parts."""
    base, d = CORNERS[element.corners], element.dim
    grid = np.meshgrid(*[np.arange(parts)] * d, indexing="ij")
    i = np.stack(grid, axis=-1).reshape(-1, d)[:, None]
    if element.corners == 4:
        return (base + 1.0 + 2.0 * i) / parts - 1.0
    first = i.sum(axis=2)[:, 0]
    turned = (1.0 - base + i)[first < parts - 1] if d == 2 else np.zeros((0, 2, 1))
    return np.concatenate([(base + i)[first < parts], turned]) / parts
