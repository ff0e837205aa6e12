"""Steps with friction in the condensed form: GMRES, or a factorisation where that does not serve.

    T_lᵀ (f - K T q) + D w + E λ_W = rhs, where T_l has E in the place of L_bᵀ.

λ_W are the forces of rows that bind the frame alone. Without symmetry no combination of the
frame's equations is free of them: they are unknowns, in the places of what they determine. As
the step has it they give way to changes, since friction may say the same (a node held on both
sides that sticks).
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.parallel import gather_rows
from dolfinx_llm.forms.condensed.elimination import EliminatedRows
from dolfinx_llm.forms.condensed.gmres import solve_right
from dolfinx_llm.forms.condensed.kept import SET_UP, FrictionSystem
from dolfinx_llm.forms.condensed.reduced import WeakMotions
from dolfinx_llm.forms.condensed.symmetric import Reduced
from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.forms.direct import DirectSolver
from dolfinx_llm.forms.step import LinearStep
from dolfinx_llm.operators.petsc import diagonal_of, times

LEAVES = 1e-2  # of a residual about the last iterate, by a linear solve, at most
FIRMLY = 1e-6  # the same where that misleads the law
HARD = 12.0  # iterations per digit: so many
APART = 30.0  # times another body's stiffness: forces on the stiffer one hardly show in residuals
ASTRAY = 1e3  # times the load: residuals of the last solution from which on it is no start
AT_ROUNDING = 1e-10  # of the load: where GMRES has got there, rounding alone leaves no more
FINAL = 1e-13  # of the load: nothing less is asked for
SOLVED = 1e-12  # of the load: what is solved as far may be the end of an iteration
HOPELESS = 150  # iterations with a multigrid of the same step, then a factorisation takes over
OUTWORN = 2.0  # times the iterations per digit of a new multigrid, from which on it is made anew
SPARE = 8  # iterations more that an old one may take
ENDS = 1e3  # times the goal: a residual from which on a solve is one of the last towards a load
OTHER = 0.3  # of the places on the surfaces: where more have changed, a new one is quicker
EASY = 4.0  # iterations per digit: where a new one takes more, the old one corrected is as good


class FrictionStep:
    """One step's matrix.

    Args:
        of: what is kept.
        eliminated: rows in contact.
        on: (r,) their places among all.
        step: the step.
    """

    def __init__(
        self, of: FrictionSystem, eliminated: EliminatedRows, on: np.ndarray, step: LinearStep
    ) -> None:
        self._of, self._split, self._step, self._on = of, of.split, step, on
        self._fixed, self._scale = of.operators.dofs.fixed, of.operators.scale
        self._reduced: Any = None  # ``Reduced``, where GMRES is to solve
        self._solver: DirectSolver | None = None
        if not of.direct:
            try:
                self._reduced = Reduced(step, of.operators)
            except (np.linalg.LinAlgError, RuntimeError) as error:
                of.give_up(f"the law's rows cannot be taken apart ({error})")
        L = eliminated.L if self._reduced is None else self._reduced.L[on]
        self._rows = replace(eliminated, L=L)
        self._assemble()
        if self._reduced is None:
            self._factorise()
        else:
            diagonal = diagonal_of(self._split.inside), diagonal_of(self._blocks[2])
            self._scaling = scales_of(np.concatenate(diagonal), self._scale)

    def _assemble(self) -> None:
        """Blocks of the matrix, of the step as it is or reduced."""
        law = self._step if self._reduced is None else self._reduced
        soft = self._scale * self._step.compliance[self._on]
        everywhere = np.ones(self._step.L.shape[1])
        self._form = Transformation(
            self._split, self._rows, self._fixed, everywhere, soft, whole=True
        )
        self._E, self._D = law.E[:, self._on], law.D
        self._test = self._form.columns_of(self._E.T.tocsr()[self._rows.multipliers.mine])
        laws = self._form.frame_law(self._E, self._D, self._scale)
        self._blocks: tuple = self._form.blocks(-laws, self._scale, self._test)

    def _factorise(self) -> None:
        prefix, own = self._of.own_options(("ksp_type", "pc_type"))
        matrix = self._split.joined(self._blocks)
        self._blocks = ()
        matrix.setBlockSize(self._form.gdim)
        self._solver = DirectSolver(matrix, prefix, own | {"pc_type": "lu"}, own=True)

    def ask(
        self, f: np.ndarray, g: np.ndarray, rhs: np.ndarray, about: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See ``SetUp``."""
        form, split, numbering = self._form, self._split, self._rows.multipliers
        kept = np.zeros(len(self._on)) if about is None else form.bound(about[self._on])
        w_0, C = 0.0, None
        if self._reduced is not None:
            (g, rhs, w_0), C = self._reduced.loads(g, rhs), self._reduced.C
        u_0, v_0 = form.offsets(f, g[self._on][numbering.mine])
        b = form.load(f, u_0, self._test)
        left = rhs - self._E @ kept - self._D @ v_0
        b[len(f) + form.tail.seats] -= left[form.tail.mine_used]
        if self._solver is None:
            q = self._iterate(b, self._guess(u_0, v_0, kept) if about is not None else 0.0 * b,
                              about is not None)  # fmt: skip
        if self._solver is not None:
            q = self._solver.solve(b)
        u, force, S = form.motion(q) + u_0, np.zeros(len(f)), split.surface
        force[S] = np.where(self._fixed[S], 0.0, f[S] - split.rows(u))
        found = form.A.T @ force + form.frame_multipliers(q, self._scale)
        multiplier = np.zeros(len(g))
        multiplier[self._on] = gather_rows(split.comm, found)[numbering.number] + kept
        w = form.frame_motion(q, v_0)
        w = w if C is None else C @ w + w_0
        if about is not None:
            self._of.last = u, multiplier, w
        return u, multiplier, w

    def _guess(self, u_0: np.ndarray, v_0: np.ndarray, kept: np.ndarray) -> np.ndarray:
        """q of the last solution."""
        if self._of.last is None:
            return np.zeros(len(self._scaling))
        u, multiplier, w = self._of.last
        form = self._form
        z = np.where(self._reduced.told, 0.0, w)
        q = form.unknowns((u - u_0)[:, None], (z - v_0)[:, None])[:, 0]
        force = np.zeros(len(z))
        bound = form.bound_parts(multiplier[self._on] - kept)
        force[form.frame.dependent] = form.frame.Q.T @ bound / self._scale
        seats = np.isin(form.tail.mine_used, form.frame.dependent)
        q[len(u) + form.tail.seats[seats]] = force[form.tail.mine_used[seats]]
        return q

    def _times(self, q: np.ndarray) -> np.ndarray:
        n, (right, below, corner) = len(self._fixed), self._blocks
        body = times(self._split.inside, q[:n]) + times(right, q[n:])
        return np.concatenate([body, times(below, q[:n]) + times(corner, q[n:])])

    def _norm(self, r: np.ndarray) -> float:
        return float(np.sqrt(self._split.comm.allreduce(float(np.sum((self._scaling * r) ** 2)))))

    def _iterate(self, b: np.ndarray, q: np.ndarray, main: bool) -> Any:
        """q by GMRES; None where it does not get there, and ``_solver`` has taken over."""
        of, load = self._of, self._norm(b)
        began, before, ready = time.perf_counter(), of.iterations, of.seconds
        try:
            q, size = self._improved(b, q, load, main)
        except ContactInputError:
            raise
        except ContactError as error:
            of.give_up(f"GMRES + GAMG ended without an answer ({error})")
            self._factorise()
            return None
        if main:
            of.residual, of.left = size / load if load > 0.0 else 0.0, size
        spent, ready = time.perf_counter() - began, of.seconds - ready
        took = {"iterations": of.iterations - before, "set-up": ready, "solve": spent - ready}
        of.steps.append(took)
        return q

    def _improved(
        self, b: np.ndarray, q: np.ndarray, load: float, main: bool
    ) -> tuple[np.ndarray, float]:
        """q as near to the solution as it has to be, and its residual.

        Raises:
            ContactError: GMRES does not get there with a multigrid of this very step.
        """
        of, size = self._of, self._norm(self._left(b, q))
        if not size <= ASTRAY * load:
            q, size = 0.0 * q, load  # what is left of the load
        same = abs(size - of.left) < 1e-6 * of.left  # nothing has changed since
        goal = FINAL * load if same or not main else goal_of(size, load, of.loose, easy(of))
        fresh = self._serve(False, size > ENDS * goal)
        while size > goal and load > 0.0:
            before, digits = size, float(np.log10(size / goal))
            limit = HOPELESS if fresh else int(OUTWORN * of.usual * digits) + SPARE
            change, took, reason = self._gmres(self._left(b, q), goal / size, limit)
            q += change
            size = self._norm(self._left(b, q))
            of.count(took, digits, fresh)
            if size <= 2.0 * goal:
                break
            if not fresh:
                fresh = self._serve(True, True)
            elif not size < 0.1 * before:
                if reason > 0 and size <= AT_ROUNDING * load:
                    return q, 0.0
                left = f"{size / load:.0e} of the load left"
                raise ContactError(f"{took} iterations, PETSc's reason {reason}, {left}")
        return q, size

    def _left(self, b: np.ndarray, q: np.ndarray) -> np.ndarray:
        """b - A q, once q has taken weak motions."""
        left = b - self._times(q)
        return left if self._of.weak is None else self._motions.take(q, left)

    @cached_property
    def _motions(self) -> WeakMotions:
        """Rigid motions that supports do not hold."""
        body, frame = self._of.weak
        W = self._form.unknowns(body, np.where(self._reduced.told[:, None], 0.0, frame))
        return WeakMotions(self._split.comm, W, self._times, self._norm)

    def _serve(self, anew: bool, far: bool) -> bool:
        """Fit the multigrid to this step, or make it anew, also where the step differs by much and
        is to be solved far; whether it is new."""
        of, step = self._of, (self._form, self._rows, self._reduced)
        began, other = time.perf_counter(), 1.0 if of.kept is None else of.kept.meet(*step)
        worn = of.kept is None or of.excess > SET_UP
        anew = anew or worn or (far and other > OTHER and of.usual < EASY)
        if anew:
            of.multigrid(*step[1:]).meet(*step)
        of.kept.fit(self._form, self._reduced, self._blocks)
        of.seconds += time.perf_counter() - began
        return anew

    def _gmres(self, r: np.ndarray, rtol: float, limit: int) -> tuple[np.ndarray, int, int]:
        """What solves for a residual, the iterations that it took, and PETSc's reason."""
        by, n = self._scaling, len(self._fixed)

        def precondition(x: np.ndarray) -> np.ndarray:
            r = x / by
            return np.concatenate(self._of.kept.apply(r[:n], r[n:])) / by

        x, took, reason = solve_right(
            self._split.inside.comm, lambda x: by * self._times(by * x), precondition, by * r,
            "gmres", (rtol, 0.0, 1e30, limit),
        )  # fmt: skip
        return by * x, took, reason

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        if self._of.kept is not None:
            self._of.kept.release()
        for item in (self._solver, self._test, self._form.T, *self._blocks):
            if item is not None:
                item.destroy()


def easy(of: FrictionSystem) -> bool:
    """Whether the law may follow loose solves."""
    alike = all(side.max() <= APART * side.min() for side in of.operators.stiffness)
    return alike and of.usual < HARD


def scales_of(diagonal: np.ndarray, scale: float) -> np.ndarray:
    """Inverse square roots of a diagonal; of entries that are none that of ``scale``."""
    size = np.abs(diagonal)
    return 1.0 / np.sqrt(np.where(size > 1e-12 * scale, size, scale))


def goal_of(size: float, load: float, loose: float | None, easily: bool) -> float:
    """What a solve is to leave of a residual about the last iterate, of the sizes of that and of
    the load, or of the load where that is given. Newton's next residual is about the square of one:
    less is not worth it. Where it does not follow ``easily`` loose solves mislead the law."""
    if loose is not None:
        return max(loose, FINAL) * load
    leaves = LEAVES if easily else FIRMLY
    return max(min(leaves, size / load) * min(size, load), FINAL * load)
