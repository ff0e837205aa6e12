"""The condensed form of (31): the surfaces' displacements written in terms of the frame's.

With u = T q + u_0 (``elimination``) the unknowns q are the bodies' free displacements and those of
the frame, and Tᵀ K T q = Tᵀ (f - K u_0) is symmetric positive definite. The multipliers are the
reactions f - K u of what was eliminated.
"""

import time
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.forms.condensed.elimination import EliminatedRows, widest
from dolfinx_llm.forms.condensed.krylov import RTOL, WIDEST, KeptSolver, near_null_space
from dolfinx_llm.forms.condensed.modes import ModesAsked
from dolfinx_llm.forms.condensed.reduced import ReducedMatrix
from dolfinx_llm.forms.condensed.splitting import SplitStiffness
from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.forms.verdict import EPS, judge, largest

PASSES = 4  # solves for what the residual of the unreduced system still holds
ROUNDING = 4.0 * EPS  # of a residual of the scaled system, per size of its unknowns


class CondensedSystem:
    """Tᵀ K T with a preconditioner or a factorisation, set up once for any number of loads.

    After a solve ``iterations``, ``tolerance`` (what the user's
    options allow of K u + B λ - f [force]) and ``notes`` tell how it went; ``steps`` has of
    each solve its "iterations" and the seconds of its "set-up" and "solve".

    Args:
        split: stiffness of the bodies, parted at the nodes of all rows that will be eliminated. It
            is destroyed with the system.
        rows: what is eliminated to the frames.
        fixed: (n_local,) whether a dof of this rank is prescribed; f holds its value.
        scale: mean diagonal of K on the surface dofs [force / length].
        prefix, options: of PETSc, on top of ``ITERATIVE`` and ``GAMG``, or of ``DIRECT``.
        modes: gives the near-null space for GAMG, rigid modes at the bodies' dofs (n_local, k) and
            at the frames' unknowns (m, k); None: none.
        weak: motions that supports or springs may hold weakly, in the same way; None: ``modes``.
        firm: supports and ties hold all motions firmly.
        proximal: (m,) non-negative stiffness d of the frames' unknowns, which adds
            1/2 sum_J d_J v_J² to the energy [force / length]; None: none.
    """

    def __init__(
        self,
        split: SplitStiffness,
        rows: EliminatedRows,
        fixed: Array,
        scale: float,
        prefix: str = "llm_",
        options: dict[str, Any] | None = None,
        *,
        modes: ModesAsked | None = None,
        weak: ModesAsked | None = None,
        firm: bool = False,
        proximal: Array | None = None,
    ) -> None:
        self.split, self.fixed, self.scale, self.comm = split, fixed, scale, split.comm
        self.notes: list[str] = []
        self.steps: list[dict[str, Any]] = []
        self.iterations, self.tolerance = 0, 0.0
        self.loose = 0.0  # of the load, that solves may leave for now
        self._modes, self._weak, self._firm = modes, weak or modes, firm
        options = dict(options or {})
        self.solver = KeptSolver(self.comm, prefix, options, self.notes)
        nodes = widest(rows.L, rows.gdim)
        if nodes > WIDEST and options.get("pc_type", "gamg") == "gamg":
            self.solver.factorise(
                f"a frame node couples with some {nodes:.0f} nodes of a side that is much "
                "finer than the frame, too many for GAMG"
            )
        self._last: Any = None  # u and v
        self._take(Transformation(self.split, rows, fixed, proximal))

    def eliminate(
        self, rows: EliminatedRows, proximal: Array | None = None, changed: int = 0
    ) -> None:
        """Eliminate other rows, of which ``changed`` were not or are not any more, or with another
        proximal term; springs of ``split`` are taken over. A preconditioner stays as long as it
        serves."""
        form, before = Transformation(self.split, rows, self.fixed, proximal), self.reduced
        same = form.tail.sizes == self.form.tail.sizes
        if self.solver.keeps(self.comm.allreduce(same, op=MPI.LAND), changed):
            self._take(form, before)
            before.destroy()
            self.solver.keep(self.reduced)
        else:
            before.destroy()
            self._take(form)

    def _take(self, form: Transformation, beside: ReducedMatrix | None = None) -> None:
        """Take over what other eliminated rows leave, with its matrix ``beside`` another's."""
        self.form = form
        self.reduced = ReducedMatrix(form, self.scale, self._weak, self._firm, beside)
        self.matrix, self.S = self.reduced.matrix, self.reduced.S

    @property
    def set_ups(self) -> int:
        """How often preconditioner or factorisation were made."""
        return self.solver.set_ups

    @property
    def direct(self) -> bool:
        """Whether it is known to factorise."""
        return self.solver.ksp is not None and self.solver.direct

    def set_up(self) -> None:
        """Preconditioner or factorisation, if it is not there yet."""
        if self.solver.ksp is None:
            self.reduced.store()
            self.matrix, self.S = self.reduced.matrix, self.reduced.S
            if self._modes is not None and self.solver.uses_modes:
                near_null_space(self.matrix, self.S, self.form.unknowns(*self._modes()))
            self.solver.set_up(self.reduced)
            self.matrix.setNearNullSpace(PETSc.NullSpace())  # it has served

    def solve(self, f: Array, g: Array, pull: Array | None = None) -> tuple[Array, Array, Array]:
        """This rank's parts of u, λ, v for loads f (n_local,), prescribed values at fixed dofs, and
        gaps g (R,); p (m,) are forces on the frames' unknowns, None: zero.

        Raises:
            ContactError: the solver did not reach a small residual of (31).
        """
        began = time.perf_counter()
        self.set_up()
        ready, form = time.perf_counter(), self.form
        u_0, v_0 = form.offsets(f, g)
        u, q = self._iterate(f, u_0, form.push(pull, v_0), self._guess(u_0, v_0))
        v = form.frame_motion(q, v_0)
        self._last = u, v
        multiplier = form.multipliers(self._forces(f, u)[self.split.surface], v, pull)
        if self.solver.reason < 0:
            self._require_answer(f, u, multiplier)
        seconds = {"set-up": ready - began, "solve": time.perf_counter() - ready}
        self.steps.append({"iterations": self.iterations, **seconds})
        return u, multiplier, v[form.tail.mine_v]

    def _guess(self, u_0: Array, v_0: Array) -> Array | None:
        """q of the last solution; None: there is none, or a factorisation, which needs no start."""
        if self._last is None or self.solver.direct:
            return None
        u, v = self._last
        return self.form.unknowns((u - u_0)[:, None], (v - v_0)[:, None])[:, 0]

    def _iterate(self, f: Array, u_0: Array, push: Any, start: Array | None) -> Any:
        """u and q of this rank; solved for the residual of the unreduced system again while that
        gains."""
        x, b = self.matrix.createVecs()
        load = self.form.load(f, u_0) + push
        b.array_w[:] = load * self.S.array_r
        rtol, direct = self.solver.rtol, self.solver.direct
        share = max(rtol, EPS, self.loose)
        goal = share * b.norm()
        q = np.zeros(len(load))
        if start is not None:
            q = start * self.reduced.best_share(start, load)
        self.iterations, last = 0, np.inf
        for attempt in range(PASSES + 1):
            left = load - self.reduced.times(q) if attempt or start is not None else load.copy()
            # A better start saves an iteration or two; where all is firm a factorisation has none.
            if not (self._firm and (attempt or direct)):
                left = self.reduced.take(load, q, left)
            b.array_w[:] = left * self.S.array_r
            x.array_w[:] = q / self.S.array_r
            size, length = b.norm(), x.norm()
            if attempt == 1 and not direct:  # gaps may make loads that are far larger than forces
                self._left = left
                goal = min(goal, share * self._strength(f, self.form.motion(q) + u_0))
            if not (attempt or size > 2.0 * goal or direct or share > RTOL):
                # Asked again: loads of what is prescribed may be far larger than forces in contact.
                goal *= EPS / share
            # A factorisation refines while that gains.
            enough = 0.0 if direct else max(2.0 * goal, ROUNDING * length)
            ended = attempt and (attempt == PASSES or self.solver.reason < 0)
            if ended or not size > enough or not size < 0.5 * last:
                break
            last = size
            least = max(goal, 0.5 * ROUNDING * length)
            useful, worn = self.solver.solve(b, x, max(least / size, RTOL))
            self.iterations += self.solver.took
            if useful:
                q += x.array_r * self.S.array_r
            if worn:
                self.set_up()
                last = np.inf
        if rtol > RTOL and not direct:  # a tolerance that the user made larger is the user's choice
            least = self.comm.allreduce(self.S.array_r.min(initial=np.inf), op=MPI.MIN)
            self.tolerance = enough / least
        x.destroy()
        b.destroy()
        self._left = left  # by the reduced system [force]
        return self.form.motion(q) + u_0, q

    def _forces(self, f: Array, u: Array) -> Array:
        """f - K u of this rank: reactions at surface nodes, elsewhere what the system leaves."""
        force, S = self._left[: len(f)].copy(), self.split.surface
        force[S] = f[S] - self.split.rows(u)
        force[self.fixed] = 0.0
        return force

    def _strength(self, f: Array, u: Array) -> float:
        """Norm of loads and reactions, as the scaled system has it."""
        forces = np.maximum(np.abs(np.where(self.fixed, 0.0, f)), np.abs(self._forces(f, u)))
        scaled = forces * self.S.array_r[: len(f)]
        return float(np.sqrt(self.comm.allreduce(scaled @ scaled)))

    def _require_answer(self, f: Array, u: Array, multiplier: Array) -> None:
        """Require a small residual where the solver ended without an answer."""
        free = ~self.fixed
        parts = free * self.split.diagonal * u, free * f, multiplier, self._left
        terms, load, forces, left = largest(self.comm, *parts)
        solver = self.solver
        how = f"{self.iterations} iterations of {solver.method}, PETSc's reason {solver.reason}"
        judge(left, terms, max(load, forces), how)

    def destroy(self) -> None:
        self.split.destroy()  # first: K's inside need not be taken back
        self.solver.discard()
        self.reduced.destroy()
