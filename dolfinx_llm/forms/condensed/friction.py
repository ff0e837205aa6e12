"""Steps with friction in the condensed form: GMRES, or a factorisation where that does not serve.

    T_lᵀ (f - K T q) + D w + E λ_W = rhs, where T_l has E in the place of L_bᵀ.

λ_W are the forces of rows that bind the frame alone. Without symmetry no combination of the
frame's equations is free of them: they are unknowns, in the places of what they determine. As
the step has it they give way to changes, since friction may say the same (a node held on both
sides that sticks).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.forms.condensed.elimination import EliminatedRows
from dolfinx_llm.forms.condensed.friction_matrix import FrictionMatrix, of_bodies
from dolfinx_llm.forms.condensed.friction_system import FrictionSystem
from dolfinx_llm.forms.condensed.gmres import solve_right
from dolfinx_llm.forms.condensed.measure import LEFT_BY_ROUNDING, Measure
from dolfinx_llm.forms.condensed.reduced import WeakMotions
from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.forms.direct import COLUMNS, DirectSolver
from dolfinx_llm.forms.exchange import Answer, Load, SetUp
from dolfinx_llm.forms.step import LinearStep

ASTRAY = 1e3  # times the load: residuals of the last solution from which on it is no start
AT_ROUNDING = 1e-10  # of the load: where GMRES has got there, rounding alone leaves no more
SOLVED = 1e-12  # of the load: what is solved as far may be the end of an iteration
HOPELESS = 150  # iterations with a multigrid of the same step, then a factorisation takes over
OUTWORN = 2.0  # times the iterations per digit of a new multigrid, from which on it is made anew
REFINES = 2  # solves with a factorisation for what is left by the bodies' own stiffness
SPARE = 8  # iterations more that an old one may take


class FrictionStep(FrictionMatrix, SetUp):
    """One step, solved; arguments as of ``FrictionMatrix``."""

    def __init__(
        self, of: FrictionSystem, eliminated: EliminatedRows, on: Array, step: LinearStep
    ) -> None:
        super().__init__(of, eliminated, on, step)
        self._solver: DirectSolver | None = None
        if self._reduced is None:
            self._factorise()
        else:
            self._by = Measure(of, self._form, self._corner)

    def _factorise(self) -> None:
        self.columns = COLUMNS
        self._solver = _factors(self._of, self._form, self._test, self._corner)
        self._corner = None

    def ask(
        self, f: Array, g: Array, rhs: Array, about: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """See ``SetUp``."""
        form, main = self._form, about is not None
        loads, kept, own, w_0 = self._begun(f, g, rhs, about)
        u_b, z_b = np.zeros(len(f)), np.zeros(len(loads[2]))
        b, u_0, v_0 = self._loads_about(u_b, z_b, *loads)
        q: Any = None
        if self._solver is None:
            load, start = self._by.norm(b), 0.0 * b
            if main and self._of.last is not None:
                (u, last, w), told = self._of.last, self._reduced.told
                z = np.where(told, 0.0, w)
                forces = form.force_unknowns(last[self._on] - kept, self._scale)
                then = self._loads_about(u, z, *loads)
                if self._by.norm(self._left(then[0], forces)) <= ASTRAY * load:
                    u_b, z_b, (b, u_0, v_0), start = u, z, then, forces
            around = (f, u_b + u_0) if main and not self._of.loose else None
            q = self._iterate(b, start, load, around, main)
        if self._solver is not None:
            q = self._solver.once(b)
            for _ in range(REFINES * main):
                u_b, z_b = u_b + (form.motion(q) + u_0), z_b + form.frame_motion(q, v_0)
                gaps = loads[1] - self._gives * (of_bodies(form, f, u_b) - own)
                b, u_0, v_0 = self._loads_about(u_b, z_b, f, gaps, loads[2])
                forces = form.forces_alone(q)
                q = forces + self._solver.once(self._solver.left(b, forces))
        answer = self._answer(q, f, kept, w_0, (u_b, z_b, u_0, v_0))
        if main:
            self._of.last = answer
        return answer

    def ask_many(self, loads: Sequence[Load]) -> list[Answer]:
        """See ``SetUp``."""
        if self._solver is None:
            return super().ask_many(loads)
        begun = [self._begun(*load, None) for load in loads]
        none = np.zeros(len(self._fixed)), np.zeros(len(begun[0][0][2]))
        right = [self._loads_about(*none, *one) for one, *_ in begun]
        found = self._solver.solve_many(np.column_stack([b for b, *_ in right]))
        each = zip(found.T, begun, right, strict=True)
        return [
            self._answer(q, f, kept, w_0, (*none, u_0, v_0))
            for q, ((f, *_), kept, _, w_0), (_, u_0, v_0) in each
        ]

    def _iterate(self, b: Array, q: Array, load: float, around: Any, main: bool) -> Any:
        """q by GMRES; None where it does not get there, and ``_solver`` has taken over."""
        of = self._of
        began, before, ready = time.perf_counter(), of.iterations, of.seconds
        try:
            q, size, level = self._improved(b, q, load, around, main)
        except ContactInputError:
            raise
        except ContactError as error:
            of.give_up(f"GMRES + GAMG gave no answer ({error})")
            self._factorise()
            return None
        if main:
            of.residual, of.left = size / level if level > 0.0 else 0.0, size
        spent = time.perf_counter() - began - (of.seconds - ready)  # what is set up on the way
        took = {"iterations": of.iterations - before, "set-up": of.seconds, "solve": spent}
        of.steps.append(took)
        of.seconds = 0.0
        return q

    def _improved(
        self, b: Array, q: Array, load: float, around: Any, main: bool
    ) -> tuple[Array, float, float]:
        """q as near to the solution as it has to be, its residual, and what that is measured by.

        Raises:
            ContactError: GMRES does not get there with a multigrid of this very step.
        """
        of, left = self._of, self._left(b, q)
        served = self._form, self._rows, self._reduced, self._test, self._corner
        size = start = self._by.norm(left)
        same = not main or abs(size - of.left) < 1e-6 * of.left  # nothing has changed since
        of.watch(start, main)
        level = load if of.last is None else self._by.level(q, around, load)
        goal = self._by.goal(size, level, load, same)
        fresh = of.serve(*served, anew=False)
        while size > goal and load > 0.0:
            before, digits = size, float(np.log10(size / goal))
            limit = HOPELESS if fresh else int(OUTWORN * of.usual * digits) + SPARE
            change, took, reason = self._gmres(left, goal / size, limit)
            q += change
            left = self._left(b, q)
            size = self._by.norm(left)
            of.count(took, digits, fresh)
            done, level = size <= 2.0 * goal, self._by.level(q, around, load)
            goal = min(goal, self._by.goal(start, level, load, same))
            if size <= 2.0 * goal:
                break
            if done:
                continue
            if not fresh:
                fresh = of.serve(*served, anew=True)
            elif not size < 0.1 * before:
                if reason > 0 and size <= AT_ROUNDING * load:
                    return q, 0.0, load
                share = f"{size / load:.0e} of the load left"
                ended = f"PETSc's reason {reason}" if reason < 0 else "by rounding"
                raise ContactError(f"{took} iterations, {ended}, {share}")
        return q, 0.0 if size <= 2.0 * LEFT_BY_ROUNDING * load else size, level

    def _left(self, b: Array, q: Array) -> Array:
        """b - A q, once q has taken weak motions."""
        left = b - self._times(q)
        return left if self._of.weak is None else self._motions.take(q, left)

    @cached_property
    def _motions(self) -> WeakMotions:
        """Rigid motions that supports do not hold."""
        body, frame = self._of.weak()
        W = self._form.unknowns(body, np.where(self._reduced.told[:, None], 0.0, frame))
        return WeakMotions(self._split.comm, W, self._times, self._by.norm)

    def _gmres(self, r: Array, rtol: float, limit: int) -> tuple[Array, int, int]:
        """What solves for a residual, the iterations that it took, and PETSc's reason."""
        by, n = self._by.scaling, len(self._fixed)

        def precondition(x: Array) -> Array:
            r = x / by
            return np.concatenate(self._of.kept.apply(r[:n], r[n:])) / by

        x, took, reason = solve_right(
            self._split.K_SS.comm, lambda x: by * self._times(by * x), precondition, by * r,
            "gmres", (rtol, 0.0, 1e30, limit),
        )  # fmt: skip
        return by * x, took, reason

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        if self._of.kept is not None:
            self._of.kept.release()
        for item in (self._solver, self._test, self._form.T, self._corner):
            if item is not None:
                item.destroy()


def _factors(of: FrictionSystem, form: Transformation, test: Any, corner: Any) -> DirectSolver:
    """The factorised matrix, which uses up its corner."""
    prefix, own = of.own_options(("ksp_type", "pc_type"))
    matrix = of.split.joined((*of.split.beside(form.T, test), corner))
    matrix.setBlockSize(form.gdim)
    return DirectSolver(matrix, prefix, own | {"pc_type": "lu"}, own=True)
