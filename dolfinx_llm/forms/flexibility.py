"""The bodies as their interfaces see them: factorised once, then a small dense system.

With few contact pairs the cheapest way through opening and friction is to ask the bodies only once
how their surfaces answer to contact forces, y = Bᵀu = h - F λ + G α with F = Bᵀ K⁻¹ B (α: motion of
bodies that supports alone do not hold), and to iterate on that.
"""

from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.log import progress
from dolfinx_llm.base.parallel import chosen
from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.forms.dense import choose, refined
from dolfinx_llm.forms.direct import COLUMNS, DirectSolver
from dolfinx_llm.forms.step import LinearStep, StepForm, StepResult, wrong_signs
from dolfinx_llm.forms.verdict import largest, singular
from dolfinx_llm.operators.petsc import local_csr, with_springs
from dolfinx_llm.operators.system import ContactOperators

ROUGHLY = 1e-12  # of a load, up to which a solve that leaves it is not refined
CHANGED = 1e-6  # of the largest multiplier: what is refined once changes by less


class Flexibility(StepForm):
    """K factorised, and the answer of the surfaces to unit multipliers."""

    name = "flexibility"
    accuracy = 1e-13  # of balance and law, relative
    light = True
    proximal = 1e-13  # the smaller, the sooner nodes under a tiny force are where they touch

    def __init__(
        self,
        prefix: str = "llm_",
        options: dict[str, Any] | None = None,
        times: StageTimes | None = None,
    ) -> None:
        self._prefix, self._options = prefix, options
        self._times = StageTimes() if times is None else times
        self._solver: Any = None  # ``DirectSolver`` of K with springs, once there is one

    def prepare(self, K: PETSc.Mat, operators: ContactOperators) -> None:
        """See ``StepForm``."""
        self.destroy()
        super().prepare(K, operators)
        with self._times.timed("factorisation"):
            self._ask_bodies()

    def _ask_bodies(self) -> None:
        """Factorise K, and ask for the surfaces' answers."""
        operators = self.operators
        self.rows, self.scale = operators.rows.numbering, operators.scale
        self.comm, self.floating = operators.comm, operators.floating
        rigid = self.floating.rigid
        self._local_B = local_csr(operators.B)
        self._local_B_t = self._local_B.T.tocsr()
        # Springs hold all rigid motions, also those that springs of the form a hold weakly: under
        # forces in balance they carry nothing.
        pinned = with_springs(self.K, rigid.pins(len(rigid.body)), operators.diagonal)
        self._solver = DirectSolver(pinned, self._prefix, self._options, own=True)
        # What is left of K u + B λ = f when u = K_p⁻¹ (f - B λ) + Q α, with Q = R - K_p⁻¹ K R that
        # leaves the springs at the pins alone, is Qᵀ (f - B λ) = Qᵀ K R α.
        self.modes = rigid.modes
        k = len(rigid.body)
        weak, mixed = np.arange(rigid.free, k), operators.dofs.mixed
        # Dofs that are no displacements have no body's label: there one motion at a time.
        for some in weak[:, None] if mixed else rigid.one_of_each(weak):
            answer = self._solver.solve(rigid.forces[:, some].sum(axis=1).A1)
            motion = np.full(len(answer), some[0]) if mixed else rigid.owner(some)
            on = np.flatnonzero(motion >= 0)
            self.modes = self.modes - csr_matrix((answer[on], (on, motion[on])), self.modes.shape)
        self._own = np.zeros((k, k))  # Qᵀ K R
        own = self.modes[:, weak].T @ rigid.forces[:, weak]
        self._own[np.ix_(weak, weak)] = self.comm.allreduce(own.toarray())
        self._own = 0.5 * (self._own + self._own.T)
        self._held = np.zeros((k, k))
        self._held[: rigid.free, : rigid.free] = self.floating.square.toarray()
        self.G = self._interface_sum((self._local_B_t @ self.modes).toarray())
        self.F: Any = self._flexibility()  # (n, n) on rank 0, None elsewhere
        self.f: Array | None = None  # this rank's load that y and r are of
        self._u = np.zeros(self.modes.shape[0])  # what ``_pinned`` found last
        self._of: Any = None, np.zeros(self.rows.sizes[1])  # load and λ that it is for
        self._stiff = np.where(operators.dofs.fixed, self.scale, 1.0)  # their rows are identities
        self._factor: Any = None  # ``LinearStep`` that was solved last, and its solver

    def _interface_sum(self, part: Array) -> Array:
        """Sum over ranks of a part with one row per multiplier, in their own order."""
        return self.comm.allreduce(part)[self.rows.number]

    def _flexibility(self) -> Array | None:
        """F on rank 0, None elsewhere."""
        n = self.rows.sizes[1]
        F = np.empty((n, n)) if self.comm.rank == 0 else None
        columns = self._local_B.tocsc()
        for first in progress(range(0, n, COLUMNS), "flexibility of the surfaces"):
            last = min(first + COLUMNS, n)
            solved = self._solver.solve_many(columns[:, first:last].toarray())
            part = self.comm.reduce(self._local_B_t @ solved, root=0)
            if F is not None:
                F[:, first:last] = part
        if F is None:
            return None
        return 0.5 * (F + F.T)[np.ix_(self.rows.number, self.rows.number)]

    def _load(self, f: Array) -> None:
        """Take this rank's load: y, and the resultant along the floating modes."""
        self.f = f
        self._take(self._of[1])
        self.r = self.comm.allreduce(self.modes.T @ f)
        self._alpha = np.zeros(len(self.r))

    def solve(self, f: Array, step: LinearStep) -> StepResult:
        """See ``StepForm``; where pairs change, the complementarity λ >= 0, gap >= 0, λ gap = 0 is
        solved."""
        if f is not self.f:
            self._load(f)
        try:
            found = chosen(self.comm, lambda: self._settled(step))
        except (np.linalg.LinAlgError, ValueError) as failed:
            raise singular(failed) from None
        multiplier, y, w, self._alpha, active, wrong = found
        free = self._alpha[: self.floating.count]
        return StepResult(np.zeros(0), multiplier, y, w, free, active, wrong)

    def _settled(self, step: LinearStep) -> tuple[Array, ...]:
        """What ``_judged`` finds, on rank 0, for the rows that come to be in contact; where nothing
        determines which these are, for those of the step."""
        result = self._judged(step, step.active)
        if result[-1].any():
            equations = self._equations(step, np.arange(len(step.active)))
            with suppress(np.linalg.LinAlgError, ValueError):
                result = self._judged(step, choose(step, *equations))
        return result

    def _judged(self, step: LinearStep, active: Array) -> tuple[Array, ...]:
        """λ, y, w and α with these rows in contact, the rows, and those with a wrong sign."""
        found = self._dense(replace(step, active=active))
        return *found, active, wrong_signs(step, active, *found[:3], self.scale)

    def _equations(self, step: LinearStep, on: Array) -> tuple[Array, Array]:
        """Matrix and right-hand side of the rows ``on``, the frame and the rigid motions.

        Unknowns λ / c, w, α: every entry is then a pure number.
        """
        c, n, m, k = self.scale, len(on), step.L.shape[1], len(self.r)
        A = np.zeros((n + m + k, n + m + k))
        A[:n, :n] = c * self.F[np.ix_(on, on)] + np.diag(c * step.compliance[on])
        A[:n, n : n + m] = step.L.toarray()[on]
        A[:n, n + m :] = -self.G[on]
        A[n : n + m, :n] = step.E.toarray()[:, on]
        A[n : n + m, n : n + m] = step.D.toarray() / c
        A[n + m :, :n] = self.G[on].T
        A[n + m :, n + m :] = (self._own + step.spring * self._held) / c
        return A, self._rhs(step, on)

    def _rhs(self, step: LinearStep, on: Array) -> Array:
        c, k = self.scale, len(step.anchor)
        pull = self.r + step.spring * self._held[:, :k] @ step.anchor
        h = self.y + self.F @ self._at
        return np.concatenate([h[on] + step.g[on], step.rhs / c, pull / c])

    def _dense(self, step: LinearStep) -> tuple[Array, Array, Array, Array]:
        """λ, y, w and α, refined once by the gaps that they leave with y about what is known. Large
        answers of slender bodies add up with more rounding than their surfaces move: where gaps
        that are left move no force, y of rows in contact is what these say."""
        on, n = np.flatnonzero(step.active), int(step.active.sum())
        if self._factor is None or not step.same_matrix(self._factor[0]):
            self._factor = step, refined(self._equations(step, on)[0])
        solve, b = self._factor[1], self._rhs(step, on)
        multiplier, x = np.zeros(len(step.active)), np.zeros(len(b))
        for _ in range(2):
            x = x + (change := solve(b[:, None])[:, 0])
            multiplier[on], w, alpha = self.scale * x[:n], *np.split(x[n:], [step.L.shape[1]])
            y = self.y - self.F @ (multiplier - self._at) + self.G @ alpha
            says = step.L @ w + step.compliance * multiplier - step.g
            b = np.append((y - says)[on], np.zeros(len(x) - n))
        if np.abs(change[:n]).max(initial=0.0) <= CHANGED * np.abs(x[:n]).max(initial=0.0):
            y[on] = says[on]
        return multiplier, y, w, alpha

    def displacement(self, found: StepResult) -> Array:
        """See ``StepForm``."""
        return self._pinned(found.multiplier) + self.modes @ self._alpha

    def _pinned(self, multiplier: Array) -> Array:
        """This rank's displacement under f - B λ where springs hold the pins: the last one with
        what that leaves, which refines it; a second solve where the first was rough."""
        if self._of[0] is not self.f or (self._of[1] != multiplier).any():
            load = self.f - self._local_B @ self._in_petsc_order(multiplier)
            left = self._solver.left(load, self._u)
            self._u = self._u + self._solver.once(left)
            again = self._solver.left(load, self._u)
            was, still = largest(self.comm, self._stiff * left, self._stiff * again)
            if still > ROUGHLY * was:
                self._u = self._u + self._solver.once(again)
            self._of = self.f, multiplier
        return self._u

    def correct(self, found: StepResult) -> None:
        """Take y from the displacement for these multipliers: F and the pinned solve of the load
        alone are subject to rounding that the forces together are not."""
        self._take(found.multiplier)

    def _take(self, multiplier: Array) -> None:
        """y for some multipliers without α, from the displacement, and these; collective."""
        self.y = self._interface_sum(self._local_B_t @ self._pinned(multiplier))
        self._at = multiplier

    def _in_petsc_order(self, values: Array) -> Array:
        """Values of the multipliers by their global number."""
        ordered = np.empty_like(values)
        ordered[self.rows.number] = values
        return ordered

    def describe(self) -> str:
        """See ``StepForm``."""
        return "saddle, on the flexibility of the surfaces, K factorised once by MUMPS"

    def destroy(self) -> None:
        """See ``StepForm``."""
        if self._solver is not None:
            self._solver.destroy()
        self._solver = None
