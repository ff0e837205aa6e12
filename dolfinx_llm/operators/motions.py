"""Rigid motions that supports leave to a body: free ones, and those that weak springs hold.

A body on springs that are weak against its own stiffness moves far: K⁻¹ is then that motion and
little else, and the forces in the body are differences of large numbers. So these motions are
told apart from the start, with a stiffness of their own, which is zero where nothing holds them.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import csr_matrix, diags, identity
from scipy.sparse.linalg import splu

from dolfinx_llm.base.parallel import gather_rows
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.numbering import Numbering
from dolfinx_llm.operators.petsc import diagonal_of, times

STILL = 1e-10  # part of its size by which a rigid motion may move prescribed dofs and count as none
WEAK = 1e-2  # of a body's own stiffness, below which that of springs counts as weak
NOISE = 30.0  # rounding errors of K below which a rigid motion counts as free
FAR = 30.0  # sizes of cells from the origin, from which on their coordinates cost digits
EPS = np.finfo(float).eps
SPRING = 1e-10  # stiffness of the springs that hold free bodies, of the surfaces'
WEAKER = 1e-5  # ... of that of springs which hold other bodies
LEAST = 1e-13  # ... of the surfaces', at least
DRIFTS = 1e-9  # rounding of K over the stiffness of springs, from which on it is looked at


@dataclass(frozen=True, eq=False)
class RigidMotions:
    """k rigid motions of single bodies, each of about size 1; the free ones come first."""

    bodies: Bodies
    body: np.ndarray  # (k,) that each moves
    parts: np.ndarray  # (k, 3 or 6) of its body's motions in ``Bodies.own_modes``
    free: int  # how many of them nothing holds
    modes: np.ndarray  # (n_local, k) on this rank's dofs, zero at prescribed ones
    forces: np.ndarray  # (n_local, k) K times modes, zero for the free ones
    stiffness: np.ndarray  # (k, k) modesᵀ K modes
    noise: np.ndarray  # (k,) what rounding of K may have done to it

    def one_of_each(self, which: np.ndarray) -> list[np.ndarray]:
        """Motions ``which`` in groups with no more than one of each body, which one solve may take
        together: K does not couple bodies."""
        order = which[np.argsort(self.body[which], kind="stable")]
        new = np.diff(self.body[order], prepend=-1) != 0
        place = np.arange(len(order)) - np.maximum.accumulate(
            np.where(new, np.arange(len(order)), 0)
        )
        return [order[place == p] for p in range(place.max(initial=-1) + 1)]

    def owner(self, some: np.ndarray) -> np.ndarray:
        """(n_local,) which of some motions, one of each body, is that of a dof's body; -1: none."""
        of = np.full(self.bodies.count + 1, -1)
        of[self.body[some]] = some
        label = np.full(len(self.modes), -1)
        label[self.bodies.dofs] = np.repeat(self.bodies.label, self.bodies.components)
        return of[label]

    def describe(self, amounts: np.ndarray, forces: np.ndarray) -> str:
        """Words for (free,) amounts of the free motions, and the forces (free,) along them."""
        words, size = [], np.abs(amounts).max(initial=0.0)
        for b in np.unique(self.body[: self.free]):
            own = np.flatnonzero(self.body[: self.free] == b)
            if np.abs(amounts[own]).max() < 1e-3 * size:
                continue
            work = float(amounts[own] @ forces[own])
            words.append(self.bodies.motion(b, amounts[own] @ self.parts[own], work))
        return "; ".join(words)


def no_motions(bodies: Bodies, n: int) -> RigidMotions:
    """None at all, of bodies with n dofs on this rank: where ties hold them nobody asks."""
    none, parts = np.zeros((n, 0)), np.zeros((0, bodies.ways))
    body, square = np.zeros(0, dtype=np.int64), np.zeros((0, 0))
    return RigidMotions(bodies, body, parts, 0, none, none, square, np.zeros(0))


def rigid_motions(bodies: Bodies, K: Any, fixed: np.ndarray) -> RigidMotions:
    """The rigid motions of each body that supports alone, (n_local,) fixed dofs, do not hold, or
    only by weak springs; K has identity rows at fixed dofs."""
    label, R = np.full(len(fixed), -1), np.zeros((len(fixed), bodies.ways))
    label[bodies.dofs] = np.repeat(bodies.label, bodies.components)
    R[bodies.dofs] = bodies.own_modes(bodies.label, bodies.points).reshape(-1, R.shape[1])
    by_body = np.argsort(label, kind="stable")
    ends = np.searchsorted(label[by_body], np.arange(bodies.count + 1))
    dofs = [by_body[a:b] for a, b in zip(ends[:-1], ends[1:], strict=True)]
    allowed = _allowed(bodies, R, dofs, fixed)
    width = max((N.shape[1] for N in allowed), default=0)
    moved = np.zeros((len(fixed), width))  # of all bodies at once: K does not couple them
    for b, N in enumerate(allowed):
        moved[dofs[b], : N.shape[1]] = R[dofs[b]] @ N
    moved[fixed] = 0.0
    pushed, diagonal = np.empty_like(moved), np.abs(diagonal_of(K))
    for k in range(width):
        pushed[:, k] = times(K, moved[:, k])
    found = [
        _of_body(bodies, b, N, [field[dofs[b]] for field in (moved, pushed, diagonal)])
        for b, N in enumerate(allowed)
    ]
    order = [(b, j) for held in (False, True) for b, (_, _, h, _) in enumerate(found)
             for j in np.flatnonzero(h == held)]  # fmt: skip
    k = len(order)
    modes, forces = np.zeros((len(fixed), k)), np.zeros((len(fixed), k))
    parts, noise, free = np.zeros((k, R.shape[1])), np.zeros(k), 0
    for i, (b, j) in enumerate(order):
        N, C, held, level = allowed[b], found[b][0], found[b][2], found[b][3]
        own, vector = dofs[b], C[:, j]
        modes[own, i] = moved[own, : len(vector)] @ vector
        parts[i], noise[i] = N @ vector, level[j]
        if held[j]:
            forces[own, i] = pushed[own, : len(vector)] @ vector
        else:
            free += 1
    body = np.array([b for b, _ in order], dtype=np.int64)
    stiffness = np.zeros((k, k))
    for b in np.unique(body):  # K does not couple bodies
        own, of = dofs[b], np.flatnonzero(body == b)
        stiffness[np.ix_(of, of)] = modes[np.ix_(own, of)].T @ forces[np.ix_(own, of)]
    stiffness = bodies.comm.allreduce(stiffness)
    return RigidMotions(
        bodies, body, parts, free, modes, forces, 0.5 * (stiffness + stiffness.T), noise
    )


def _allowed(
    bodies: Bodies, R: np.ndarray, dofs: list[np.ndarray], fixed: np.ndarray
) -> list[np.ndarray]:
    """Per body (modes, k) combinations of its rigid motions that move no prescribed dof."""
    held = [np.linalg.qr(R[own[fixed[own]]], mode="r") for own in dofs]
    out = []
    for parts in zip(*bodies.comm.allgather(held), strict=True):
        _, values, vectors = np.linalg.svd(np.concatenate(parts))
        rank = int((values > STILL * max(values.max(initial=0.0), 1.0)).sum())
        out.append(vectors[rank:].T)
    return out


def _of_body(bodies: Bodies, b: int, N: np.ndarray, fields: Any) -> Any:
    """Motions of one body, of ``fields`` at its dofs, that are free or weakly held: their
    coefficients (columns of N, k), stiffness (k,), whether springs hold them (k,), and the
    stiffness that rounding alone may cause (k,)."""
    moved, pushed, diagonal = fields
    k = N.shape[1]
    moved, pushed = moved[:, :k], pushed[:, :k]
    weighted = diagonal[:, None] * moved
    sums = (moved.T @ pushed, moved.T @ weighted, (weighted * moved).T @ (weighted * moved))
    own, size, square = bodies.comm.allreduce(np.stack(sums)) if k else np.zeros((3, 0, 0))
    nodes = bodies.comm.allreduce(len(diagonal), op=MPI.SUM) / bodies.components
    across = nodes ** (1.0 / bodies.gdim)  # nodes from end to end
    if not k:
        return np.zeros((0, 0)), np.zeros(0), np.zeros(0, dtype=bool), np.zeros(0)
    values, vectors = scipy.linalg.eigh(0.5 * (own + own.T), size)
    weak = values * across**2 < WEAK
    values, vectors = values[weak], vectors[:, weak]
    vectors = vectors / np.linalg.norm(N @ vectors, axis=0)
    values = np.einsum("ij,ik,kj->j", vectors, own, vectors)
    # Places far from the origin lose digits, and with them the rigid motions of cells.
    extent = np.linalg.norm(bodies.high[b] - bodies.low[b])
    far = max(np.abs([bodies.low[b], bodies.high[b]]).max() / extent * across / FAR, 1.0)
    noise = NOISE * EPS * far * np.sqrt(np.maximum(np.diagonal(square).sum(), 0.0))
    return vectors, values, values > noise, np.full(len(values), noise / NOISE)


def pins(comm: MPI.Comm, modes: np.ndarray) -> list[int]:
    """This rank's dofs (local numbers) that together hold the modes (n_local, k) best, k in all."""
    rest, chosen = np.asfortranarray(modes), []
    rest = rest.copy(order="F") if rest is modes else rest
    size = np.einsum("nk,nk->n", rest, rest)
    for _ in range(rest.shape[1]):
        best = int(size.argmax()) if len(size) else 0
        found = comm.allgather((float(size[best]), rest[best]) if len(size) else (-1.0, None))
        rank = int(np.argmax([round(length, 12) for length, _ in found]))
        direction = found[rank][1]
        if rank == comm.rank:
            chosen.append(best)
        among = np.flatnonzero(direction)  # the motions of one body
        direction = direction[among]
        part = rest[:, among] @ direction
        on = np.flatnonzero(part)
        before = rest[np.ix_(on, among)]
        after = before - np.outer(part[on], direction) / (direction @ direction)
        rest[np.ix_(on, among)] = after
        size[on] += (after**2).sum(axis=1) - (before**2).sum(axis=1)
    return chosen


class Floating:
    """Rigid motions that supports leave to the bodies, α, each held by a weak spring at one dof.
    The springs pull to where the bodies were. At a solution they carry nothing: what they carry
    else is the part of the load that neither supports nor contact take. ``loose`` (count, j) are
    those combinations that carry no force at all, in whichever state of contact."""

    def __init__(
        self, rigid: RigidMotions, B: PETSc.Mat, rows: Numbering, loose: np.ndarray
    ) -> None:
        self.comm: MPI.Comm = rigid.bodies.comm
        self.rigid = rigid
        self.count, self.loose = self.rigid.free, loose
        self.modes = self.rigid.modes[:, : self.count]
        self.pins = pins(self.comm, self.modes)
        self._at_pins = gather_rows(self.comm, self.modes[self.pins])  # (count, count)
        self.square = self._at_pins.T @ self._at_pins
        own = np.zeros((rows.sizes[0], self.rigid.modes.shape[1]))
        for k, mode in enumerate(self.rigid.modes.T):
            own[:, k] = times(B, mode, transposed=True)
        self.G = gather_rows(self.comm, own)[rows.number]  # (n, k) Bᵀ of all rigid motions

    def at_pins(self, amounts: np.ndarray) -> np.ndarray:
        """Motion of this rank's pins for (count,) α [length]."""
        return self.modes[self.pins] @ amounts

    def amounts(self, u: np.ndarray) -> np.ndarray:
        """(count,) α of this rank's displacement u (n_local,)."""
        return np.linalg.solve(self._at_pins, gather_rows(self.comm, u[self.pins]))

    def strayed(self, u: np.ndarray) -> np.ndarray:
        """(count,) the part of this rank's displacement u (n_local,) along the loose motions: what
        is left without it has the least sum of squares."""
        if not self.loose.shape[1]:
            return np.zeros(self.count)
        moves = self.modes @ self.loose
        sums = self.comm.allreduce(moves.T @ np.column_stack([moves, u]))
        return self.loose @ np.linalg.solve(sums[:, :-1], sums[:, -1])

    def spring(self, scale: float) -> float:
        """Stiffness of the springs [force / length]: weak against ``scale``, and against springs
        of the bodies' own that they may act in line with, as far as digits allow."""
        weakest = np.diagonal(self.rigid.stiffness)[self.count :].min(initial=np.inf)
        return float(max(min(SPRING * scale, WEAKER * weakest), LEAST * scale))

    @property
    def grip(self) -> np.ndarray:
        """(n, count) by how much multipliers may push along the free motions."""
        return np.abs(self.G[:, : self.count])

    def drift(self, L: csr_matrix, frames: int, active: np.ndarray) -> float:
        """Relative error of motions that weak springs alone hold: the stiffness of the bodies, with
        its rounding, stands beside theirs. The first columns of L (n, m), so many, are L_b; (n,)
        rows are in contact."""
        rigid, weak = self.rigid, slice(self.count, None)
        own, noise = rigid.stiffness[weak, weak], np.diag(rigid.noise[weak])
        if not (np.diagonal(noise) > DRIFTS * np.diagonal(own)).any():
            return 0.0
        L = (diags(active.astype(float)) @ L[:, :frames]).tocsr()
        on = np.diff(L.indptr) > 0
        G = self.G[:, weak] * on[:, None]
        if L.shape[1]:
            fit = splu((L.T @ L + 1e-10 * identity(L.shape[1])).tocsc())
            G = G - L @ fit.solve(L.T @ G)
        values, vectors = np.linalg.eigh(G.T @ G)
        loose = vectors[:, values < 1e-8 * max(np.abs(self.G).max(initial=0.0), 1.0)]
        if not loose.shape[1]:
            return 0.0
        return float(scipy.linalg.eigh(loose.T @ noise @ loose, loose.T @ own @ loose)[0].max())

    def sizes(self, f: np.ndarray) -> np.ndarray:
        """(count,) this rank's loads f along the motions, summed up over all without sign."""
        return self.comm.allreduce(np.abs(self.modes).T @ np.abs(f))
