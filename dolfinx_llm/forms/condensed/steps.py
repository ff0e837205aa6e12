"""Steps of contact laws in the condensed form: rows in contact are eliminated, others free.

Without friction the matrix stays symmetric positive definite, and CG with GAMG solves it at any
size. With friction the rows of κ hold Coulomb's law instead of the equilibrium of L_bᵀ λ; the
reduced matrix is then not symmetric and is factorised.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import identity
from scipy.sparse.linalg import splu

from dolfinx_llm.forms.condensed.elimination import EliminatedRows
from dolfinx_llm.forms.condensed.splitting import SplitStiffness
from dolfinx_llm.forms.condensed.system import CondensedSystem
from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.forms.direct import DirectSolver
from dolfinx_llm.forms.exchange import WholeSteps
from dolfinx_llm.forms.step import SOFT, LinearStep, StepResult, force_level
from dolfinx_llm.forms.verdict import FinalError
from dolfinx_llm.operators.numbering import Numbering


class CondensedSteps(WholeSteps):
    """The steps of ``iteration.ContactIteration`` in the condensed form.

    Args:
        multipliers: the multiplier ``Rows``.
        block: frame unknowns per node, 1 with friction.
        modes: near-null space, at the bodies' dofs and at the frame unknowns; None: none.
        K: taken over, as by ``SplitStiffness``.
        B, *others: as of ``WholeSteps``.
    """

    name = "the condensed form"
    accuracy = 1e-11  # of balance and law, relative: what CG leaves
    most = 60  # as of ``WholeSteps``

    def __init__(
        self,
        multipliers: Any,
        block: int,
        modes: tuple[np.ndarray, np.ndarray] | None,
        K: Any,
        B: Any,
        *others: Any,
    ) -> None:
        super().__init__(K, B, multipliers.numbering, *others)
        self.split = SplitStiffness(K, multipliers.dofs)
        self._multipliers, self._block, self._modes = multipliers, block, modes
        self.system: Any = None  # without friction, once there is one
        self._known = np.zeros(0)  # what the system's matrix was made of

    def solve(self, f: np.ndarray, step: LinearStep) -> StepResult:
        """See ``StepForm``."""
        given = step.compliance[step.active].max(initial=0.0) * self.scale
        if given > 10.0 * SOFT:
            raise FinalError(
                f"rows that give way (compliance {given:.1e} of the surfaces') cannot be "
                "eliminated: use solver='saddle' in the place of 'condensed'"
            )
        found = super().solve(f, step)
        if self.eager:  # what a factorisation leaves is the rounding of f - K u
            level = force_level(found.multiplier, found.y + step.g, self.scale)
            noise = 0.5 * self.noise / level
            self.accuracy = min(max(noise, WholeSteps.accuracy), CondensedSteps.accuracy)
        return found

    def _K_times(self, u: np.ndarray) -> Any:
        product = self.split.times(u)
        product[self._pins] -= self._spring * u[self._pins]
        return product

    def _set_up(self, step: LinearStep) -> Any:
        self._spring = step.spring
        on = np.flatnonzero(step.active)
        numbering = Numbering(self.rows.owner[on], self.comm.rank)
        dofs, base = self._multipliers.dofs[on], self._multipliers.base[on]
        eliminated = EliminatedRows(dofs, base, step.L[on], numbering, self.frames, self._block)
        symmetric = abs(step.E - step.L.T).nnz == 0
        self.eager = not symmetric  # to ask takes a solve by CG there, a factor's here
        set_up = self._symmetric if symmetric else self._with_friction
        solve, done = set_up(eliminated, step)

        def ask(f: np.ndarray, g: np.ndarray, rhs: np.ndarray) -> Any:
            u, found, w = solve(f, g[on][numbering.mine], rhs)
            multiplier = np.zeros(len(step.active))
            multiplier[on] = self._gather(numbering, found)
            return u, multiplier, w

        return ask, done

    def _symmetric(self, eliminated: EliminatedRows, step: LinearStep) -> Any:
        hold = -step.D.diagonal()
        wanted = np.concatenate([step.active, hold, [self._spring * self.floating.count]])
        if not np.array_equal(wanted, self._known):
            self.split.hold(self._pins, self._spring)
            if self.system is None:
                self.system = CondensedSystem(
                    self.split, eliminated, self.fixed, self.scale, self._prefix, self._options,
                    modes=self._modes, weak=self._weak(step), proximal=hold,
                )  # fmt: skip
            else:
                n = len(step.active)
                changed = int((wanted[:n] != self._known[:n]).sum())
                self.system.eliminate(eliminated, hold, changed)
            self._known = wanted

        def solve(f: np.ndarray, g: np.ndarray, rhs: np.ndarray) -> Any:
            centre = np.where(hold > 0.0, -rhs / np.where(hold > 0.0, hold, 1.0), 0.0)
            u, multiplier, w = self.system.solve(f, g, centre)
            return u, multiplier, self._gather(self.frames, w)

        return solve, lambda: None  # what is set up may serve the next step

    def _weak(self, step: LinearStep) -> Any:
        """Rigid motions of bodies that supports alone do not hold firmly, and of the frames."""
        rigid, L = self.floating.rigid.modes, step.L
        if not (L.shape[1] and rigid.shape[1]):
            return rigid, np.zeros((L.shape[1], rigid.shape[1]))
        fit = splu((L.T @ L + 1e-10 * identity(L.shape[1])).tocsc())
        return rigid, fit.solve(L.T @ self.floating.G)

    def _with_friction(self, eliminated: EliminatedRows, step: LinearStep) -> Any:
        """T_lᵀ (f - K T q) + D w + E λ_W = rhs, where T_l has E in the place of L_bᵀ.

        λ_W are the forces of rows that bind the frame alone. Without symmetry no combination of the
        frame's equations is free of them: they are unknowns, in the places of what they determine.
        As the rows of ``soft`` they give way a little, since friction may say the same (a node
        held on both sides that sticks).
        """
        self.split.hold(self._pins, self._spring)
        everywhere = np.ones(step.L.shape[1])
        form = Transformation(self.split, eliminated, self.fixed, everywhere, SOFT)
        E = step.E[:, np.flatnonzero(step.active)]
        test = form.columns_of(E.T.tocsr()[eliminated.multipliers.mine])
        law = form.frame_law(E, step.D, self.scale)
        matrix = form.reduce(-law, self.scale, test)
        own = {k: v for k, v in (self._options or {}).items() if k not in ("ksp_type", "pc_type")}
        solver = DirectSolver(matrix, self._prefix, own | {"pc_type": "lu"}, own=True)

        def solve(f: np.ndarray, g: np.ndarray, rhs: np.ndarray) -> Any:
            u_0, v_0 = form.offsets(f, g)
            b = form.load(f, u_0, test)
            b[len(f) + form.tail.seats] -= (rhs - step.D @ v_0)[form.tail.mine_used]
            q = solver.solve(b)
            u, force, S = form.motion(q) + u_0, np.zeros(len(f)), self.split.surface
            force[S] = np.where(self.fixed[S], 0.0, f[S] - self.split.rows(u))
            multiplier = form.A.T @ force + form.frame_multipliers(q, self.scale)
            return u, multiplier, form.frame_motion(q, v_0)

        def done() -> None:
            for item in (solver, test, form.T):
                item.destroy()

        return solve, done

    def destroy(self) -> None:
        for item in (self.system, self.split):
            if item is not None:
                item.destroy()
