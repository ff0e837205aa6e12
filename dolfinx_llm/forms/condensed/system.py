"""The condensed form of (31): the surfaces' displacements written in terms of the frame's.

With u = T q + u_0 (``elimination``) the unknowns q are the bodies' free displacements and those of
the frame, and Tᵀ K T q = Tᵀ (f - K u_0) is symmetric positive definite. The multipliers are the
reactions f - K u of what was eliminated.
"""

from __future__ import annotations

import logging
import time
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.forms.condensed.coarse import CoarseMotions
from dolfinx_llm.forms.condensed.elimination import EliminatedRows
from dolfinx_llm.forms.condensed.krylov import DIRECT, RTOL, WIDEST, near_null_space, solver_of
from dolfinx_llm.forms.condensed.splitting import SplitStiffness
from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.forms.verdict import EPS, beyond, judge, largest
from dolfinx_llm.operators.petsc import times

log = logging.getLogger("dolfinx_llm")

PASSES = 4  # solves for what the residual of the unreduced system still holds
WORN = 1.5  # times the iterations of a new preconditioner, from which on one is renewed
DIGITS = 13.0  # by which a solve makes the residual smaller, about
COST = 3.0  # iterations, about, for a row that the preconditioner knows otherwise
ROUNDING = 4.0 * EPS  # of a residual of the scaled system, per size of its unknowns


class CondensedSystem:
    """Tᵀ K T with a preconditioner or a factorisation, set up once for any number of loads.

    After a solve ``iterations``, ``residual`` (of (31), over the size of its unknowns), ``left``
    (this rank's K u + B λ - f), ``tolerance`` (what the user's options allow of it [force]) and
    ``notes`` tell how it went; ``set_ups`` counts preconditioners and factorisations, ``steps`` has
    of each solve its "iterations" and the seconds of its "set-up" and "solve".

    Args:
        split: stiffness of the bodies, identity rows and columns at prescribed dofs, parted at the
            nodes of all rows that will be eliminated. It is destroyed with the system; what is not
            needed for solving may be released before.
        rows: what is eliminated to the frames.
        fixed: (n_local,) whether a dof of this rank is prescribed; f holds its value.
        scale: mean diagonal of K on the surface dofs [force / length].
        prefix: of the PETSc options.
        options: PETSc options on top of ``ITERATIVE`` and ``GAMG``, or of ``DIRECT`` with
            {"ksp_type": "preonly", "pc_type": "cholesky"}.
        modes: near-null space for GAMG, rigid modes at the bodies' dofs (n_local, k) and at the
            frames' unknowns (m, k); None: none.
        weak: motions that supports or springs may hold weakly, in the same way; None: ``modes``.
        proximal: (m,) non-negative stiffness d of the frames' unknowns, which adds
            1/2 sum_J d_J (v_J - c_J)² to the energy [force / length]; None: none.

    Raises:
        ContactError: the reduced matrix is not positive definite.
    """

    def __init__(
        self,
        split: SplitStiffness,
        rows: EliminatedRows,
        fixed: np.ndarray,
        scale: float,
        prefix: str = "llm_",
        options: dict | None = None,
        *,
        modes: tuple[np.ndarray, np.ndarray] | None = None,
        weak: tuple[np.ndarray, np.ndarray] | None = None,
        proximal: np.ndarray | None = None,
    ) -> None:
        self.split, self.fixed, self.scale, self.comm = split, fixed, scale, split.comm
        self.notes: list[str] = []
        self.steps: list[dict] = []
        self.iterations, self.residual, self.set_ups, self.tolerance = 0, np.nan, 0, 0.0
        self._modes, self._prefix, self._weak = modes, prefix, weak or modes
        options = dict(options or {})
        if rows.widest > WIDEST and options.get("pc_type", "gamg") == "gamg":
            self.notes.append(
                f"a frame node couples with some {rows.widest:.0f} nodes of a side that is much "
                "finer than the frame, too many for GAMG: Cholesky by MUMPS instead"
            )
            self._warn()
            options = DIRECT
        self._options = options
        self.ksp: Any = None  # once ``set_up``
        self._kept = False  # whether the preconditioner is another matrix's
        self._serves = False  # whether it may be kept for the next
        self._outdated = 0  # rows that it knows otherwise
        self._usual = 0.0  # iterations per digit of a new one
        self._last: Any = None  # u and v
        self._reduce(rows, proximal)

    def eliminate(
        self, rows: EliminatedRows, proximal: np.ndarray | None = None, changed: int = 0
    ) -> None:
        """Eliminate other rows, or with another proximal term; springs of ``split`` are taken over.

        A preconditioner stays as long as it serves.

        Args:
            changed: rows that are eliminated now and were not, or were and are not.
        """
        before = self.matrix.getLocalSize()
        for item in (self.form.T, self.matrix, self.S):
            item.destroy()
        self._reduce(rows, proximal)
        same = self.comm.allreduce(self.matrix.getLocalSize() == before, op=MPI.LAND)
        self._outdated += changed
        spare = (WORN - 1.0) * self._usual * DIGITS  # iterations
        if same and self._serves and COST * self._outdated <= spare:
            self.ksp.setOperators(self.matrix)
            self.ksp.getPC().setReusePreconditioner(True)
            self._kept = True
        else:
            self._discard()

    def _reduce(self, rows: EliminatedRows, proximal: np.ndarray | None) -> None:
        """Tᵀ K T with the proximal term, scaled to unit diagonal: S Tᵀ K T S, S the inverse square
        root of the diagonal."""
        self.form = Transformation(self.split, rows, self.fixed, proximal)
        self.matrix = self.form.reduce(self.form.penalty(), self.scale)
        diagonal = self.matrix.getDiagonal()
        least = self.comm.allreduce(diagonal.array_r.min(initial=np.inf), op=MPI.MIN)
        if not least > 0.0:
            raise ContactError(
                f"the condensed matrix has the diagonal entry {least:.3g}: it is not positive "
                "definite. Check the material data of the forms a"
            )
        diagonal.sqrtabs()
        diagonal.reciprocal()
        self.S = diagonal
        self.matrix.diagonalScale(diagonal, diagonal)
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.matrix.setOption(PETSc.Mat.Option.SPD, True)
        self._coarse = CoarseMotions(self.form, self.matrix, diagonal, self._weak)

    def _warn(self) -> None:
        log.log(logging.WARNING if self.comm.rank == 0 else logging.DEBUG, self.notes[-1])

    def set_up(self) -> None:
        """Preconditioner or factorisation, if it is not there yet."""
        if self.ksp is None:
            if self._modes is not None:
                near_null_space(self.matrix, self.S, self.form.unknowns(*self._modes))
            self._set_up(self._options)

    def _set_up(self, given: dict) -> Any:
        self.ksp, self.method, self.own = solver_of(self.matrix, self._prefix, given)
        self.set_ups += 1

    def _discard(self) -> None:
        """Give up the solver."""
        if self.ksp is not None:
            self.ksp.destroy()
        self.ksp, self._kept, self._serves, self._outdated = None, False, False, 0

    def solve(
        self, f: np.ndarray, g: np.ndarray, centre: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """This rank's parts of u, λ, v for loads f and gaps g.

        Args:
            f: (n_local,) loads, prescribed values at fixed dofs.
            g: (R,) gaps of this rank's multipliers [length].
            centre: (m,) c of the proximal term, on every rank; None: zero.

        Raises:
            ContactError: the solver did not reach a small residual of (31).
        """
        began = time.perf_counter()
        self.set_up()
        ready, form = time.perf_counter(), self.form
        u_0, v_0 = form.offsets(f, g)
        u, q, force = self._iterate(f, u_0, form.push(centre, v_0), self._guess(u_0, v_0))
        v = form.frame_motion(q, v_0)
        self._last = u, v
        multiplier = form.multipliers(np.where(self.fixed, 0.0, force), v, centre)
        self._check(f, g, u, multiplier, v, force, centre)
        seconds = {"set-up": ready - began, "solve": time.perf_counter() - ready}
        self.steps.append({"iterations": self.iterations, **seconds})
        return u, multiplier, v[form.tail.mine_v]

    def _guess(self, u_0: np.ndarray, v_0: np.ndarray) -> np.ndarray:
        """q of the last solution; zero for a factorisation, which needs no start."""
        if self._last is None or self.ksp.getType() == "preonly":
            return np.zeros(self.matrix.getLocalSize()[0])
        u, v = self._last
        return self.form.unknowns((u - u_0)[:, None], (v - v_0)[:, None])[:, 0]

    def _iterate(self, f: np.ndarray, u_0: np.ndarray, push: Any, q: np.ndarray) -> Any:
        """u, q and f - K u of this rank; solved for the residual of the unreduced system again
        while that gains."""
        x, b = self.matrix.createVecs()
        load = self.form.load(f, u_0) + push
        b.array_w[:] = load * self.S.array_r
        tolerances = rtol, _, _, patience = self.ksp.getTolerances()
        goal, direct = max(rtol, EPS) * b.norm(), self.ksp.getType() == "preonly"
        q = q * self._best_share(q, load)
        x.array_w[:] = q / self.S.array_r
        self.iterations, last, length = 0, np.inf, x.norm()
        for attempt in range(PASSES + 1):
            left = self._coarse.left(load, q)
            b.array_w[:] = left * self.S.array_r
            size = b.norm()
            # A factorisation refines while that gains.
            enough = 0.0 if direct else max(2.0 * goal, ROUNDING * length)
            ended = attempt and (attempt == PASSES or self.ksp.getConvergedReason() < 0)
            if ended or not size > enough or not size < 0.5 * last:
                break
            last = size
            if not direct:
                digits = np.log10(size / goal)
                limit = WORN * self._usual * digits if self._kept else patience
                self.ksp.setTolerances(rtol=goal / size, max_it=min(patience, int(limit) + 1))
            self._solve_once(b, x)
            reason = self.ksp.getConvergedReason()
            worn = self._kept and reason < 0
            if not worn or reason == PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT:
                length += x.norm()
                q += x.array_r * self.S.array_r
            if worn:
                self._discard()
                self.set_up()
                last = np.inf
            elif not self._kept and self.ksp.getType() != "preonly" and digits > 1.0:
                self._usual, self._serves = self.ksp.getIterationNumber() / digits, True
        self.ksp.setTolerances(*tolerances)
        least = self.comm.allreduce(self.S.array_r.min(initial=np.inf), op=MPI.MIN)
        self._promised = enough / least  # residual, at most [force]
        # A tolerance that the user made larger is the user's choice.
        self.tolerance = self._promised if rtol > RTOL and not direct else 0.0
        x.destroy()
        b.destroy()
        u = self.form.motion(q) + u_0
        return u, q, self._forces(f, u, left)

    def _best_share(self, q: np.ndarray, load: np.ndarray) -> float:
        """The part of q next to the solution: loads may have grown in proportion."""
        product = times(self.matrix, q / self.S.array_r) / self.S.array_r
        work, energy = self.comm.allreduce(np.array([q @ load, q @ product]))
        return work / energy if energy > 0.0 else 0.0

    def _forces(self, f: np.ndarray, u: np.ndarray, left: np.ndarray) -> np.ndarray:
        """f - K u of this rank: reactions at surface nodes, elsewhere what the system leaves."""
        force, S = left[: len(f)].copy(), self.split.surface
        force[S] = f[S] - self.split.rows(u)
        force[self.fixed] = 0.0
        return force

    def _solve_once(self, b: np.ndarray, x: Any) -> None:
        """One solve; where the default options do not get there, a factorisation takes over."""
        self.ksp.solve(b, x)
        self.iterations += self.ksp.getIterationNumber()
        if self.ksp.getConvergedReason() < 0 and self.own and not self._kept:
            self.notes.append(
                f"CG + GAMG ended without an answer after {self.ksp.getIterationNumber()} "
                f"iterations (PETSc's reason {self.ksp.getConvergedReason()}): Cholesky by MUMPS "
                "instead"
            )
            self._warn()
            self.ksp.destroy()
            self._options = DIRECT  # from now on
            self._set_up(DIRECT)
            self.own = False
            self.ksp.solve(b, x)

    def _check(
        self,
        f: np.ndarray,
        g: np.ndarray,
        u: np.ndarray,
        multiplier: np.ndarray,
        v: np.ndarray,
        force: np.ndarray,
        centre: np.ndarray | None,
    ) -> None:
        """Require a small residual of (31)."""
        sizes = self.form.sizes((f, g), (u, multiplier, v), force, centre, self.scale)
        self.residual = sizes[:3].max() / max(sizes[3:].max(), 1e-300)
        free = ~self.fixed
        self.left, _ = self.form.residual(u, multiplier, v, g, force)
        terms, load = largest(self.comm, free * self.split.diagonal * u, free * f)
        reason = self.ksp.getConvergedReason()
        how = f"{self.iterations} iterations of {self.method}, PETSc's reason {reason}"
        left = max(sizes[0], beyond(sizes[1], sizes[3:5].max()), sizes[2])
        judge(left, terms, max(load, sizes[5]), how, self._promised)

    def destroy(self) -> None:
        self._discard()
        for item in (self.matrix, self.S, self.form.T, self.split):
            item.destroy()
