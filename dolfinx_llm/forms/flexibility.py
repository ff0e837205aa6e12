"""The bodies as their interfaces see them: factorised once, then a small dense system.

With few contact pairs the cheapest way through opening and friction is to ask the bodies only once
how their surfaces answer to contact forces, y = Bᵀu = h - F λ + G α with F = Bᵀ K⁻¹ B (α: motion of
bodies that supports alone do not hold), and to iterate on that.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.log import progress
from dolfinx_llm.base.parallel import chosen
from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.forms.direct import DirectSolver
from dolfinx_llm.forms.step import SIGN, LinearStep, StepForm, StepResult, wrong_signs
from dolfinx_llm.forms.verdict import largest, singular
from dolfinx_llm.laws.complementarity import complementarity
from dolfinx_llm.operators.petsc import local_csr, with_springs
from dolfinx_llm.operators.system import ContactOperators

COLUMNS = 64  # right-hand sides solved at once
ROUGHLY = 1e-12  # of a load, up to which a solve that leaves it is not refined


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
        self.f: Array | None = None  # this rank's load that h and r are of
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
        F = F[np.ix_(self.rows.number, self.rows.number)]
        return 0.5 * (F + F.T)

    def _load(self, f: Array) -> None:
        """Take this rank's load: h, and the resultant along the floating modes."""
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
                result = self._judged(step, _choose(step, *equations))
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
        held = step.spring * self._held
        A = np.zeros((n + m + k, n + m + k))
        A[:n, :n] = c * self.F[np.ix_(on, on)] + np.diag(c * step.compliance[on])
        A[:n, n : n + m] = step.L.toarray()[on]
        A[:n, n + m :] = -self.G[on]
        A[n : n + m, :n] = step.E.toarray()[:, on]
        A[n : n + m, n : n + m] = step.D.toarray() / c
        A[n + m :, :n] = self.G[on].T
        A[n + m :, n + m :] = (self._own + held) / c
        return A, self._rhs(step, on)

    def _rhs(self, step: LinearStep, on: Array) -> Array:
        c, k = self.scale, len(step.anchor)
        pull = self.r + step.spring * self._held[:, :k] @ step.anchor
        return np.concatenate([self.h[on] + step.g[on], step.rhs / c, pull / c])

    def _dense(self, step: LinearStep) -> tuple[Array, Array, Array, Array]:
        on, c, m = np.flatnonzero(step.active), self.scale, step.L.shape[1]
        x = self._solved(step, on)
        multiplier, n = np.zeros(len(step.active)), len(on)
        multiplier[on] = c * x[:n]
        alpha = x[n + m :]
        y = self.h - self.F @ multiplier + self.G @ alpha
        return multiplier, y, x[n : n + m], alpha

    def _solved(self, step: LinearStep, on: Array) -> Array:
        """Unknowns of the rows ``on``, the frame and the rigid motions; what was factorised serves
        all steps of the same matrix."""
        if self._factor is None or not step.same_matrix(self._factor[0]):
            self._factor = step, _refined(self._equations(step, on)[0])
        return np.asarray(self._factor[1](self._rhs(step, on)[:, None]))[:, 0]

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
        """Take h from the displacement for these multipliers: F and the pinned solve of the load
        alone are subject to rounding that the forces together are not."""
        self._take(found.multiplier)

    def _take(self, multiplier: Array) -> None:
        """h on rank 0, from the displacement for some multipliers."""
        y = self._interface_sum(self._local_B_t @ self._pinned(multiplier))
        if self.comm.rank == 0:
            self.h = y + self.F @ multiplier

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


def _choose(step: LinearStep, A: Array, rhs: Array) -> Array:
    """Rows in contact: linear complementarity among those whose sign is or becomes wrong. A x = rhs
    are the equations of all rows, the frame and the rigid motions.

    The others keep their state and are eliminated. Eliminating the frame without them would leave
    its nodes to the proximal term, whose compliance drowns that of the bodies.
    """
    n, rows = len(step.active), np.flatnonzero(step.may_open)
    kept = np.concatenate([np.flatnonzero(step.active), np.arange(n, len(A))])
    place = np.cumsum(step.active) - 1
    on = step.active[rows]
    solve = _refined(A[np.ix_(kept, kept)])
    look = A[np.ix_(rows, kept)]

    def signs(x: Array, gap: Array) -> Array:
        """What must not be negative: λ / c in contact, gaps elsewhere."""
        found = look @ x + gap
        found[on] = x[place[rows[on]]]
        return found

    x = solve(rhs[kept][:, None])
    now = signs(x, -rhs[rows][:, None])[:, 0]
    band = SIGN * max(np.abs(x[: int(step.active.sum())]).max(initial=0.0), 1e-300)
    pairs, new = np.empty(0, dtype=np.int64), np.flatnonzero(now < -band)
    columns, change = np.empty((len(rows), 0)), np.zeros(0, dtype=bool)
    while len(new):
        load = np.where(on[new], 0.0, -1.0) * A[np.ix_(kept, rows[new])]
        load[place[rows[new[on[new]]]], np.flatnonzero(on[new])] = 1.0
        gap = np.where(on[new], 0.0, 1.0) * A[np.ix_(rows, rows[new])]
        columns = np.hstack([columns, signs(solve(load), gap)])
        pairs = np.concatenate([pairs, new])
        change = complementarity(columns[pairs], now[pairs], now[pairs] < 0.0)
        M = columns[pairs][np.ix_(change, change)]
        after = now + columns[:, change] @ np.linalg.solve(M, -now[pairs][change])
        after[pairs] = 0.0
        new = np.flatnonzero(after < -band)
    active = step.active.copy()
    active[rows[pairs[change]]] ^= True
    return active


def _refined(A: Array) -> Callable[[Array], Array]:
    """Solves dense systems with A, rows scaled and with one step of refinement; ``LinAlgError``
    where A is singular."""
    if not len(A):  # supports hold the body, and nothing touches the obstacle
        return lambda b: b
    scale = 1.0 / np.maximum(np.abs(A).max(axis=1), 1e-300)[:, None]
    A = A * scale
    factor = scipy.linalg.lu_factor(A, check_finite=False)
    if not np.abs(np.diagonal(factor[0])).min(initial=np.inf) > 0.0:
        raise np.linalg.LinAlgError("a pivot is zero")

    def solve(b: Array) -> Array:
        b = b * scale
        x = scipy.linalg.lu_solve(factor, b, check_finite=False)
        x += scipy.linalg.lu_solve(factor, b - A @ x, check_finite=False)
        if not np.isfinite(x).all():
            raise np.linalg.LinAlgError("the solution is not finite")
        return x

    return solve
