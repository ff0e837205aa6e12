"""Rows that others repeat: at prescribed dofs, and at nodes of several interfaces."""

from __future__ import annotations

import numpy as np
from scipy.linalg import qr, solve_triangular
from scipy.sparse import csr_matrix, diags, identity
from scipy.sparse.csgraph import connected_components, reverse_cuthill_mckee

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import largest_entry, symmetric_factors

REPEATED = 1e-6  # part of base vectors at free dofs that counts as none
NEARLY_FIXED = 1e-3  # part of a row's base vector at free dofs, below which the row gives way
RANK = 1e-8  # of the largest: singular values below are none
SAID = 0.05  # part of a row at supports that must be new, of the largest entry: by less it would
# hold a frame's node, as one beside a support, by forces as many times larger
UNBOUND = 1e-12  # of the largest entry: rounding, which binds no rows together
INCOMING = 64  # rows that come in together
DAMPED = 1e-14  # added to squares of singular values, of the largest column's
PROJECTIONS, GAIN = 30, 0.9  # of iteration against it, and what each must leave at most


def free_parts(free: Array, c: int) -> Array:
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


def place_among(group: Array) -> Array:
    """(n,) which of its group each item is, by their order; ``group`` (n,) counts from 0."""
    order, place = np.argsort(group, kind="stable"), np.empty(len(group), dtype=np.int64)
    place[order] = np.arange(len(group)) - np.searchsorted(group[order], group[order])
    return place


def acting_on(dofs: Array, vectors: Array) -> csr_matrix:
    """(k, number of dofs that they act on) vectors (k, gdim) at dofs (k, gdim) of nodes."""
    kept = vectors != 0.0
    row = np.broadcast_to(np.arange(len(dofs))[:, None], dofs.shape)
    _, col = np.unique(dofs[kept], return_inverse=True)
    entries = vectors[kept], (row[kept], col)
    return csr_matrix(entries, (len(dofs), col.max(initial=-1) + 1))


def without_rounding(D: csr_matrix) -> csr_matrix:
    """The same, but for entries that bind no rows together."""
    D = D.copy()
    D.data[np.abs(D.data) <= UNBOUND * largest_entry(D)] = 0.0
    D.eliminate_zeros()
    return D


def pieces(D: csr_matrix) -> list[Array]:
    """Rows of a matrix that hang together by its columns, piece by piece."""
    if not D.shape[0]:
        return []
    size = abs(without_rounding(D))
    _, piece = connected_components(size @ size.T, directed=False)
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
            self._factor = symmetric_factors(square + self.least * identity(D.shape[1]))

    def without(self, values: Array) -> Array:
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


def repeated(D: csr_matrix, gaps: Array, joints: Array) -> Array:
    """(k,) whether rows of D follow from the others, or hardly say more. Of those that say the same
    those of the least gaps (k,) are not: ends that supports hold apart are not to be closed. What
    hangs together with ``joints`` (k,), rows of nodes of several interfaces, says what it says: a
    constant stress would not pass without."""
    least = 1.0 / (1.0 + np.abs(gaps) / max(np.abs(gaps).max(initial=0.0), 1e-300))
    D, near = (diags(least) @ D).tocsr(), np.zeros(len(joints), dtype=bool)
    for piece in pieces(D):
        near[piece] = joints[piece].any()
    out = np.zeros(len(joints), dtype=bool)
    for own, new in ((near, RANK), (~near, SAID)):
        out[own] = _others(D[own], new)
    return out


def _others(D: csr_matrix, least: float) -> Array:
    """(k,) which are not among ``independent_rows``."""
    out = np.ones(D.shape[0], dtype=bool)
    out[independent_rows(D.tocsr(), least)] = False
    return out


def in_loops(D: csr_matrix) -> Array:
    """(k,) whether rows of D are of a piece in which some follow from the others."""
    out, follow = np.zeros(D.shape[0], dtype=bool), _others(D, RANK)
    for piece in pieces(D):
        out[piece] = follow[piece].any()
    return out


def independent_rows(D: csr_matrix, least: float = RANK) -> Array:
    """Rows of D (k, m), as many as its rank, from which the others follow; far from dependent.

    Rows come in, some at a time, in an order of small bandwidth. Columns of which no more rows
    come are eliminated by the rows that tell them best, which are taken. Of the others, what these
    do not explain waits for more columns; where nothing is left of a row, above ``least`` of the
    largest entry, it follows from others.
    """
    scale = abs(D).max() if D.nnz else 0.0
    if not scale:
        return np.zeros(0, dtype=np.int64)
    order = reverse_cuthill_mckee((D @ D.T).tocsr(), symmetric_mode=True)
    D, none = (D[order] / scale).tocsc(), np.zeros(0, dtype=np.int64)
    filled = np.flatnonzero(np.diff(D.indptr))
    D = D[:, filled].tocsc()
    D.sort_indices()
    ends = D.indices[D.indptr[1:] - 1]  # last row of each column
    D = D.tocsr()
    rows, columns, left, taken = none, none, np.zeros((0, 0)), []
    for first in range(0, len(order), INCOMING):
        new = np.arange(first, min(first + INCOMING, len(order)))
        seen = np.union1d(columns, D[new].indices)
        front = np.zeros((len(rows) + len(new), len(seen)))
        front[: len(rows), np.searchsorted(seen, columns)] = left
        front[len(rows) :] = D[new][:, seen].toarray()
        rows, done = np.concatenate([rows, new]), ends[seen] <= new[-1]
        R, pivots = np.zeros((0, len(rows))), np.arange(len(rows))
        if done.any():
            R, pivots = qr(front[:, done].T, mode="r", pivoting=True)
        r = int((np.abs(np.diag(R)) > least).sum())
        own, others = pivots[:r], pivots[r:]
        left = front[others][:, ~done]
        if r:
            left = left - solve_triangular(R[:r, :r], R[:r, r:]).T @ front[own][:, ~done]
        taken.append(rows[own])
        more = np.abs(left).max(axis=1, initial=0.0) > least
        rows, columns, left = rows[others[more]], seen[~done], left[more]
    return np.sort(order[np.concatenate(taken)])
