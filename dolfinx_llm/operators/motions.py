"""Rigid motions that supports leave to a body: free ones, and those that weak springs hold.

A body on springs that are weak against its own stiffness moves far: K⁻¹ is then that motion and
little else, and the forces in the body are differences of large numbers. So these motions are
told apart from the start, with a stiffness of their own, which is zero where nothing holds them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from mpi4py import MPI

from dolfinx_llm.operators.bodies import Bodies

STILL = 1e-10  # part of its size by which a rigid motion may move prescribed dofs and count as none
WEAK = 1e-2  # of a body's own stiffness, below which that of springs counts as weak
NOISE = 30.0  # rounding errors of K below which a rigid motion counts as free
FAR = 30.0  # sizes of cells from the origin, from which on their coordinates cost digits
EPS = np.finfo(float).eps


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
    none, parts = np.zeros((n, 0)), np.zeros((0, 3 * (bodies.gdim - 1)))
    body, square = np.zeros(0, dtype=np.int64), np.zeros((0, 0))
    return RigidMotions(bodies, body, parts, 0, none, none, square, np.zeros(0))


def rigid_motions(bodies: Bodies, K: Any, fixed: np.ndarray) -> RigidMotions:
    """The rigid motions of each body that supports alone, (n_local,) fixed dofs, do not hold, or
    only by weak springs; K has identity rows at fixed dofs."""
    label = np.repeat(bodies.label, bodies.gdim)
    R = bodies.own_modes(bodies.label, bodies.points).reshape(len(fixed), -1)
    allowed = _allowed(bodies, R, label, fixed)
    width = max((N.shape[1] for N in allowed), default=0)
    moved = np.zeros((len(fixed), width))  # of all bodies at once: K does not couple them
    for b, N in enumerate(allowed):
        own = label == b
        moved[own, : N.shape[1]] = R[own] @ N
    moved[fixed] = 0.0
    pushed, diagonal = _times(K, moved)
    found = [
        _of_body(bodies, b, N, (moved, pushed, diagonal), label) for b, N in enumerate(allowed)
    ]
    order = [(b, j) for held in (False, True) for b, (_, _, h, _) in enumerate(found)
             for j in np.flatnonzero(h == held)]  # fmt: skip
    k = len(order)
    modes, forces = np.zeros((len(fixed), k)), np.zeros((len(fixed), k))
    parts, noise, free = np.zeros((k, R.shape[1])), np.zeros(k), 0
    for i, (b, j) in enumerate(order):
        N, C, held, level = allowed[b], found[b][0], found[b][2], found[b][3]
        own, vector = label == b, C[:, j]
        modes[own, i] = moved[own, : len(vector)] @ vector
        parts[i], noise[i] = N @ vector, level[j]
        if held[j]:
            forces[own, i] = pushed[own, : len(vector)] @ vector
        else:
            free += 1
    stiffness = bodies.comm.allreduce(modes.T @ forces)
    body = np.array([b for b, _ in order], dtype=np.int64)
    return RigidMotions(
        bodies, body, parts, free, modes, forces, 0.5 * (stiffness + stiffness.T), noise
    )


def _allowed(
    bodies: Bodies, R: np.ndarray, label: np.ndarray, fixed: np.ndarray
) -> list[np.ndarray]:
    """Per body (modes, k) combinations of its rigid motions that move no prescribed dof."""
    held = [np.linalg.qr(R[fixed & (label == b)], mode="r") for b in range(bodies.count)]
    out = []
    for parts in zip(*bodies.comm.allgather(held), strict=True):
        _, values, vectors = np.linalg.svd(np.concatenate(parts))
        rank = int((values > STILL * max(values.max(initial=0.0), 1.0)).sum())
        out.append(vectors[rank:].T)
    return out


def _times(K: Any, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """K times this rank's rows of columns, and |diagonal of K|."""
    x, y = K.createVecs()
    out = np.empty_like(columns)
    for k in range(columns.shape[1]):
        x.array_w[:] = columns[:, k]
        K.mult(x, y)
        out[:, k] = y.array_r
    diagonal = K.getDiagonal()
    values = np.abs(diagonal.array_r)
    for vector in (x, y, diagonal):
        vector.destroy()
    return out, values


def _of_body(bodies: Bodies, b: int, N: np.ndarray, fields: Any, label: np.ndarray) -> Any:
    """Motions of one body that are free or weakly held: their coefficients (columns of N, k),
    stiffness (k,), whether springs hold them (k,), and the stiffness that rounding alone may cause
    (k,)."""
    moved, pushed, diagonal = (field[label == b] for field in fields)
    k = N.shape[1]
    moved, pushed = moved[:, :k], pushed[:, :k]
    weighted = diagonal[:, None] * moved
    sums = (moved.T @ pushed, moved.T @ weighted, (weighted * moved).T @ (weighted * moved))
    own, size, square = bodies.comm.allreduce(np.stack(sums)) if k else np.zeros((3, 0, 0))
    nodes = bodies.comm.allreduce(len(diagonal), op=MPI.SUM) / bodies.gdim
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
