"""Polynomials that rows of a moving frame reproduce: linear ones, at second order squares too."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.element import Element

EDGEWISE = 1e-2  # least over largest singular value of functions that are hardly independent
ELSEWHERE = 1e-9  # weight of nodes where nothing is covered then, over the largest


def products(element: Element) -> list[tuple[int, int]]:
    """Of coordinates along a frame: the squares that its rows reproduce; none at first order."""
    if element.order == 1:
        return []
    return list(combinations_with_replacement(range(element.dim), 2))


def functions_of(element: Element) -> int:
    """How many functions ``chart`` gives."""
    return 1 + element.dim + len(products(element))


def chart(Y: Array, element: Element, forces: Array) -> Array:
    """(m, c) functions on a frame as drawn: 1, coordinates in its mean plane, and their products at
    second order; orthogonal.

    Of a frame that folds, the part that is covered may be seen edgewise there: then the mean is
    that over this part.

    Args:
        Y: (m, gdim) nodes as drawn [length].
        element: of the frame's facets.
        forces: (m,) of unit pressure on what is covered [area].
    """
    every = np.ones(len(Y))
    found = _functions(Y, element, every)
    covered = np.maximum(forces, 0.0) / (forces.max(initial=0.0) or 1.0)
    there = found[covered > 0.0]
    size = np.linalg.norm(there, axis=0)
    seen = np.linalg.svd(there / np.where(size > 0.0, size, 1.0), compute_uv=False)
    if len(there) and seen[-1] < EDGEWISE * seen[0]:
        return _functions(Y, element, covered + ELSEWHERE)
    return found


def _functions(Y: Array, element: Element, weights: Array) -> Array:
    """The same, orthogonal in a weighted (m,) sense."""
    root = np.sqrt(weights / weights.sum())[:, None]
    centred = Y - (root**2 * Y).sum(axis=0)
    axes = np.linalg.svd(root * centred, full_matrices=False)[2]
    s = centred @ axes[:-1].T
    s = s / np.linalg.norm(root * s, axis=0)
    squares = [s[:, a] * s[:, b] for a, b in products(element)]
    functions = np.column_stack([np.ones(len(Y)), s, *squares])
    triangle: Array = np.linalg.qr(root * functions)[1]
    return np.linalg.solve(triangle.T, functions.T).T
