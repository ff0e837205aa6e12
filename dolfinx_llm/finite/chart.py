"""Polynomials that rows of a moving frame reproduce: linear ones, at second order squares too."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np

from dolfinx_llm.geometry.element import Element


def products(element: Element) -> list[tuple[int, int]]:
    """Of coordinates along a frame: the squares that its rows reproduce; none at first order."""
    if element.order == 1:
        return []
    return list(combinations_with_replacement(range(element.dim), 2))


def chart(Y: np.ndarray, element: Element) -> np.ndarray:
    """(m, c) orthogonal functions on a frame as drawn: 1, coordinates in its mean plane, and their
    products at second order."""
    centred = Y - Y.mean(axis=0)
    _, _, axes = np.linalg.svd(centred, full_matrices=False)
    s = centred @ axes[:-1].T
    functions = np.column_stack([np.ones(len(Y)), s])
    if element.order > 1:
        s = s / np.linalg.norm(s, axis=0).max()
        squares = [s[:, a] * s[:, b] for a, b in products(element)]
        functions = np.column_stack([functions, *squares])
        functions = np.linalg.qr(functions / np.linalg.norm(functions, axis=0))[0]
    return functions / np.linalg.norm(functions, axis=0)
