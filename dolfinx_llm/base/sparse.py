"""Sparse matrices of simple patterns, made of their arrays: where interfaces are small SciPy's own
constructors, by way of other formats, cost more than all that is done with the matrices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import block_diag, csr_matrix, vstack
from scipy.sparse.linalg import splu

from dolfinx_llm.base.arrays import Array

NO_ROWS = csr_matrix((0, 0))
EQUALS = 1e-9  # part by which entries differ that are the same but for rounding


def diagonal(values: Array) -> csr_matrix:
    """(n, n) diagonal matrix of values (n,), without those that are 0.

    >>> diagonal(np.array([2, 0, 3])).toarray().tolist()
    [[2.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 3.0]]
    """
    n, at = len(values), np.flatnonzero(values)
    data = np.asarray(values, dtype=float)[at]
    return csr_matrix((data, _small(at), _starts(values != 0)), (n, n))


def per_item(blocks: Array) -> csr_matrix:
    """(n r, n c) block diagonal matrix of (n, r, c) blocks."""
    n, r, c = blocks.shape
    columns = np.arange(n * c, dtype=np.int32).reshape(n, 1, c).repeat(r, axis=1)
    starts = np.arange(n * r + 1, dtype=np.int32) * c
    return csr_matrix((blocks.ravel(), columns.ravel(), starts), (n * r, n * c))


def summing(rows: Array, n: int) -> csr_matrix:
    """(n, k) sums of entries (k,) at their rows.

    >>> summing(np.array([2, 0, 2]), 3).toarray().tolist()
    [[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 1.0]]
    """
    order = _small(np.argsort(rows, kind="stable"))
    starts = _starts(np.bincount(rows, minlength=n))
    return csr_matrix((np.ones(len(rows)), order, starts), (n, len(rows)))


def picking(columns: Array, m: int) -> csr_matrix:
    """(k, m) matrix that picks entries, by their columns (k,)."""
    k = len(columns)
    return csr_matrix((np.ones(k), _small(columns), np.arange(k + 1, dtype=np.int32)), (k, m))


def placed(values: Array, rows: Array, columns: Array, shape: tuple[int, int]) -> csr_matrix:
    """Sums of values at rows and columns, which are broadcast to them; without zeros.

    >>> placed(np.ones((1, 2, 2)), np.array([[[0], [1]]]), np.array([[[1, 1]]]), (2, 2)).toarray()
    array([[0., 2.],
           [0., 2.]])
    """
    there = values != 0.0
    if not there.any():
        return csr_matrix(shape)
    row, column = (np.broadcast_to(at, values.shape)[there] for at in (rows, columns))
    return summed(values[there], row, column, shape)


def summed(values: Array, rows: Array, columns: Array, shape: tuple[int, int]) -> csr_matrix:
    """Sums of values (k,) at rows and columns (k,), zeros as well."""
    order, starts = np.argsort(rows, kind="stable"), _starts(np.bincount(rows, minlength=shape[0]))
    found = csr_matrix((values[order], _small(columns[order]), starts), shape)
    found.sum_duplicates()
    return found


def of_rows(matrix: csr_matrix, rows: Array) -> csr_matrix:
    """Some rows of a matrix, by their numbers, which ascend: the matrix itself where it is all."""
    return matrix if len(rows) == matrix.shape[0] else matrix[rows]


def pushed(matrix: csr_matrix, forces: Array) -> Array:
    """(m,) or (m, k) product of the transpose of an (n, m) matrix and forces (n,) or (n, k).

    >>> pushed(csr_matrix([[1.0, 2.0], [0.0, 3.0]]), np.array([1.0, 10.0])).tolist()
    [1.0, 32.0]
    """
    if forces.ndim > 1:
        return np.column_stack([pushed(matrix, column) for column in forces.T])
    at = np.repeat(forces, np.diff(matrix.indptr))
    return np.bincount(matrix.indices, matrix.data * at, matrix.shape[1])


def nearest(weights: csr_matrix) -> csr_matrix:
    """The largest entries of each row, in equal parts of 1 where they differ by rounding alone.

    >>> nearest(csr_matrix([[0.3, 0.1, 0.3], [0.0, 0.0, 0.0]])).toarray().tolist()
    [[0.5, 0.0, 0.5], [0.0, 0.0, 0.0]]
    """
    found = weights.tocsr(copy=True)
    most = found.max(axis=1).toarray()[:, 0]
    least = (1.0 - EQUALS) * np.repeat(most, np.diff(found.indptr))
    found.data = (found.data > least).astype(float)
    found.eliminate_zeros()
    count = np.diff(found.indptr)
    found.data /= np.repeat(count, count)
    return found


def of_nearest(near: csr_matrix, values: Array) -> Array:
    """(n,) the largest of values (k,) at what is near, True in (n, k).

    >>> of_nearest(csr_matrix([[True, True], [True, False]]), np.array([1, 2])).tolist()
    [2, 1]
    """
    found = near.multiply(values).max(axis=1).toarray()[:, 0]
    return np.asarray(found.astype(values.dtype))


def largest_entry(matrix: csr_matrix) -> float:
    """Largest absolute value; 0 of none.

    >>> largest_entry(csr_matrix([[0.0, -2.0], [1.0, 0.0]])), largest_entry(csr_matrix((2, 2)))
    (2.0, 0.0)
    """
    return float(np.abs(matrix.data).max(initial=0.0))


def beside(blocks: Sequence[csr_matrix]) -> csr_matrix:
    """Block diagonal matrix; a single block as it is.

    >>> beside([csr_matrix([[1.0]]), csr_matrix([[2.0]])]).toarray().tolist()
    [[1.0, 0.0], [0.0, 2.0]]
    """
    return blocks[0] if len(blocks) == 1 else block_diag(blocks, format="csr")


def below(blocks: Sequence[csr_matrix]) -> csr_matrix:
    """One below the other; a single one as it is.

    >>> below([csr_matrix([[1.0]]), csr_matrix([[2.0]])]).toarray().tolist()
    [[1.0], [2.0]]
    """
    return blocks[0] if len(blocks) == 1 else vstack(blocks, format="csr")


def joined(blocks: Sequence[csr_matrix], shape: tuple[int, int] | None = None) -> csr_matrix:
    """Blocks along the diagonal, filled up with zeros to a shape."""
    ends = np.cumsum([(0, 0), *(block.shape for block in blocks)], axis=0)
    rows, columns = ends[-1] if shape is None else shape
    count = [np.diff(block.indptr) for block in blocks]
    starts = np.concatenate([[0], *count, np.zeros(rows - ends[-1, 0], dtype=int)]).cumsum()
    at = zip(blocks, ends[:, 1], strict=False)
    index = np.concatenate([np.zeros(0, dtype=np.int32), *(b.indices + c for b, c in at)])
    values = np.concatenate([np.zeros(0), *(block.data for block in blocks)])
    return csr_matrix((values, index, starts), (rows, columns))


def renumbered(matrix: csr_matrix, columns: Array, m: int) -> csr_matrix:
    """(n, m) matrix of the same entries, with other numbers of the columns (k,).

    >>> renumbered(csr_matrix([[1.0, 2.0]]), np.array([2, 0]), 3).toarray().tolist()
    [[2.0, 0.0, 1.0]]
    """
    index = _small(columns[matrix.indices])
    return csr_matrix((matrix.data, index, matrix.indptr), (matrix.shape[0], m))


def symmetric_factors(A: Any, pivots: bool = False) -> Any:
    """Factors of a symmetric matrix, which needs no pivots where it is definite."""
    own = {} if pivots else {"diag_pivot_thresh": 0.0}
    options = {"SymmetricMode": True}
    return splu(A.tocsc(), permc_spec="MMD_AT_PLUS_A", options=options, **own)


def per_component(matrix: csr_matrix, d: int) -> csr_matrix:
    """(n d, m d) the same (n, m) matrix for each of d components, those of an item together.

    >>> per_component(csr_matrix([[0.0, 2.0]]), 2).toarray().tolist()
    [[0.0, 0.0, 2.0, 0.0], [0.0, 0.0, 0.0, 2.0]]
    """
    count = np.diff(matrix.indptr).repeat(d)
    starts = _starts(count)
    # Entries of row i are repeated from row to row of its components.
    at = np.arange(starts[-1]) - (starts[:-1] - matrix.indptr[:-1].repeat(d)).repeat(count)
    columns = d * matrix.indices[at] + (np.arange(len(count)) % d).repeat(count)
    shape = matrix.shape[0] * d, matrix.shape[1] * d
    return csr_matrix((matrix.data[at], _small(columns), starts), shape)


def _starts(count: Array) -> Array:
    """(n + 1,) where rows of so many entries (n,) start."""
    return np.concatenate([[0], np.cumsum(count)]).astype(np.int32)


def _small(index: Array) -> Array:
    """SciPy's own kind of index: it looks for the largest of any other, again and again."""
    return np.asarray(index, dtype=np.int32)
