"""Rows at prescribed dofs."""

from __future__ import annotations

import numpy as np
from scipy.linalg import qr
from scipy.sparse import csr_matrix, identity
from scipy.sparse.csgraph import connected_components, min_weight_full_bipartite_matching
from scipy.sparse.linalg import splu

REPEATED = 1e-6  # part of base vectors at free dofs that counts as none
RANK = 1e-8  # of the largest: singular values below are none
SMALL = 200  # rows or columns up to which dense algebra is as fast
DAMPED = 1e-14  # added to squares of singular values, of the largest column's
PROJECTIONS, GAIN = 30, 0.9  # of iteration against it, and what each must leave at most
CONDITION = 1e3  # of independent rows that are chosen one for each column
EXCHANGES, TURNS = 100, 4  # of these rows for others; steps of inverse iteration in each


def prescribed_rows(
    L: csr_matrix, prescribed: np.ndarray
) -> tuple[np.ndarray, ColumnSpace, np.ndarray]:
    """Rows (k,) of a frame's L_b at prescribed dofs, their column space, on which the multipliers
    of least size are the projections of others, and the redundant rows.

    Where both bodies have prescribed dofs on the contact surface (a symmetry plane through it),
    these rows bind the frame alone, and more of them than the frame has nodes there. Those that
    follow from the others must go, or (31) is singular in λ.
    """
    rows = np.flatnonzero(prescribed)
    D = L[rows]
    kept = [own[independent_rows(D[own])] for own in pieces(D)]
    redundant = np.delete(rows, np.concatenate(kept)) if kept else rows
    return rows, ColumnSpace(D), redundant


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


def pieces(D: csr_matrix) -> list[np.ndarray]:
    """Rows of a matrix that hang together by its columns, piece by piece."""
    if not D.shape[0]:
        return []
    _, piece = connected_components(D @ D.T, directed=False)
    ends = np.cumsum(np.bincount(piece))[:-1]
    return np.split(np.argsort(piece, kind="stable"), ends)


class ColumnSpace:
    """Projections on the columns of D (k, m), of any rank.

    D (DᵀD + q)⁻¹ Dᵀ, iterated: what a direction of singular value σ still lacks falls by
    q / (σ² + q) each time, so that what is next to none in D stays none.
    """

    def __init__(self, D: csr_matrix) -> None:
        self.D = D = D[:, np.unique(D.indices)]
        square = (D.T @ D).tocsc()
        self.least = DAMPED * float(square.diagonal().max(initial=0.0))
        self._factor = None
        if self.least:
            self._factor = splu(
                square + self.least * identity(D.shape[1], format="csc"),
                permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True},
            )  # fmt: skip

    def without(self, values: np.ndarray) -> np.ndarray:
        """What of values (k,) or (k, j) is orthogonal to all columns."""
        if self._factor is None:
            return values
        least = np.inf
        for _ in range(PROJECTIONS):
            seen = self.D.T @ values
            last, least = least, np.abs(seen).max(initial=0.0)
            if not least <= GAIN * last:
                break
            values = values - self.D @ self._factor.solve(seen)
        return values


def independent_rows(D: csr_matrix) -> np.ndarray:
    """Rows of D (k, m), as many as its rank, from which the others follow."""
    if not D.count_nonzero() or D.shape[0] == 1:
        return np.arange(D.count_nonzero() > 0)
    D = D[:, np.unique(D.indices)]
    if SMALL < D.shape[1] <= D.shape[0]:
        rows = _matched_rows(D)
        if len(rows):
            return rows
    R, order = qr(D.T.toarray(), mode="r", pivoting=True)
    size = np.abs(np.diag(R))
    return np.sort(order[: int((size > RANK * size[0]).sum())])


def _matched_rows(D: csr_matrix) -> np.ndarray:
    """Rows of D (k, m), one for each column, that are far from dependent; none where the columns
    are not.

    Those of the largest product of entries to begin with. While these hardly tell a direction v,
    the row that tells it best takes the place of the one that tells it best among them.
    """
    size = abs(D).tocsr()
    size.eliminate_zeros()
    largest = size.sum(axis=0).max()
    size.data = 1.0 - np.log(size.data / size.data.max())
    v = np.random.default_rng(2001).normal(size=D.shape[1])
    try:
        rows, _ = min_weight_full_bipartite_matching(size)
        for _ in range(EXCHANGES):
            factor = splu(D[rows].tocsc())
            for _ in range(TURNS):  # towards the smallest singular value
                v = factor.solve(factor.solve(v / np.linalg.norm(v), "T"))
            told = np.abs(D @ (v / np.linalg.norm(v)))
            if np.linalg.norm(told[rows]) * CONDITION >= largest:
                return np.sort(rows)
            others = np.delete(np.arange(len(told)), rows)
            rows[told[rows].argmax()] = others[told[others].argmax()]
    except (ValueError, RuntimeError):  # columns without a row of their own
        pass
    return np.zeros(0, dtype=np.int64)
