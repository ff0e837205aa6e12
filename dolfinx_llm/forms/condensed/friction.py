"""Steps with friction in the condensed form: GMRES, or a factorisation where that does not serve.

    T_lᵀ (f - K T q) + D w + E λ_W = rhs, where T_l has E in the place of L_bᵀ.

λ_W are the forces of rows that bind the frame alone. Without symmetry no combination of the
frame's equations is free of them: they are unknowns, in the places of what they determine. As
the step has it they give way to changes, since friction may say the same (a node held on both
sides that sticks).
"""

from __future__ import annotations

import time
from functools import cached_property
from typing import Any

import numpy as np
from mpi4py import MPI

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.parallel import gather_rows
from dolfinx_llm.forms.condensed.elimination import EliminatedRows
from dolfinx_llm.forms.condensed.friction_system import FrictionSystem
from dolfinx_llm.forms.condensed.gmres import solve_right
from dolfinx_llm.forms.condensed.measure import LEFT_BY_ROUNDING, Measure
from dolfinx_llm.forms.condensed.reduced import WeakMotions, product
from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.forms.direct import DirectSolver
from dolfinx_llm.forms.step import LinearStep

ASTRAY = 1e3  # times the load: residuals of the last solution from which on it is no start
AT_ROUNDING = 1e-10  # of the load: where GMRES has got there, rounding alone leaves no more
SOLVED = 1e-12  # of the load: what is solved as far may be the end of an iteration
HOPELESS = 150  # iterations with a multigrid of the same step, then a factorisation takes over
OUTWORN = 2.0  # times the iterations per digit of a new multigrid, from which on it is made anew
REFINES = 2  # solves with a factorisation for what is left by the bodies' own stiffness
SPARE = 8  # iterations more that an old one may take


class FrictionStep:
    """One step's matrix.

    Args:
        of: what is kept.
        eliminated: rows in contact.
        on: (r,) their places among all.
        step: the step.
    """

    def __init__(
        self, of: FrictionSystem, eliminated: EliminatedRows, on: Array, step: LinearStep
    ) -> None:
        self._of, self._split, self._step, self._on = of, of.split, step, on
        self._fixed, self._scale = of.operators.dofs.fixed, of.operators.scale
        self._solver: DirectSolver | None = None
        self._rows, self._reduced = of.reduced(step, eliminated, on)
        self._assemble()
        if self._reduced is None:
            self._factorise()
        else:
            self._by = Measure(of, self._form, self._corner)

    def _assemble(self) -> None:
        """What the matrix is made of, of the step as it is or reduced."""
        law = self._step if self._reduced is None else self._reduced
        soft = self._scale * self._step.compliance[self._on]
        self._gives = self._step.compliance[self._on][self._rows.multipliers.mine]
        self._form = Transformation(
            self._split, self._rows, self._fixed, np.ones(self._step.L.shape[1]), soft, whole=True
        )
        self._E, self._D = law.E[:, self._on], law.D
        seen = self._E.T.tocsr()[self._rows.multipliers.mine]
        self._test = self._form.columns_of(self._form.A @ seen)
        laws = self._form.frame_law(self._E, self._D, self._scale)
        self._corner: Any = self._form.corner(-laws, self._scale, self._test)

    def _factorise(self) -> None:
        self._solver = _factors(self._of, self._form, self._test, self._corner)
        self._corner = None

    def ask(
        self, f: Array, g: Array, rhs: Array, about: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """See ``SetUp``."""
        form, split, numbering = self._form, self._split, self._rows.multipliers
        main = about is not None
        kept = np.zeros(len(self._on)) if about is None else form.bound(about[self._on])
        own = None if about is None else (about[self._on] - kept)[numbering.mine]
        w_0, C = 0.0, None
        if self._reduced is not None:
            (g, rhs, w_0), C = self._reduced.loads(g, rhs), self._reduced.C
        kept = kept + form.contradicting(g[self._on], self._scale)
        loads = f, g[self._on][numbering.mine], rhs - self._E @ kept
        u_b, z_b = np.zeros(len(f)), np.zeros(len(rhs))
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
                gaps = loads[1] - self._gives * (_of_bodies(form, f, u_b) - own)
                b, u_0, v_0 = self._loads_about(u_b, z_b, f, gaps, loads[2])
                forces = form.forces_alone(q)
                q = forces + self._solver.once(self._solver.left(b, forces))
        u = u_b + (form.motion(q) + u_0)
        found = _of_bodies(form, f, u) + form.frame_multipliers(q, self._scale)
        multiplier = np.zeros(len(g))
        multiplier[self._on] = gather_rows(split.comm, found)[numbering.number] + kept
        w = z_b + form.frame_motion(q, v_0)
        w = w if C is None else C @ w + w_0
        if main:
            self._of.last = u, multiplier, w
        return u, multiplier, w

    def _loads_about(
        self, u: Array, z: Array, f: Array, g: Array, rhs: Array
    ) -> tuple[Array, Array, Array]:
        """b of A q = b for what is added to u and z, and the offsets u_0 and v_0: about the last
        solution sums of large motions, as those of both sides of a slip, cost no digits."""
        form, split, fixed = self._form, self._split, self._fixed
        if self._split.comm.allreduce(bool(u.any() or z.any()), op=MPI.LOR):
            of_rows = form.vectors * np.where(fixed[form.dofs], 0.0, u[form.dofs])
            g = g - form.L @ z + of_rows.sum(axis=1)
            f = np.where(fixed, f - u, f - split.times(u))
        u_0, v_0 = form.offsets(f, g)
        b = form.load(f, u_0, self._test)
        b[len(f) + form.tail.seats] -= (rhs - self._D @ (z + v_0))[form.tail.mine_used]
        return b, u_0, v_0

    def _times(self, q: Array) -> Array:
        return product(self._form, self._corner, q, self._test)

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


def _of_bodies(form: Transformation, f: Array, u: Array) -> Array:
    """(R,) forces of this rank's rows on free dofs, by f - K u."""
    S = form.split.surface
    left = np.where(form.fixed[S], 0.0, f[S] - form.split.rows(u))
    return np.asarray(form.A.T @ left)


def _factors(of: FrictionSystem, form: Transformation, test: Any, corner: Any) -> DirectSolver:
    """The factorised matrix, which uses up its corner."""
    prefix, own = of.own_options(("ksp_type", "pc_type"))
    matrix = of.split.joined((*of.split.beside(form.T, test), corner))
    matrix.setBlockSize(form.gdim)
    return DirectSolver(matrix, prefix, own | {"pc_type": "lu"}, own=True)
