"""Steps of contact laws on the whole system, set up anew in each: for large interfaces.

The same as ``flexibility``, where the surfaces have so many nodes that asking the bodies for their
answer to every multiplier costs more than a few factorisations.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags

from dolfinx_llm import operators
from dolfinx_llm._parallel import gather_rows
from dolfinx_llm.linear_step import SOFT, InterfaceSystem, wrong_signs
from dolfinx_llm.rigid import floating_modes, pins
from dolfinx_llm.system import DirectSolver, join_blocks, times, with_springs


class WholeSteps:
    """What steps on the whole system share.

    Args:
        K, B, bodies, fixed, scale, prefix, options: as of ``Flexibility``.
        rows: the multipliers' ``Numbering``.
        frames: ``Numbering`` of frame and slip unknowns.
    """

    accuracy = 1e-13  # of balance and law, relative

    def __init__(self, K, B, rows, frames, bodies, fixed, scale, prefix, options=None):
        self.K, self.B, self.rows, self.frames, self.scale = K, B, rows, frames, scale
        self.comm, self.fixed, self._prefix, self._options = bodies.comm, fixed, prefix, options
        modes = floating_modes(bodies, K, fixed)
        self._pins, self.floating = pins(self.comm, modes), modes.shape[1]
        self._u = np.zeros(0)  # of the last step

    def load(self, f: np.ndarray) -> None:
        """Take this rank's load."""
        self.f = f

    def correct(self, multiplier: np.ndarray, alpha: np.ndarray) -> None:
        """Nothing to correct: every step solves the whole system."""

    def solve(self, step: InterfaceSystem, spring: float, centre: np.ndarray, may_open: np.ndarray):
        """One linear step; see ``Flexibility.solve``. α: motion of the dofs that springs hold."""
        f = self.f.copy()
        first = sum(self.comm.allgather(len(self._pins))[: self.comm.rank])
        f[self._pins] += spring * centre[first : first + len(self._pins)]
        self._u, multiplier, w = self._solve(f, step, spring)
        y = self._gather(self.rows, times(self.B, self._u, transposed=True))
        alpha = gather_rows(self.comm, self._u[self._pins])
        wrong = wrong_signs(step, may_open, multiplier, y, w, self.scale)
        return multiplier, y, w, alpha, step.active, wrong

    def _solve(self, f: np.ndarray, step: InterfaceSystem, spring: float):
        """u of this rank; λ (n,) and w (m,) on every rank. K has springs at the pins."""
        raise NotImplementedError

    def _K_times(self, u: np.ndarray) -> np.ndarray:
        """This rank's part of K u, without springs."""
        return times(self.K, u)

    def displacement(self, multiplier: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        """This rank's u of the last step; sets ``residual``, of K u + B λ = f."""
        load = self.f - times(self.B, multiplier[self.rows.mine])
        miss = np.abs(self._K_times(self._u) - load).max(initial=0.0)
        sizes = [np.abs(self.f), np.abs(load), self.scale * np.abs(self._u)]
        found = self.comm.allgather((miss, max(a.max(initial=0.0) for a in sizes)))
        miss, size = np.max(found, axis=0)
        self.residual = miss / max(size, 1e-300)
        return self._u

    def _gather(self, numbering, local: np.ndarray) -> np.ndarray:
        return gather_rows(self.comm, local)[numbering.number]

    def destroy(self) -> None:
        """Nothing outlives a step."""


class SparseSteps(WholeSteps):
    """Frame-augmented system (31) with the rows of a contact law, factorised in each step.

    Args:
        *arguments: of ``WholeSteps``.
        soft: (n,) rows of prescribed dofs, as of ``Flexibility``.
    """

    def __init__(self, *arguments, soft):
        super().__init__(*arguments)
        self._soft = soft

    def _solve(self, f, step: InterfaceSystem, spring: float):
        K = with_springs(self.K, self._pins, np.full(len(f), spring))
        blocks = self._blocks(K, step)
        matrix, places = join_blocks(blocks)
        for M in (M for row in blocks for M in row if M is not None):
            M.destroy()
        solver = DirectSolver(matrix, self._prefix, self._options, own=True)
        rhs = np.zeros(matrix.getLocalSize()[0])
        rhs[places[0]] = f
        rhs[places[1]] = np.where(step.active, -self.scale * step.g, 0.0)[self.rows.mine]
        if len(places) > 2:
            rhs[places[2]] = -step.rhs[self.frames.mine]
        x = solver.solve(rhs)
        solver.destroy()
        multiplier = self._gather(self.rows, self.scale * x[places[1]])
        w = self._gather(self.frames, x[places[2]]) if len(places) > 2 else np.zeros(0)
        return x[places[0]], multiplier, w

    def _blocks(self, K, step: InterfaceSystem):
        """Blocks of the system in u, λ / c and w, symmetric without friction."""
        c, comm = self.scale, self.comm
        rows, frames = self.rows, self.frames
        on = step.active.astype(float)
        picked = _aij(comm, diags(c * on).tocsr(), rows, rows)
        B = self.B.matMult(picked)
        picked.destroy()
        B_t = B.copy()
        B_t.transpose()
        idle = diags(np.where(step.active, np.where(self._soft, -SOFT * c, 0.0), c)).tocsr()
        own = _aij(comm, idle, rows, rows)
        if not step.L.shape[1]:
            return [[K, B], [B_t, own]]
        L = _aij(comm, (diags(-c * on) @ step.L).tocsr(), rows, frames)
        E = _aij(comm, (step.E @ diags(-c * on)).tocsr(), frames, rows)
        D = _aij(comm, (-step.D).tocsr(), frames, frames)
        return [[K, B, None], [B_t, own, L], [None, E, D]]


def _aij(comm, M: csr_matrix, rows, cols):
    """PETSc AIJ of a matrix known to every rank, with a stored diagonal where it is square: without
    one MUMPS loses entries on several ranks."""
    if rows is cols:
        pattern = csr_matrix(
            (np.ones(M.shape[0]), np.arange(M.shape[0]), np.arange(M.shape[0] + 1))
        )
        M = _union(M.tocsr(), pattern)
    local = M[rows.mine].tocoo()
    local = csr_matrix((local.data, (local.row, cols.number[local.col])), shape=local.shape)
    return operators.create_aij(comm, rows.sizes, cols.sizes, local)


def _union(M: csr_matrix, pattern: csr_matrix) -> csr_matrix:
    """M with stored zeros where the pattern has entries."""
    a, b = M.tocoo(), pattern.tocoo()
    data = np.concatenate([a.data, np.zeros(b.nnz)])
    index = np.concatenate([a.row, b.row]), np.concatenate([a.col, b.col])
    return csr_matrix((data, index), M.shape)
