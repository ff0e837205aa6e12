"""Elimination of constrained surface displacements: u = T q + u_0; NumPy and SciPy only.

A row of L_b with base vector a at node p says a · u_p = L_b v - g. It is solved for the node's free
dofs. What is left where there are none (symmetry planes, nodes in several interfaces) binds the
frame alone, D v = g_D, and is solved for some of the frame's unknowns.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.linalg import qr, solve_triangular
from scipy.sparse import coo_matrix, csr_matrix, hstack
from scipy.sparse.linalg import splu

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import chosen, told
from dolfinx_llm.base.sparse import diagonal, placed
from dolfinx_llm.operators.numbering import Numbering
from dolfinx_llm.operators.prescribed import RANK, REPEATED, pieces, place_among, without_rounding

SMALL = 200  # rows or columns up to which dense algebra is as fast
TURNS = 4  # steps of inverse iteration
NO_CONTRADICTION = 1e-10  # of the largest gap: contradictions that are rounding
ORTHONORMAL = 1e-15  # by which products of rows may be off: rounding
CLEAR = 1e-3  # of the largest column: smallest singular value with which squares are solved


@dataclass(frozen=True, eq=False)
class EliminatedRows:
    """The rows of L_b of all frames that tie surface nodes to them, on every rank."""

    dofs: Array  # (rows, gdim) numbers, in the vector of all bodies, of the node's dofs
    base: Array  # (rows, gdim) base vectors, orthonormal at each node
    L: csr_matrix  # (rows, m) L_b
    multipliers: Numbering  # of the rows
    frames: Numbering  # of the columns
    items: Array  # (m,) node of each frame unknown, ascending: they share a block
    gdim: int  # dimensions of space

    def __post_init__(self) -> None:
        rows, m = len(self.dofs), self.frames.sizes[1]
        if self.L.shape != (rows, m) or self.multipliers.sizes[1] != rows:
            raise ValueError(
                f"L has the shape {self.L.shape}: {rows} eliminated components, "
                f"{self.multipliers.sizes[1]} multipliers and {m} frame unknowns need ({rows}, {m})"
            )

    @property
    def local(self) -> tuple[Array, Array]:
        """(R, gdim) dofs and base vectors of this rank's rows, in the order of their numbers."""
        return self.dofs[self.multipliers.mine], self.base[self.multipliers.mine]


def widest(L: csr_matrix, gdim: int) -> float:
    """Nodes that the row of a frame node couples with in the condensed matrix, about: those of two
    layers of cells next to the c surface nodes that follow it, 2 (sqrt(c) + 2)^2; or those that a
    surface node follows together."""
    c = np.bincount(L.indices, minlength=1).max()
    own = float(np.diff(L.indptr).max(initial=0))
    return max(own, 2.0 * (c ** (1.0 / (gdim - 1)) + 2.0) ** (gdim - 1))


@dataclass(frozen=True, eq=False)
class NodeElimination:
    """u = A (L_b v - g) + N w at some dofs of one rank, and the rows that bind the frame alone."""

    A: csr_matrix  # (S, R)
    N: csr_matrix  # (S, S) the identity away from the contact, without what is fixed
    W: csr_matrix  # (k, R) orthonormal combinations of rows that move no free dof


def eliminate_at_nodes(dofs: Array, vectors: Array, fixed: Array) -> NodeElimination:
    """Solve each node's rows S u_p = L_b v - g for its free dofs, with the pseudo-inverse of S;
    rows have (R, gdim) dofs and base vectors. The directions that they leave free get unknowns w in
    the places of the node's free dofs. Dofs count among those whether they are ``fixed``, (S,)."""
    R, gdim = dofs.shape
    n = len(fixed)
    _, group = np.unique(dofs[:, 0], return_inverse=True)
    place = place_among(group)  # of a row among its node's: interfaces may share nodes
    shape = group.max(initial=-1) + 1, place.max(initial=0) + 1
    nodes = np.zeros((shape[0], gdim), dtype=np.int64)
    nodes[group] = dofs
    there = np.zeros(shape)
    there[group, place] = 1.0
    free = ~fixed[nodes]
    S = np.zeros((*shape, gdim))
    S[group, place] = vectors * free[group]
    S[np.linalg.norm(S, axis=2) <= REPEATED] = 0.0  # where it is all that there is, too
    inverse = _inverses(S)
    value = inverse[group, :, place]
    A = placed(value, dofs, np.arange(R)[:, None], (n, R))

    away = ~fixed
    away[nodes[free]] = False
    N = diagonal(away)
    g, j, vector = _unit_eigenvectors(free[:, :, None] * np.eye(gdim) - inverse @ S)
    if len(g):
        seat = np.argsort(~free, axis=1, kind="stable")[g, j]  # free dofs first
        N = N + placed(vector, nodes[g], nodes[g, seat][:, None], (n, n))
    g, j, vector = _unit_eigenvectors(there[:, :, None] * np.eye(shape[1]) - S @ inverse)
    row = np.zeros(shape, dtype=np.int64)
    row[group, place] = np.arange(R)
    W = placed(vector, np.arange(len(g))[:, None], row[g], (len(g), R))
    return NodeElimination(A, N, W)


def _inverses(S: Array) -> Array:
    """Pseudo-inverses of S (n, r, c): transposes, where rows are orthonormal, or 0."""
    inverse = S.transpose(0, 2, 1).copy()
    off = S @ inverse
    size = np.einsum("nrr->nr", off)
    size[size > 0.5] -= 1.0
    rest = np.flatnonzero(np.abs(off).max(axis=(1, 2), initial=0.0) > ORTHONORMAL)
    inverse[rest] = np.linalg.pinv(S[rest], rcond=REPEATED)
    return inverse


def _unit_eigenvectors(P: Array) -> Any:
    """Orthonormal bases of the ranges of projectors P (n, k, k): matrix, place, vector of each."""
    some = np.flatnonzero(np.einsum("nkk->n", P) > 0.5)  # traces are their ranks
    values, vectors = np.linalg.eigh(P[some])
    g, column = np.nonzero(values > 0.5)  # ascending: the last ones
    first = P.shape[1] - np.bincount(g, minlength=len(some))
    vector = vectors[g, :, column]
    vector[np.abs(vector) < 1e-15] = 0.0
    return some[g], column - first[g], vector


@dataclass(frozen=True, eq=False)
class BoundUnknowns:
    """Frame unknowns that rows of D which hang together determine."""

    rows: Array  # (k,) of D
    dependent: Array  # (r,) columns that they determine
    others: Array  # (i,) columns by which these move
    motion: Array  # (r, i) how
    Q: Array  # (k, r) basis of the dependent columns; needed where rows give way
    solve: Callable[[Array], Array]  # (r,) of g (k,), by least squares
    forces: Callable[[Array], Array]  # (k,) of b (r,): smallest μ with D_depᵀ μ = b


class FrameElimination:
    """v = Z v + v_0 with D Z = 0, D v_0 = g_D: the frame's unknowns that D determines go. The rows
    of D (k, m) bind the frame alone; those that hang together are solved by themselves.

    By QR with column pivoting, D P = Q [R_1 R_2]: v_dep = R_1⁻¹ (Qᵀ g_D - R_2 v_ind). The others
    stay the unknowns they were, so that rigid modes need no transformation. Where many rows
    determine all unknowns that they touch, D stays sparse: v_dep = (DᵀD)⁻¹ Dᵀ g_D.

    With S (k, k) over c, S = ``soft``, the rows give way, D v = g_D - S μ / c. Their forces μ =
    c Q ν are then unknowns ν in the places of v_dep, and Z has columns -R_1⁻¹ Qᵀ S Q there.

    Which unknowns go is the same on all ranks of ``comm``.
    """

    def __init__(self, comm: MPI.Comm, D: csr_matrix, soft: csr_matrix | None = None) -> None:
        self.shape = k, m = D.shape
        self._gives = np.zeros(k) if soft is None else soft.diagonal()
        D = without_rounding(D)  # one piece's rounding is no motion of what another determines
        joint = D if soft is None else hstack([D, soft], format="csr")
        size = np.sqrt(D.multiply(D).sum(axis=0).max()) if D.nnz else 1.0
        found = chosen(comm, lambda: _touching(D, joint))
        self._parts = [_bound(comm, D, *part, size, soft) for part in found]
        ends = np.cumsum([0, *(len(part.dependent) for part in self._parts)])
        self._own = [slice(*pair) for pair in itertools.pairwise(ends)]
        self.dependent = np.zeros(ends[-1], dtype=np.int64)
        for part, own in zip(self._parts, self._own, strict=True):
            self.dependent[own] = part.dependent
        kept = np.ones(m)
        kept[self.dependent] = 0.0
        moved = [(part.dependent, part.others, part.motion) for part in self._parts]
        self.Z = diagonal(kept) + _scattered(moved, (m, m)) if moved else diagonal(kept)

    @cached_property
    def Q(self) -> csr_matrix:
        """(k, r) basis of the dependent columns; of rows that give way."""
        places = np.arange(len(self.dependent))
        blocks = [(part.rows, places[own], part.Q) for part, own in zip(self._parts, self._own)]
        return _scattered(blocks, (self.shape[0], len(places)))

    def particular(self, g_D: Array) -> Array:
        """(m,) v_0 with D v_0 = g_D (k,)."""
        v = np.zeros(self.shape[1])
        for part in self._parts:
            v[part.dependent] = part.solve(g_D[part.rows])
        return v

    def contradicting(self, g_D: Array, c: float) -> Array:
        """(k,) forces μ with Dᵀ μ = 0 of rows that give way, of gaps g_D (k,) that contradict each
        other by more than rounding; c is their unit of stiffness [force / length]."""
        left, least = g_D.copy(), NO_CONTRADICTION * np.abs(g_D).max(initial=0.0)
        for part in self._parts:
            left[part.rows] -= part.Q @ (part.Q.T @ g_D[part.rows])
        told = (np.abs(left) > least) & (self._gives > 0.0)
        return np.where(told, c * left / np.where(told, self._gives, 1.0), 0.0)

    def multipliers(self, b: Array) -> Array:
        """(k,) smallest μ with Dᵀ μ = b, from b (r,) at the dependent unknowns."""
        mu = np.zeros(self.shape[0])
        for part, own in zip(self._parts, self._own, strict=True):
            mu[part.rows] = part.forces(b[own])
        return mu


def _scattered(blocks: Any, shape: tuple[int, int]) -> csr_matrix:
    """Sparse sum of (rows, columns, dense block)."""
    found = csr_matrix(shape)
    for rows, columns, block in blocks:
        block = coo_matrix(block)
        at = rows[block.row], columns[block.col]
        found = found + csr_matrix((block.data, at), shape=shape)
    return found


def _gathered(D: csr_matrix) -> list[Array]:
    """Rows that hang together, small pieces several at once."""
    found = sorted(pieces(D), key=len)
    ends = np.cumsum([len(rows) for rows in found], dtype=np.int64)
    cuts = ends[:-1][np.diff(ends // SMALL) > 0]
    return np.split(np.concatenate(found), cuts) if found else []


def _touching(D: csr_matrix, joint: csr_matrix) -> list[tuple[Array, Array]]:
    """Rows of D that hang together by ``joint``, and the columns that they touch, if any."""
    found = [(rows, np.unique(D[rows].indices)) for rows in _gathered(joint)]
    return [(rows, touched) for rows, touched in found if len(touched)]


def _bound(
    comm: MPI.Comm,
    D: csr_matrix,
    rows: Array,
    touched: Array,
    size: float,
    soft: csr_matrix | None,
) -> BoundUnknowns:
    """What some rows of D determine that touch some columns; its largest column has this size."""
    A = D[rows][:, touched]
    if soft is None and len(touched) > SMALL:
        factor, clear = _factor_of_squares(A, size)
        if told(comm, clear):
            return _determined(A, rows, touched, factor)
    Q, R, order = chosen(comm, lambda: _triangle(A, size))
    r = R.shape[0]
    R, rest = R[:, :r], R[:, r:]
    X = -solve_triangular(R, rest) if r else rest
    X[np.abs(X) < 1e-15] = 0.0
    dependent, others = touched[order[:r]], touched[order[r:]]
    if soft is not None:
        give = -solve_triangular(R, Q.T @ (soft[rows][:, rows] @ Q))
        X, others = np.hstack([X, give]), np.concatenate([others, dependent])
    return BoundUnknowns(
        rows, dependent, others, X, Q,
        lambda g: solve_triangular(R, Q.T @ g),
        lambda b: Q @ solve_triangular(R, b, trans="T"),
    )  # fmt: skip


def _triangle(A: csr_matrix, size: float) -> tuple[Array, Array, Array]:
    """Q, R and pivots of A, as many rows as its rank, for a largest column of this size."""
    Q, R, order = qr(A.toarray(), mode="economic", pivoting=True)
    r = int((np.abs(np.diag(R)) > RANK * size).sum())
    return Q[:, :r], R[:r], order


def _determined(A: csr_matrix, rows: Array, columns: Array, factor: Any) -> BoundUnknowns:
    """Rows A (k, r) that determine all that they touch, with the factors of AᵀA; each solution is
    corrected once, which brings back what squaring costs."""

    def solve(g: Array) -> Array:
        v = factor.solve(A.T @ g)
        return v + factor.solve(A.T @ (g - A @ v))

    def forces(b: Array) -> Array:
        y = factor.solve(b)
        return A @ (y + factor.solve(b - A.T @ (A @ y)))

    none = np.zeros((len(columns), 0))
    return BoundUnknowns(rows, columns, columns[:0], none, none, solve, forces)


def _factor_of_squares(A: csr_matrix, size: float) -> tuple[Any, bool]:
    """Factors of AᵀA, and whether A's smallest singular value is clearly above zero."""
    v = np.random.default_rng(2001).normal(size=A.shape[1])
    try:
        factor = splu(
            (A.T @ A).tocsc(),
            permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True},
        )  # fmt: skip
    except RuntimeError:  # exactly singular
        return None, False
    for _ in range(TURNS):
        v = factor.solve(v / np.linalg.norm(v))
    return factor, bool(np.linalg.norm(v) * (CLEAR * size) ** 2 < 1.0)
