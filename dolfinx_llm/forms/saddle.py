"""The frame-augmented system (31) or the classical one (6), solved with PETSc's MUMPS."""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix, diags

from dolfinx_llm.forms.direct import DirectSolver
from dolfinx_llm.forms.exchange import WholeSteps
from dolfinx_llm.forms.step import LinearStep
from dolfinx_llm.forms.verdict import SEVERAL, check_rounding, require, rounding_error
from dolfinx_llm.operators.petsc import (
    create_aij,
    diagonal_of,
    join_blocks,
    stored_zero_diagonal,
    with_springs,
)


class SaddleSystem:
    """Factorised block matrix of (31) with λ scaled by a stiffness, so that units vanish.

    Args:
        K: stiffness of the bodies with Dirichlet conditions applied.
        B: (31).
        L_b: (31), or None without frame unknowns: (6), with B = Qᵀ.
        scale: mean diagonal of K on the surface dofs [force / length].
        prefix: of the PETSc options.
        options: PETSc options on top of ``SADDLE_OPTIONS``.
    """

    def __init__(
        self, K: Any, B: Any, L_b: Any, scale: float, prefix: str, options: dict | None = None
    ) -> None:
        self.scale = scale
        self.K = K
        B_t = B.copy()
        B_t.transpose()
        sB, sB_t = self._scaled(B, scale), self._scaled(B_t, scale)
        # PETSc hands MUMPS the upper triangle from each row's stored diagonal on: on several ranks
        # rows without one lose entries.
        zero_l = stored_zero_diagonal(B.getSizes()[1], K.comm)
        blocks, parts = [[K, sB], [sB_t, zero_l]], [B_t, sB, sB_t, zero_l]
        if L_b is not None:
            L_t = L_b.copy()
            L_t.transpose()
            sL, sL_t = self._scaled(L_b, -scale), self._scaled(L_t, -scale)
            zero_v = stored_zero_diagonal(L_b.getSizes()[1], K.comm)
            blocks = [[K, sB, None], [sB_t, zero_l, sL], [None, sL_t, zero_v]]
            parts += [L_t, sL, sL_t, zero_v]
        self.matrix, self.rows = join_blocks(blocks)
        for M in parts:
            M.destroy()
        self._solver = DirectSolver(self.matrix, prefix, options, own=True)

    @staticmethod
    def _scaled(M: Any, factor: float) -> Any:
        M = M.copy()
        M.scale(factor)
        return M

    def solve(self, f: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """This rank's parts of u, λ, v for loads f and gaps g; v is empty without L_b.

        Raises:
            ContactError: the factorisation failed or the residual is not small.
        """
        rows_u, rows_l = self.rows[:2]
        rhs = np.zeros(self.matrix.getLocalSize()[0])
        rhs[rows_u], rhs[rows_l] = f, -self.scale * g
        solution = self._solver.solve(rhs)
        u, multiplier, *v = (solution[rows] for rows in self.rows)
        comm, forces = self.K.comm.tompi4py(), self.scale * multiplier
        self.rounding = rounding_error(comm, diagonal_of(self.K), u, f, forces)
        self._check_solution()
        check_rounding(self.rounding)
        return u, self.scale * multiplier, v[0] if v else np.empty(0)

    def _check_solution(self) -> None:
        """Require a small residual, against the sizes of the unknowns and against the load.

        The second holds off runaway multipliers of a singular system, which the first would let
        pass.
        """
        infinity = PETSc.NormType.NORM_INFINITY
        rhs, solution = self._solver.rhs, self._solver.solution
        residual = rhs.duplicate()
        self.matrix.mult(solution, residual)
        size = max(residual.norm(infinity), self.scale * solution.norm(infinity))
        residual.aypx(-1.0, rhs)
        miss, load = residual.norm(infinity), rhs.norm(infinity)
        residual.destroy()
        self.residual = miss / max(size, load, 1e-300)
        against_load = miss / load if load > 0.0 else self.residual
        reason = self._solver.ksp.getConvergedReason()
        allowed = max(1e-6, SEVERAL * self.rounding)
        found = self.residual if reason >= 0 else np.inf, against_load
        how = f"PETSc's reason {reason}, MUMPS {self._solver.infog}"
        require(found, (1e-9, allowed), how)

    def destroy(self) -> None:
        self._solver.destroy()


class SparseSteps(WholeSteps):
    """Frame-augmented system (31) with the rows of a contact law, factorised in each step.

    Args:
        *arguments: of ``WholeSteps``.
    """

    name = "(31) factorised"

    def _set_up(self, step: LinearStep) -> Any:
        K = with_springs(self.K, self._pins, np.full(len(self.f), step.spring))
        blocks = self._blocks(K, step)
        matrix, places = join_blocks(blocks)
        for M in (M for row in blocks for M in row if M is not None):
            M.destroy()
        solver = DirectSolver(matrix, self._prefix, self._options, own=True)

        def ask(f: np.ndarray, g: np.ndarray, rhs: np.ndarray) -> Any:
            b = np.zeros(matrix.getLocalSize()[0])
            b[places[0]] = f
            b[places[1]] = np.where(step.active, -self.scale * g, 0.0)[self.rows.mine]
            if len(places) > 2:
                b[places[2]] = -rhs[self.frames.mine]
            x = solver.solve(b)
            multiplier = self._gather(self.rows, self.scale * x[places[1]])
            w = self._gather(self.frames, x[places[2]]) if len(places) > 2 else np.zeros(0)
            return x[places[0]], multiplier, w

        return ask, solver.destroy

    def _blocks(self, K: Any, step: LinearStep) -> Any:
        """Blocks of the system in u, λ / c and w, symmetric without friction."""
        c, comm = self.scale, self.comm
        rows, frames = self.rows, self.frames
        on = step.active.astype(float)
        picked = _aij(comm, diags(c * on).tocsr(), rows, rows)
        B = self.B.matMult(picked)
        picked.destroy()
        B_t = B.copy()
        B_t.transpose()
        idle = diags(np.where(step.active, -(c**2) * step.compliance, c)).tocsr()
        own = _aij(comm, idle, rows, rows)
        if not step.L.shape[1]:
            return [[K, B], [B_t, own]]
        L = _aij(comm, (diags(-c * on) @ step.L).tocsr(), rows, frames)
        E = _aij(comm, (step.E @ diags(-c * on)).tocsr(), frames, rows)
        D = _aij(comm, (-step.D).tocsr(), frames, frames)
        return [[K, B, None], [B_t, own, L], [None, E, D]]


def _aij(comm: Any, M: csr_matrix, rows: Any, cols: Any) -> Any:
    """PETSc AIJ of a matrix known to every rank, with a stored diagonal where it is square: without
    one MUMPS loses entries on several ranks."""
    if rows is cols:
        pattern = csr_matrix(
            (np.ones(M.shape[0]), np.arange(M.shape[0]), np.arange(M.shape[0] + 1))
        )
        M = _union(M.tocsr(), pattern)
    local = M[rows.mine].tocoo()
    local = csr_matrix((local.data, (local.row, cols.number[local.col])), shape=local.shape)
    return create_aij(comm, rows.sizes, cols.sizes, local)


def _union(M: csr_matrix, pattern: csr_matrix) -> csr_matrix:
    """M with stored zeros where the pattern has entries."""
    a, b = M.tocoo(), pattern.tocoo()
    data = np.concatenate([a.data, np.zeros(b.nnz)])
    index = np.concatenate([a.row, b.row]), np.concatenate([a.col, b.col])
    return csr_matrix((data, index), M.shape)
