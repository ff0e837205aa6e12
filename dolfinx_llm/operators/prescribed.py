"""Rows at prescribed dofs."""

from __future__ import annotations

import numpy as np
from scipy.linalg import qr
from scipy.sparse import csr_matrix


def prescribed_rows(
    L: csr_matrix, prescribed: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which rows of L_b hold prescribed dofs, and which of them say nothing new.

    Where both bodies have prescribed dofs on the contact surface (a symmetry plane through it),
    these rows bind the frame alone, and more of them than the frame has nodes there. Those that
    follow from the others must go, or (31) is singular in λ.

    Args:
        L: L_b of one frame.
        prescribed: (n_rows,) whether the body's dof of a row is prescribed.

    Returns:
        rows (k,) of prescribed dofs; basis (k, r) of their column space, with which the multipliers
        of least size are basis basisᵀ λ; redundant rows (k - r,).
    """
    rows = np.flatnonzero(prescribed)
    D = L[rows]
    D = D[:, np.unique(D.indices)].toarray()
    if not D.size:
        return rows, np.zeros((len(rows), 0)), rows
    basis, size, _ = np.linalg.svd(D, full_matrices=False)
    basis = basis[:, size > 1e-8 * size[0]]
    pivots = qr(basis.T, mode="r", pivoting=True)[1]
    return rows, basis, rows[np.sort(pivots[basis.shape[1] :])]
