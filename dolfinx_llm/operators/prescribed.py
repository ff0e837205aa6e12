"""Rows at prescribed dofs."""

import numpy as np
from scipy.linalg import qr
from scipy.sparse import csr_matrix

REPEATED = 1e-6  # part of base vectors at free dofs that counts as none


def prescribed_rows(
    L: csr_matrix, prescribed: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows (k,) of a frame's L_b at prescribed dofs, a basis (k, r) of their column space, with
    which the multipliers of least size are basis basisᵀ λ, and the redundant rows (k - r,).

    Where both bodies have prescribed dofs on the contact surface (a symmetry plane through it),
    these rows bind the frame alone, and more of them than the frame has nodes there. Those that
    follow from the others must go, or (31) is singular in λ.
    """
    rows = np.flatnonzero(prescribed)
    basis = column_space(L[rows])
    if not basis.size:
        return rows, basis, rows
    pivots = qr(basis.T, mode="r", pivoting=True)[1]
    return rows, basis, rows[np.sort(pivots[basis.shape[1] :])]


def free_parts(free: np.ndarray, c: int) -> np.ndarray:
    """(n c,) how much each row of a node, c base vectors (n c, gdim) at free dofs, moves that its
    rows before leave free, the normal row, the last one, before all others. A node that supports
    let move one way alone is held by its normal row; its tangential rows would say that twice."""
    vectors = free.reshape(-1, c, free.shape[1]).copy()
    size = np.zeros(vectors.shape[:2])
    for i in (c - 1, *range(c - 1)):
        size[:, i] = np.linalg.norm(vectors[:, i], axis=1)
        unit = vectors[:, i] / np.maximum(size[:, i], 1e-300)[:, None]
        unit[size[:, i] < REPEATED] = 0.0
        vectors -= np.einsum("ncg,ng->nc", vectors, unit)[:, :, None] * unit[:, None, :]
    return size.ravel()


def column_space(D: csr_matrix) -> np.ndarray:
    """(k, r) orthonormal basis of the columns of a matrix (k, m)."""
    dense = D[:, np.unique(D.indices)].toarray()
    if not dense.size:
        return np.zeros((D.shape[0], 0))
    basis, size, _ = np.linalg.svd(dense, full_matrices=False)
    return basis[:, size > 1e-8 * size[0]]
