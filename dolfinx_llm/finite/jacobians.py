"""Derivatives by the positions of all nodes of an interface, as sparse matrices.

What is found per pair or facet depends on the positions of a few nodes. Its derivative is a dense
block per item, with the numbers of the coordinates that it knows; chains of derivatives are
products of sparse matrices.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix


def jacobian(blocks: np.ndarray, columns: np.ndarray, width: int) -> csr_matrix:
    """(n r, width) matrix of blocks.

    Args:
        blocks: (n, r, c) derivatives of r values per item by c coordinates.
        columns: (n, c) numbers of these coordinates; repeated ones add up.
        width: number of all coordinates.
    """
    n, r, c = blocks.shape
    # SciPy's own kind of index: it looks for the largest of any other, again and again.
    index = np.broadcast_to(columns[:, None, :], (n, r, c)).astype(np.int32).ravel()
    starts = np.arange(n * r + 1, dtype=np.int32) * c
    matrix = csr_matrix((blocks.ravel(), index, starts), (n * r, width))
    matrix.sum_duplicates()
    return matrix


def coordinates(nodes: np.ndarray, gdim: int, first: int = 0) -> np.ndarray:
    """(..., k gdim) numbers of the coordinates of nodes (..., k); the first node's is ``first``."""
    found = first + gdim * nodes[..., None] + np.arange(gdim)
    return found.reshape(*nodes.shape[:-1], nodes.shape[-1] * gdim)


def cross_matrix(w: np.ndarray) -> np.ndarray:
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
