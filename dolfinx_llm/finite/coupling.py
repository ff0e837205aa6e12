"""What contact and follower loads do to Newton's system, and its part in a preconditioner.

    [K    top] [du]   [r]
    [left own] [dq] = [s]

The preconditioner is of this system with rows that yield beta times as much as the stiffness d of
their own nodes would let them, own' = own - beta / d left top for each pair alone, and without the
derivatives of rows and normals. Condensed onto u that is a stiffness between node p and its point
of the frame,

    C = sum_p J_pᵀ H_p J_p,   J_p u = u_p - sum_J N_pJ u_J,   H_p = -top_p own'_p⁻¹ left_p,

made symmetric and positive semidefinite. It is there for any law, and as surfaces yield by about
1 / d to forces at single nodes, and by more to others, it does not spoil convergence on any mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.sparse import block_diag, csr_matrix
from scipy.sparse.linalg import splu

from dolfinx_llm.base.sparse import diagonal, per_component, per_item
from dolfinx_llm.finite.terms import FAST, ContactTerms
from dolfinx_llm.forms.condensed.krylov import WIDEST
from dolfinx_llm.operators.numbering import BodyDofs

LITTLE = 0.5  # of the largest force of an unknown, below which the preconditioner leaves it out
BETA = 2.0  # by how much rows yield, over what a single node does: less hides them from multigrid


@dataclass(frozen=True, eq=False)
class Condensed:
    """An interface's part of the preconditioner, and its own equations over their size."""

    C: csr_matrix  # (width, width) stiffness of the pairs, zero at prescribed coordinates
    rows: csr_matrix  # (q, width) ``left``; where pairs are concerned without derivatives of rows
    yielding: csr_matrix  # (q, q) own' - own
    scaling: csr_matrix  # (q, q) by which own equations are multiplied

    @classmethod
    def of(cls, t: ContactTerms, sides: Any, free: np.ndarray, d: float) -> Condensed:
        """Of an interface.

        Args:
            t: its part of Newton's system.
            sides: its surfaces.
            free: (width,) coordinates that are not prescribed.
            d: stiffness of a node [force / length].
        """
        n, gdim = t.place.normal.shape
        J = sides.jumps(t.place.N)
        x = np.arange(n * gdim) if sides.frame is None else sides.columns[0].ravel()
        scaling = _scaling(t, free, d)
        left, own = scaling @ t.left, scaling @ t.own
        keep, kept = diagonal(free), diagonal(free[x])
        # Unknowns q of a pair p: forces on its node alone, of second-order bodies on its control
        # value.
        E = per_component(sides.nodal, gdim)
        top = (E.T @ t.top[x]).tocsr()
        if sides.surfaces[sides.moving].element.order > 1:  # normals differ along a facet
            largest = abs(top).max(axis=0).toarray().ravel()
            top.data[np.abs(top.data) < LITTLE * largest[top.indices]] = 0.0
        top.eliminate_zeros()
        on, several = top.tocoo(), np.zeros(len(t.rest), dtype=bool)
        pair = np.full(len(t.rest), -1)
        pair[on.col] = on.row // gdim
        several[on.col[pair[on.col] != on.row // gdim]] = True
        pair[several] = -1
        moved = left[:, x]
        fast = _norms(moved @ kept) < FAST * _norms(moved)
        near = (moved @ E).tocoo()
        within = pair[near.row] == near.col // gdim
        near = csr_matrix((near.data[within], (near.row[within], near.col[within])), near.shape)
        # Rows of nodes that supports hold depend on each other (where they do, those of ties are
        # combined); they yield together, as the frame does, but for what they yield of themselves.
        together = several & fast
        held = (pair >= 0) & (_norms(near @ kept) < FAST * _norms(near)) | together
        held = diagonal(held.astype(float))
        yielding = near @ kept @ top + held @ left @ keep @ t.top @ held
        yielding = -BETA / d * yielding
        place, c = _places(pair, n)
        X = _diagonal_blocks(place.T @ (own + yielding) @ place, n, c)
        X += np.eye(c) * (np.abs(X).max(axis=2, initial=0.0) == 0.0)[:, :, None]
        inverse = place @ per_item(_inverse(X)) @ place.T if c else csr_matrix(own.shape)
        H = _semidefinite(_diagonal_blocks(-top @ inverse @ near, n, gdim))
        of_pairs = diagonal((pair >= 0).astype(float))
        rows = near @ J + left - of_pairs @ left
        bound = t.top @ diagonal(together.astype(float))
        C = keep @ (J.T @ per_item(H) @ J + d / BETA * (bound @ bound.T)) @ keep
        return cls(C, rows @ keep, yielding, scaling)


def _inverse(X: np.ndarray) -> np.ndarray:
    """Of blocks (n, c, c); a preconditioner may leave out what singular ones do not tell."""
    try:
        return np.linalg.inv(X)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(X)


def _scaling(t: ContactTerms, free: np.ndarray, d: float) -> csr_matrix:
    """What makes an interface's own equations as large as those of equilibrium."""
    by_z = abs(t.left @ diagonal(free)).max(axis=1).toarray().ravel() / d
    size = np.where(by_z > 0.0, by_z, abs(t.own).max(axis=1).toarray().ravel())
    return diagonal(1.0 / np.where(size > 0.0, size, 1.0))


def _norms(M: csr_matrix) -> np.ndarray:
    """Of the rows of a matrix."""
    return np.sqrt(np.asarray(M.multiply(M).sum(axis=1)).ravel())


def _places(pair: np.ndarray, n: int) -> tuple[csr_matrix, int]:
    """(q, n c) where the unknowns of each of n pairs (q,) stand one after the other; -1: of none;
    and c, the largest number of a pair."""
    q = np.argsort(pair, kind="stable")
    q = q[pair[q] >= 0]
    number = np.arange(len(q)) - np.searchsorted(pair[q], pair[q])
    c = int(number.max(initial=-1)) + 1
    at = q, pair[q] * c + number
    return csr_matrix((np.ones(len(q)), at), (len(pair), n * c)), c


def _diagonal_blocks(M: csr_matrix, n: int, c: int) -> np.ndarray:
    """(n, c, c) blocks on the diagonal of a matrix."""
    M, blocks = M.tocoo(), np.zeros((n, c, c))
    inside = M.row // max(c, 1) == M.col // max(c, 1)
    row, col = M.row[inside], M.col[inside]
    np.add.at(blocks, (row // max(c, 1), row % max(c, 1), col % max(c, 1)), M.data[inside])
    return blocks


def _semidefinite(H: np.ndarray) -> np.ndarray:
    """The symmetric parts of matrices (n, k, k), without negative eigenvalues."""
    values, vectors = np.linalg.eigh(0.5 * (H + np.swapaxes(H, 1, 2)))
    return (vectors * np.maximum(values, 0.0)[:, None]) @ np.swapaxes(vectors, 1, 2)


class Coupling:
    """What interfaces and follower loads add to the bodies' K, for changes that leave prescribed
    dofs as they are; all is known to every rank.

    Args:
        dofs: of the bodies.
        terms: of the interfaces.
        sides: their surfaces.
        places: numbers of the coordinates of each interface, then of each follower load.
        followers: minus the derivatives of these by their coordinates.
        d: stiffness of a node of the bodies [force / length].

    Attributes:
        stiffness: per interface, what goes into the preconditioner (width, width).
        wrong: why there is no preconditioner; empty where there is one.
    """

    def __init__(
        self,
        dofs: BodyDofs,
        terms: Sequence[ContactTerms],
        sides: Sequence[Any],
        places: Sequence[np.ndarray],
        followers: Sequence[csr_matrix],
        d: float,
    ) -> None:
        self.comm: MPI.Comm = dofs.comm
        numbers = np.concatenate([np.zeros(0, dtype=np.int64), *places])
        free = dofs.values(numbers, dofs.fixed.astype(float)) == 0.0
        ends = np.cumsum([0, *map(len, places)])
        parts = [
            Condensed.of(t, s, free[a:b], d)
            for t, s, a, b in zip(terms, sides, ends[:-1], ends[1:], strict=False)
        ]
        self.stiffness = [part.C for part in parts]
        self.scaling = _joined([part.scaling for part in parts])
        size = len(numbers), self.scaling.shape[0]
        self._all_left = self.scaling @ _joined([t.left for t in terms], size[::-1])
        keep = diagonal(free)
        self.K_all = _joined([*(t.K for t in terms), *followers], size[:1] * 2)
        C = _joined(self.stiffness, size[:1] * 2)
        self.K = keep @ self.K_all @ keep - C
        self.K_all = self.K_all - C
        self.top = keep @ _joined([t.top for t in terms], size)
        self.left = self._all_left @ keep
        self.own = self.scaling @ _joined([t.own for t in terms])
        self._rows = _joined([part.rows for part in parts], size[::-1])
        own = self.own + _joined([part.yielding for part in parts])
        self._factor, self.wrong = None, ""
        try:
            self._factor = splu(own.tocsc()) if size[1] else None
        except RuntimeError as error:  # SuperLU's "exactly singular"
            self.wrong = f"SuperLU: {error}"
        width = max([int(np.diff(C.indptr).max(initial=0)) for C in self.stiffness], default=0)
        if width > WIDEST * dofs.gdim:
            self.wrong = f"a node couples with {width // dofs.gdim} others, too many for GAMG"
        at = numbers - dofs.first
        mine = np.flatnonzero((at >= 0) & (at < len(dofs.fixed)))
        self._spread = csr_matrix(
            (np.ones(len(mine)), (at[mine], mine)), (len(dofs.fixed), len(numbers))
        )

    def at(self, u: np.ndarray) -> np.ndarray:
        """Values at all coordinates, of this rank's (n_local,); collective."""
        return np.asarray(self.comm.allreduce(self._spread.T @ u))

    def prescribed(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What changes (n_local,) of prescribed dofs alone do to both equations; collective."""
        z = self.at(u)
        return self._spread @ (self.K_all @ z), self._all_left @ z

    def times(self, u: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """This rank's (n_local,) of K u + top q, and left u + own q; collective."""
        z = self.at(u)
        return self._spread @ (self.K @ z + self.top @ q), self.left @ z + self.own @ q

    def forces(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """q of own' q = s, and this rank's (n_local,) of top q."""
        q = s if self._factor is None else self._factor.solve(s)
        return q, self._spread @ (self.top @ q)

    def after(self, s: np.ndarray, u: np.ndarray) -> np.ndarray:
        """q of left u + own' q = s in the preconditioner; collective."""
        return self.forces(s - self._rows @ self.at(u))[0]


def _joined(blocks: Sequence[csr_matrix], shape: tuple[int, int] | None = None) -> csr_matrix:
    """Blocks along the diagonal, filled up with zeros to a shape."""
    joined = block_diag([csr_matrix((0, 0)), *blocks], format="csr")
    if shape is not None:
        joined.resize(shape)
    return joined
