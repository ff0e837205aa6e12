"""What steps with friction in the condensed form keep from one to the next."""

from __future__ import annotations

import logging
import time
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from petsc4py import PETSc

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.log import log
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.forms.condensed.elimination import EliminatedRows
from dolfinx_llm.forms.condensed.kept import KeptMultigrid
from dolfinx_llm.forms.condensed.modes import rigid_modes_of, sides_of, soft_modes_of
from dolfinx_llm.forms.condensed.splitting import SplitStiffness
from dolfinx_llm.forms.condensed.symmetric import Reduced
from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.forms.step import LinearStep
from dolfinx_llm.operators.stiffness import body_stiffness
from dolfinx_llm.operators.system import ContactOperators

BEGINS = 4  # iterations more, of a solve's first digits, with any multigrid
SET_UP = 24  # iterations that a new multigrid costs, about
NO_NEARER = 0.7  # of the residual that the last solve began with
USUAL = 2.0  # iterations per digit of a new multigrid, at least


class FrictionSystem:
    """What steps of contact laws keep from one to the next.

    Attributes:
        split, operators: bodies and interfaces.
        direct: factorise; set where GMRES has not got there.
        usual: iterations per digit of a new multigrid; ``excess``: that an old one has taken more.
        iterations: of GMRES in all steps so far; ``set_ups`` of GAMG.
        seconds: for what was set up since the last solve.
        steps: of each solve its "iterations" and the seconds of its "set-up" and "solve".
        residual: over the load, of the last solve.
    """

    def __init__(
        self,
        split: SplitStiffness,
        operators: ContactOperators,
        options: tuple[str, dict[str, Any]],
        direct: bool,
    ) -> None:
        self.split, self.operators, self.direct = split, operators, direct
        self._prefix, self._options = options
        self.notes: list[str] = []
        self.kept: Any = None  # ``KeptMultigrid``, once there is one
        self.usual = USUAL
        self.excess = 0.0
        self.iterations, self.set_ups, self.seconds = 0, 0, 0.0
        self.steps: list[dict[str, Any]] = []
        self.residual = 0.0
        self.loose: float | None = None  # of the load, that solves may leave; None: by residuals
        self.left, self.began = 0.0, np.inf  # residual of the last solve, and before it, scaled
        self.stalls = 0  # solves towards a load that have begun no nearer than the one before
        self.last: Any = None  # u, λ and w of the last solve
        self.weak: Any = None  # ``ModesAsked`` of ``weak_motions``, where supports leave some

    @cached_property
    def shares(self) -> tuple[Array, Array]:
        """(n_local,) of the bodies' dofs and (m,) of the unknowns w root of how much stiffer than
        the surfaces the body is, or the stiffest of an interface."""
        operators, dofs = self.operators, self.operators.dofs
        bodies, scale = operators.bodies, operators.scale
        of_bodies = np.sqrt(body_stiffness(dofs, operators.diagonal, bodies, scale) / scale)
        body = dofs.spread(of_bodies[operators.bodies.label])
        body[body == 0.0] = 1.0
        of_sides = dofs.values(np.array([at[0, 0] for at in operators.side_dofs]), body)
        frame = np.ones(operators.unknowns.sizes[1])
        for place in operators.places:
            frame[place.frame] = frame[place.slips] = of_sides[place.sides].max()
        return body, frame

    @cached_property
    def sides(self) -> list[Array]:
        """This rank's dofs on each side of the interfaces."""
        first, n = self.operators.dofs.first, len(self.operators.dofs.fixed)
        places = [np.unique(dofs) - first for dofs in self.operators.side_dofs]
        return [at[(at >= 0) & (at < n)] for at in places]

    def describe(self) -> str:
        """For ``print(problem)``: how steps are solved."""
        how = "LU by MUMPS"
        if not self.direct:
            how = f"GMRES + GAMG, {self.iterations} iterations, {self.set_ups} set-ups"
        return "; ".join([f"condensed, {how}", *self.notes])

    def own_options(self, without: tuple[str, ...]) -> tuple[str, dict[str, Any]]:
        """Prefix and the user's options but for some."""
        return self._prefix, {k: v for k, v in self._options.items() if k not in without}

    def reduced(self, step: LinearStep, rows: EliminatedRows, on: Array) -> tuple[Any, Any]:
        """Rows in contact, at (r,) places among all, and ``Reduced``, or None where a step is to be
        factorised. A multigrid is made anew here where that is due: before there are blocks there
        is room for it."""
        if self.direct:
            return rows, None
        try:
            with collective(self.operators.comm):  # factorised on each rank
                reduced = Reduced(step, self.operators)
        except (np.linalg.LinAlgError, RuntimeError) as error:
            self.give_up(f"the law's rows cannot be taken apart ({error})")
            return rows, None
        own = replace(rows, L=reduced.L[on])
        try:
            self.renew(own, reduced)
        except ContactInputError:
            raise
        except ContactError as error:
            self.give_up(f"GMRES + GAMG gave no answer ({error})")
            return rows, None
        return own, reduced

    def renew(self, rows: EliminatedRows, reduced: Reduced, anew: bool = False) -> None:
        """Make the multigrid anew for a step where there is none, where it is worn or bodies come
        to slide, or where it is to be."""
        began = time.perf_counter()
        worn = self.kept is None or (self.excess > SET_UP and not self.kept.knows(reduced))
        slips = not (anew or worn) and self.kept.sticks(rows, reduced)
        if anew or worn or slips:
            self._make(rows, reduced, slips)
        self.seconds += time.perf_counter() - began

    def _make(self, rows: EliminatedRows, reduced: Reduced, slips: bool) -> None:
        """A new multigrid of a step, with aggregates of its own unless what stuck ``slips`` there
        and they may be parted."""
        dofs, scale = self.operators.dofs, self.operators.scale
        before = None
        prefix, _ = options = self.own_options(("ksp_type",))
        if slips and self.kept.parts(reduced) and not PETSc.Options(prefix).hasName("pc_type"):
            before = self.kept, sides_of(self.operators)
        else:
            self.discard()
        modes = partial(soft_modes_of if reduced.slips.any() else rigid_modes_of, self.operators)
        made = KeptMultigrid(
            self.split, rows, reduced, dofs.fixed, scale, modes, options, before=before
        )
        self.discard()
        self.kept, self.excess = made, 0.0
        self.set_ups += 1

    def serve(
        self,
        form: Transformation,
        rows: EliminatedRows,
        reduced: Reduced,
        test: Any,
        corner: Any,
        anew: bool,
    ) -> bool:
        """Fit the multigrid to a step, once it is renewed; whether it knows the step as well as it
        can."""
        self.renew(rows, reduced, anew)
        began = time.perf_counter()
        if not self.kept.serves(form):
            self.kept.meet(form, rows, reduced)
            self.kept.fit(form, reduced, test, corner)
        self.seconds += time.perf_counter() - began
        return bool(self.kept.knows(reduced))

    def count(self, took: int, digits: float, fresh: bool) -> None:
        """Take down what a solve took that gained some digits, with a new multigrid or another."""
        self.iterations += took
        if fresh and digits > 1.5:
            self.usual, self.excess = max(took / digits, USUAL), 0.0
        self.excess += max(took - self.usual * digits - BEGINS, 0.0)

    def turn(self, new: bool) -> None:
        """To the law's next iterate, of a new load or not."""
        self.loose = None
        if new:
            self.left, self.began, self.stalls = 0.0, np.inf, 0

    def watch(self, size: float, main: bool) -> None:
        """See the residual that a solve begins with; ``main``: of a law's next iterate."""
        if main:
            self.stalls += size > NO_NEARER * self.began
            self.began = size

    def discard(self) -> None:
        """Give the multigrid up; collective."""
        if self.kept is not None:
            self.kept.destroy()
        self.kept = None

    def give_up(self, why: str) -> None:
        """Factorise from now on, which is said once for all ranks."""
        if self.direct:
            return
        self.discard()
        self.direct = True
        self.notes.append(f"{why}: LU by MUMPS instead")
        rank = self.operators.comm.rank
        log.log(logging.WARNING if rank == 0 else logging.DEBUG, self.notes[-1])
