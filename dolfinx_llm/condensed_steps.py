"""Steps of contact laws in the condensed form: the rows in contact are slaved, the others are free.

Without friction the matrix stays symmetric positive definite, and CG with GAMG solves it at any
size. With friction the rows of κ hold Coulomb's law instead of the equilibrium of L_bᵀ λ; the
reduced matrix is then not symmetric and is factorised.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm._parallel import ContactError
from dolfinx_llm.condensed import CondensedSystem
from dolfinx_llm.linear_step import InterfaceSystem
from dolfinx_llm.operators import Numbering, create_aij
from dolfinx_llm.slaving import SlavedRows
from dolfinx_llm.sparse_steps import WholeSteps
from dolfinx_llm.system import DirectSolver, times
from dolfinx_llm.transformation import Transformation


class CondensedSteps(WholeSteps):
    """The steps of ``iteration.ContactIteration`` in the condensed form.

    Args:
        multipliers: the multiplier ``Rows``.
        block: frame unknowns per node, 1 with friction.
        modes: near-null space, at the bodies' dofs and at the frame unknowns; None: none.
        K, B, *others: as of ``WholeSteps``.
    """

    accuracy = 1e-11  # of balance and law, relative: what CG leaves

    def __init__(self, multipliers, block: int, modes, K, B, *others):
        super().__init__(K, B, multipliers.numbering, *others)
        self._multipliers, self._block, self._modes = multipliers, block, modes

    def _solve(self, K, f, step: InterfaceSystem):
        on = np.flatnonzero(step.active)
        numbering = Numbering(self.rows.owner[on], self.comm.rank)
        dofs, base = self._multipliers.dofs[on], self._multipliers.base[on]
        slaved = SlavedRows(dofs, base, step.L[on], numbering, self.frames, self._block)
        symmetric = abs(step.E - step.L.T).nnz == 0
        solve = self._symmetric if symmetric else self._with_friction
        u, found, w = solve(K, slaved, step, f, step.g[on][numbering.mine])
        multiplier = np.zeros(len(step.active))
        multiplier[on] = self._gather(numbering, found)
        return u, multiplier, w

    def _symmetric(self, K, slaved, step, f, g):
        hold = -step.D.diagonal()
        centre = np.where(hold > 0.0, -step.rhs / np.where(hold > 0.0, hold, 1.0), 0.0)
        system = CondensedSystem(
            K, slaved, self.fixed, self.scale, modes=self._modes, proximal=hold,
            prefix=self._prefix, options=self._options,
        )  # fmt: skip
        u, multiplier, w = system.solve(f, g, centre)
        system.destroy()
        return u, multiplier, self._gather(self.frames, w)

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
        b = times(test, f - times(K, u_0), transposed=True)
        b[at[0]] -= step.rhs[at[1]]
        solver = DirectSolver(matrix, self._prefix, {"pc_type": "lu"}, own=True)
        q = solver.solve(b)
        solver.destroy()
        u = times(form.T, q) + u_0
        force = f - times(K, u)
        w = form.frame_motion(q, v_0)
        multiplier = form.A.T @ np.where(self.fixed, 0.0, force)
        for item in (test, KT, D, diagonal, form.T):
            item.destroy()
        return u, multiplier, w

    def _test_matrix(self, form: Transformation, K, E: csr_matrix):
        """T with A Eᵀ in the frame's columns."""
        body, frame = form.N.tocoo(), (form.A @ E).tocoo()
        value = np.concatenate([body.data, frame.data])
        row = np.concatenate([body.row, frame.row])
        col = np.concatenate([form.body[body.col] + form.first, form.columns[frame.col]])
        local = csr_matrix((value, (row, col)), shape=(len(self.fixed), form.sizes[1]))
        return create_aij(K.comm, K.getSizes()[0], form.sizes, local)
