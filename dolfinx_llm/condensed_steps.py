"""Steps of contact laws in the condensed form: the rows in contact are slaved, the others are free.

Without friction the matrix stays symmetric positive definite, and CG with GAMG solves it at any
size. With friction the rows of κ hold Coulomb's law instead of the equilibrium of L_bᵀ λ; the
reduced matrix is then not symmetric and is factorised.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm._parallel import ContactError, gather_rows
from dolfinx_llm.condensed import CondensedSystem
from dolfinx_llm.linear_step import InterfaceSystem, wrong_signs
from dolfinx_llm.operators import Numbering, create_aij
from dolfinx_llm.rigid import floating_modes, pins
from dolfinx_llm.slaving import SlavedRows
from dolfinx_llm.system import DirectSolver, with_springs
from dolfinx_llm.transformation import Transformation


class CondensedSteps:
    """The steps of ``iteration.ContactIteration``, as ``SparseSteps`` does them in the saddle form.

    Args:
        K: stiffness, identity rows at prescribed dofs.
        rows: the multiplier ``Rows``.
        frames: ``Numbering`` of frame and slip unknowns.
        block: frame unknowns per node, 1 with friction.
        modes: near-null space, at the bodies' dofs and at the frame unknowns; None: none.
        bodies, fixed, scale, prefix, options: as of ``Flexibility``.
    """

    accuracy = 1e-11  # of balance and law, relative: what CG leaves

    def __init__(
        self, K, rows, frames, block, modes, bodies, fixed, scale, prefix, options=None
    ):  # fmt: skip
        self.K, self.rows, self.frames, self.block, self.modes = K, rows, frames, block, modes
        self.comm, self.fixed, self.scale = bodies.comm, fixed, scale
        self._prefix, self._options = prefix, options
        floating = floating_modes(bodies, K, fixed)
        self._pins, self.floating = pins(self.comm, floating), floating.shape[1]
        self._u = np.zeros(0)  # of the last step
        self.iterations = 0

    def load(self, f: np.ndarray) -> None:
        """Take this rank's load."""
        self.f, self.iterations = f, 0

    def correct(self, multiplier: np.ndarray, alpha: np.ndarray) -> None:
        """Nothing to correct: every step solves the whole system."""

    def solve(self, step: InterfaceSystem, spring: float, centre: np.ndarray, may_open: np.ndarray):
        """One linear step; see ``Flexibility.solve``. α: motion of the dofs that springs hold."""
        f = self.f.copy()
        first = sum(self.comm.allgather(len(self._pins))[: self.comm.rank])
        f[self._pins] += spring * centre[first : first + len(self._pins)]
        K = with_springs(self.K, self._pins, np.full(len(f), spring))
        on = np.flatnonzero(step.active)
        multipliers = Numbering(self.rows.numbering.owner[on], self.comm.rank)
        slaved = SlavedRows(
            self.rows.dofs[on], self.rows.base[on], step.L[on], multipliers, self.frames, self.block
        )
        symmetric = abs(step.E - step.L.T).nnz == 0
        solve = self._symmetric if symmetric else self._with_friction
        u, found, w = solve(K, slaved, step, f, step.g[on][multipliers.mine])
        K.destroy()
        multiplier = np.zeros(len(step.active))
        multiplier[on] = gather_rows(self.comm, found)[multipliers.number]
        self._u = u
        y = self._surface_motion(u)
        alpha = gather_rows(self.comm, u[self._pins])
        wrong = wrong_signs(step, may_open, multiplier, y, w, self.scale)
        return multiplier, y, w, alpha, step.active, wrong

    def _symmetric(self, K, slaved, step, f, g):
        hold = -step.D.diagonal()
        centre = np.where(hold > 0.0, -step.rhs / np.where(hold > 0.0, hold, 1.0), 0.0)
        system = CondensedSystem(
            K, slaved, self.fixed, self.scale, modes=self.modes, proximal=hold,
            prefix=self._prefix, options=self._options,
        )  # fmt: skip
        u, multiplier, w = system.solve(f, g, centre)
        self.iterations += system.iterations
        self.method = system.method
        system.destroy()
        return u, multiplier, gather_rows(self.comm, w)[self.frames.number]

    def _with_friction(self, K, slaved, step, f, g):
        """T_lᵀ (f - K T q) + D w = rhs, where T_l has E in the place of L_bᵀ."""
        m = step.L.shape[1]
        form = Transformation(K, slaved, self.fixed, np.ones(m))
        if len(form.frame.dependent):
            raise ContactError(
                "solver='condensed' with friction: displacements are prescribed at contact nodes "
                "and bind the frame. Use solver='saddle'"
            )
        on = np.flatnonzero(step.active)
        E = step.E[:, on].T.tocsr()[slaved.multipliers.mine]
        test = self._test_matrix(form, K, E)
        KT = K.matMult(form.T)
        matrix = test.transposeMatMult(KT)
        at = form.seats, form.mine_used
        D = step.D[at[1]].tocoo()
        n = np.arange(form.sizes[0])  # with a stored diagonal
        entries = np.concatenate([-D.data, np.zeros(len(n))])
        index = (
            np.concatenate([at[0][D.row], n]),
            np.concatenate([form.columns[D.col], n + form.first]),
        )
        D = csr_matrix((entries, index), form.sizes)
        D = create_aij(K.comm, form.sizes, form.sizes, D)
        matrix.axpy(1.0, D, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        diagonal = matrix.getDiagonal()
        diagonal.array_w[form.idle] = 1.0
        matrix.setDiagonal(diagonal)
        u_0, v_0 = form.offsets(f, g)
        b = _transposed_times(test, f - _times(K, u_0))
        b[at[0]] -= step.rhs[at[1]]
        solver = DirectSolver(matrix, self._prefix, {"pc_type": "lu"}, own=True)
        q = solver.solve(b)
        solver.destroy()
        u = _times(form.T, q) + u_0
        force = f - _times(K, u)
        w = form.frame_motion(q, v_0)
        multiplier = form.A.T @ np.where(self.fixed, 0.0, force)
        for item in (test, KT, D, diagonal, form.T):
            item.destroy()
        self.method = "LU"
        return u, multiplier, w

    def _test_matrix(self, form: Transformation, K, E: csr_matrix):
        """T with A Eᵀ in the frame's columns."""
        body, frame = form.N.tocoo(), (form.A @ E).tocoo()
        value = np.concatenate([body.data, frame.data])
        row = np.concatenate([body.row, frame.row])
        col = np.concatenate([form.body[body.col] + form.first, form.columns[frame.col]])
        local = csr_matrix((value, (row, col)), shape=(len(self.fixed), form.sizes[1]))
        return create_aij(K.comm, K.getSizes()[0], form.sizes, local)

    def _surface_motion(self, u: np.ndarray) -> np.ndarray:
        """(n,) Bᵀu of all rows, on every rank; prescribed parts stand in g."""
        mine = self.rows.numbering.mine
        at = self.rows.dofs[mine] - self.K.getOwnershipRange()[0]
        motion = np.einsum("ri,ri->r", self.rows.base[mine], np.where(self.fixed[at], 0.0, u[at]))
        return gather_rows(self.comm, motion)[self.rows.numbering.number]

    def displacement(self, multiplier: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        """This rank's u of the last step; sets ``residual``, of K u + B λ = f."""
        mine = self.rows.numbering.mine
        load, at = self.f.copy(), self.rows.dofs[mine] - self.K.getOwnershipRange()[0]
        forces = multiplier[mine][:, None] * np.where(self.fixed[at], 0.0, self.rows.base[mine])
        np.subtract.at(load, at, forces)
        miss = np.abs(_times(self.K, self._u) - load).max(initial=0.0)
        sizes = [np.abs(self.f), np.abs(load), self.scale * np.abs(self._u)]
        found = self.comm.allgather((miss, max(a.max(initial=0.0) for a in sizes)))
        miss, size = np.max(found, axis=0)
        self.residual = miss / max(size, 1e-300)
        return self._u

    def destroy(self) -> None:
        """Nothing outlives a step."""


def _times(M, x: np.ndarray) -> np.ndarray:
    """This rank's part of M x."""
    right, left = M.createVecs()
    right.array_w[:] = x
    M.mult(right, left)
    values = left.array_r.copy()
    right.destroy()
    left.destroy()
    return values


def _transposed_times(M, x: np.ndarray) -> np.ndarray:
    """This rank's part of Mᵀ x."""
    right, left = M.createVecs()
    left.array_w[:] = x
    M.multTranspose(left, right)
    values = right.array_r.copy()
    right.destroy()
    left.destroy()
    return values
