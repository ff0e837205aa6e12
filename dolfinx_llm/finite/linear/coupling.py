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

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, identity
from scipy.sparse.linalg import splu

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.base.sparse import diagonal, joined, per_component, per_item
from dolfinx_llm.finite.pairs.terms import FAST, ContactTerms
from dolfinx_llm.forms.condensed.krylov import WIDEST
from dolfinx_llm.operators.numbering import BodyDofs

LITTLE = 0.5  # of the largest force of an unknown, below which the preconditioner leaves it out
ALMOST_FAST = 0.1  # part of what a node does to its own row that is free: held below
MAIN = 0.1  # entry of a row on the frame, below which it is left out: corrections reach far
JOINT = 500  # rows of held nodes that yield together although each could alone, at most: dense
NO_STIFFNESS = 1e-12  # of a node's stiffness that is none
BETA = 2.0  # by how much rows yield, over what a single node does: less hides them from multigrid


@dataclass(frozen=True, eq=False)
class Condensed:
    """An interface's part of the preconditioner, and its own equations over their size."""

    C: csr_matrix  # (k, k) stiffness of the pairs at k dofs, zero at prescribed ones
    rows: csr_matrix  # (q, k) ``left``; where pairs are concerned without derivatives of rows
    yielding: csr_matrix  # (q, q) own' - own
    scaling: csr_matrix  # (q, q) by which own equations are multiplied
    jumps: tuple[csr_matrix, csr_matrix]  # (n gdim, k) J of the n pairs, and of all of N
    held: csr_matrix  # (k, k) the part of C of rows that yield together
    gdim: int

    def entries(self, slides: bool) -> csr_matrix:
        """(k, k) 1 where C may have entries, whether pairs stick or slip; where nodes slide
        also those that it soon may have."""
        J = abs(self.jumps[slides])
        blocks = np.ones((J.shape[0] // self.gdim, self.gdim, self.gdim))
        return (J.T @ per_item(blocks) @ J + abs(self.held)).sign().tocsr()

    @classmethod
    def of(cls, t: ContactTerms, sides: Any, M: csr_matrix, free: Array, d: float) -> Condensed:
        """Of an interface.

        Args:
            t: its part of Newton's system.
            sides: its surfaces.
            M: (width, k) by which coordinates follow dofs: see ``Placed``.
            free: (k,) dofs that are not prescribed.
            d: stiffness of a node [force / length].
        """
        (n, gdim), M, free = t.place.normal.shape, M @ diagonal(free), abs(M) @ free > 0.0
        J = t.place.at_pairs(sides.jumps(_main(t.place.N)), gdim)
        x = np.arange(n * gdim) if sides.frame is None else sides.columns[0].ravel()
        scaling = _scaling(t, free, d)
        left, own = scaling @ t.left, scaling @ t.own
        keep, kept = diagonal(free), diagonal(free[x])
        # Unknowns q of a pair p: forces on its node alone, of second-order bodies on its control
        # value; of facets that hang over the frame's end on the part's.
        E, over = sides.nodal, t.place.overhang
        E = per_component(E if over is None else (E @ over.inverse).tocsr(), gdim)
        top = (E.T @ t.top[x]).tocsr()
        if over is not None or sides.mover.element.order > 1:  # normals differ along a facet
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
        # So do those that normals tilt out of the supports: alone they would yield next to nothing.
        together = several & fast
        mean = several & ~fast & (np.diff(own.indptr) == 0)  # of many nodes
        held = (pair >= 0) & (_norms(near @ kept) < ALMOST_FAST * _norms(near)) | together | mean
        joint = held & fast & (abs(t.top).T @ free > 0.0)
        joint = np.flatnonzero(joint if joint.sum() <= JOINT else together)
        held = diagonal(held.astype(float))
        yielding = near @ kept @ top + held @ left @ keep @ t.top @ held
        yielding = -BETA / d * yielding
        pair[joint] = -1
        place, c = _places(pair, n)
        X = _diagonal_blocks(place.T @ (own + yielding) @ place, n, c)
        X += np.eye(c) * (np.abs(X).max(axis=2, initial=0.0) == 0.0)[:, :, None]
        inverse = place @ per_item(_inverse(X)) @ place.T if c else csr_matrix(own.shape)
        H = _semidefinite(_diagonal_blocks(-top @ inverse @ near, n, gdim))
        of_pairs = diagonal((pair >= 0).astype(float))
        rows = near @ J + left - of_pairs @ left
        jointly = _jointly(t, keep, joint, d)
        C = keep @ J.T @ per_item(H) @ J @ keep + jointly
        of_all = t.place.at_pairs(sides.jumps(t.place.N), gdim)
        C, jointly, jumps = M.T @ C @ M, M.T @ jointly @ M, (J @ M, of_all @ M)
        return cls(C.tocsr(), rows @ keep @ M, yielding, scaling, jumps, jointly, gdim)


def _jointly(t: ContactTerms, keep: csr_matrix, joint: Array, d: float) -> csr_matrix:
    """(width, width) stiffness -top own'⁻¹ left of some unknowns, of whose rows ``left`` is the
    transposed of ``top`` or minus that."""
    top = keep @ t.top[:, joint]
    if not len(joint):
        return csr_matrix(keep.shape)
    products = (t.left[joint] @ top).toarray()
    X = t.own[joint][:, joint].toarray() - BETA / d * products
    X *= -np.sign(np.diag(products))[:, None]
    found = (top @ csr_matrix(_semidefinite(_inverse(X[None]))[0]) @ top.T).tocsr()
    found.data[np.abs(found.data) < NO_STIFFNESS * d] = 0.0
    found.eliminate_zeros()
    return found


def _inverse(X: Array) -> Array:
    """Of blocks (n, c, c); a preconditioner may leave out what singular ones do not tell."""
    try:
        return np.linalg.inv(X)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(X)


def _scaling(t: ContactTerms, free: Array, d: float) -> csr_matrix:
    """What makes an interface's own equations as large as those of equilibrium."""
    by_z, none = _largest(t.left, free) / d, np.finfo(float).tiny  # less has no inverse
    size = np.where(by_z > none, by_z, _largest(t.own, np.ones(t.own.shape[1])))
    return diagonal(1.0 / np.where(size > none, size, 1.0))


def _main(N: csr_matrix) -> csr_matrix:
    """Rows with their main entries alone, and the same sums; as they are where little remains."""
    M = N.copy()
    M.data[np.abs(M.data) < MAIN] = 0.0
    M.eliminate_zeros()
    every, kept = (np.asarray(matrix.sum(axis=1)).ravel() for matrix in (N, M))
    much = 2.0 * np.abs(kept) > np.abs(every)
    grown = np.where(much, every / np.where(much, kept, 1.0), 0.0)
    return (diagonal(grown) @ M + diagonal(~much) @ N).tocsr()


def _largest(M: csr_matrix, weight: Array) -> Array:
    """(n,) of the entries of each row, with weights (m,) of the columns, at least 0."""
    found, some = np.zeros(M.shape[0]), np.flatnonzero(np.diff(M.indptr))
    if len(some):
        found[some] = np.maximum.reduceat(abs(M.data) * weight[M.indices], M.indptr[some])
    return found


def _norms(M: csr_matrix) -> Array:
    """Of the rows of a matrix."""
    return np.sqrt(np.asarray(M.multiply(M).sum(axis=1)).ravel())


def _places(pair: Array, n: int) -> tuple[csr_matrix, int]:
    """(q, n c) where the unknowns of each of n pairs (q,) stand one after the other; -1: of none;
    and c, the largest number of a pair."""
    q = np.argsort(pair, kind="stable")
    q = q[pair[q] >= 0]
    number = np.arange(len(q)) - np.searchsorted(pair[q], pair[q])
    c = int(number.max(initial=-1)) + 1
    at = q, pair[q] * c + number
    return csr_matrix((np.ones(len(q)), at), (len(pair), n * c)), c


def _diagonal_blocks(M: csr_matrix, n: int, c: int) -> Array:
    """(n, c, c) blocks on the diagonal of a matrix."""
    M, blocks = M.tocoo(), np.zeros((n, c, c))
    inside = M.row // max(c, 1) == M.col // max(c, 1)
    row, col = M.row[inside], M.col[inside]
    np.add.at(blocks, (row // max(c, 1), row % max(c, 1), col % max(c, 1)), M.data[inside])
    return blocks


def _semidefinite(H: Array) -> Array:
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
        places: numbers of the dofs of each interface, then of each follower load.
        made: per interface what makes its coordinates of them; None: they are these.
        followers: minus the derivatives of these by their coordinates.
        d: stiffness of a node of the bodies [force / length].
        fitted: what of each interface's stiffness goes into the preconditioner.

    Attributes:
        stiffness: per interface, what goes into the preconditioner (k, k).
        wrong: why there is no preconditioner; empty where there is one.
    """

    def __init__(
        self,
        dofs: BodyDofs,
        terms: Sequence[ContactTerms],
        sides: Sequence[Any],
        places: Sequence[Array],
        made: Sequence[csr_matrix | None],
        followers: Sequence[csr_matrix],
        d: float,
        fitted: Callable[[Sequence[Condensed]], list[csr_matrix]],
    ) -> None:
        self.comm = dofs.comm
        numbers = np.concatenate([np.zeros(0, dtype=np.int64), *places])
        free = dofs.values(numbers, dofs.fixed.astype(float)) == 0.0
        ends = np.cumsum([0, *map(len, places)])
        parts = [
            Condensed.of(t, s, identity(b - a, format="csr") if M is None else M, free[a:b], d)
            for t, s, M, a, b in zip(terms, sides, made, ends[:-1], ends[1:], strict=False)
        ]
        terms = [t.by_whole(M) for t, M in zip(terms, made, strict=True)]
        self.stiffness, self.wrong, self._yielded = fitted(parts), "", np.asarray
        self.scaling = joined([part.scaling for part in parts])
        size = len(numbers), self.scaling.shape[0]
        self._all_left = self.scaling @ joined([t.left for t in terms], size[::-1])
        keep = diagonal(free)
        self.K_all = joined([*(t.K for t in terms), *followers], size[:1] * 2)
        C = joined(self.stiffness, size[:1] * 2)
        self.K = keep @ self.K_all @ keep - C
        self.top = keep @ joined([t.top for t in terms], size)
        self.left = self._all_left @ keep
        self.own = self.scaling @ joined([t.own for t in terms])
        self._rows = joined([part.rows for part in parts], size[::-1])
        own = self.own + joined([part.yielding for part in parts])
        try:
            with collective(self.comm):
                self._yielded = splu(own.tocsc()).solve if size[1] else np.asarray
        except RuntimeError as error:  # SuperLU's "exactly singular"
            self.wrong = f"SuperLU: {error}"
        width = max([int(np.diff(C.indptr).max(initial=0)) for C in self.stiffness], default=0)
        if width > WIDEST * dofs.gdim:
            self.wrong = f"a node couples with {width // dofs.gdim} others, too many for GAMG"
        at = numbers - dofs.first
        mine = np.flatnonzero((at >= 0) & (at < len(dofs.fixed)))
        self._mine = mine, at[mine]
        self._spread = csr_matrix(
            (np.ones(len(mine)), (at[mine], mine)), (len(dofs.fixed), len(numbers))
        )

    def at(self, u: Array) -> Array:
        """Values at all coordinates, of this rank's (n_local,); collective."""
        z = np.zeros(self._spread.shape[1])
        z[self._mine[0]] = u[self._mine[1]]
        return np.asarray(self.comm.allreduce(z)) if self.comm.size > 1 else z

    def prescribed(self, u: Array) -> tuple[Array, Array]:
        """What changes (n_local,) of prescribed dofs alone do to both equations, but for the
        bodies' part; collective."""
        z = self.at(u)
        return self._spread @ (self.K_all @ z), self._all_left @ z

    def times(self, u: Array, q: Array) -> tuple[Array, Array]:
        """This rank's (n_local,) of K u + top q, and left u + own q; collective."""
        z = self.at(u)
        return self._spread @ (self.K @ z + self.top @ q), self.left @ z + self.own @ q

    def forces(self, s: Array) -> tuple[Array, Array]:
        """q of own' q = s, and this rank's (n_local,) of top q."""
        q = self._yielded(s)
        return q, self._spread @ (self.top @ q)

    def after(self, s: Array, u: Array) -> Array:
        """q of left u + own' q = s in the preconditioner; collective."""
        return self._yielded(s - self._rows @ self.at(u))
