"""Load steps in increments, which are halved where Newton's iteration fails."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.log import progress, tell_iteration, warn
from dolfinx_llm.base.parallel import chosen, collective
from dolfinx_llm.finite import doubts
from dolfinx_llm.finite.arrival import check_way
from dolfinx_llm.finite.failures import (
    Going,
    NothingHolds,
    StepFailed,
    check_flown,
    unbalanced,
    where,
)
from dolfinx_llm.finite.frame_slip import Slid
from dolfinx_llm.finite.increment import Increment
from dolfinx_llm.finite.load_step import Bodies, Equations, LoadStep, NewtonState, touching_of
from dolfinx_llm.finite.pairs.terms import ContactTerms
from dolfinx_llm.finite.tries import Arrived, rubbing, slid_away
from dolfinx_llm.finite.turning import check_poses
from dolfinx_llm.finite.unloading import NEARLY_ALL, freed, held_by_springs, let_go
from dolfinx_llm.laws.rows import SLIP, STICK

log = logging.getLogger("dolfinx_llm")

NEWTON_ITERATIONS = 25
HALVINGS = 8  # of an increment
DRIVEN = 1e-6  # of what supports push with, that loads may change by where these alone move bodies


class NewtonSteps:
    """Load steps of bodies in contact.

    Args:
        equations: what is solved.

    Attributes:
        history: of the last step, a dict per iteration.
        terms: of the interfaces there.
        slips: (n, gdim) of each one's pairs and (m, gdim) of its frame's nodes, in all of the last
            load step [length].
        told: of what is doubtful there, warnings.
    """

    def __init__(self, equations: Equations) -> None:
        self.equations = equations
        self.history: list[dict[str, Any]] = []
        self.terms: list[ContactTerms] = []
        self.slips: list[tuple[Array, Array]] = []
        self.told: list[str] = []
        self._reached: NewtonState

    def step(
        self, step: LoadStep, increments: int, begins: Callable[[float], None]
    ) -> Iterator[NewtonState]:
        """The states at the ends of a load step's parts, found as they are asked for.

        Args:
            step: what is to be done.
            increments: equal parts to begin with.
            begins: told which part of the step is tried, before each.

        Raises:
            ContactError: Newton's iteration fails however small the increments are.
        """
        self.history, self._reached, self._leapt = [], step.start, (0.0, 0.0)
        self._left = [np.zeros(1, dtype=bool)] * len(self.equations.interfaces)
        self._slid = [Slid(placed.what) for placed in self.equations.interfaces]
        done, part, smallest = 0.0, 1.0 / increments, 2.0**-HALVINGS / increments
        self._freed = freed(self.equations, step)
        stop = 1.0 if self._freed is None else NEARLY_ALL
        unheld = False  # nothing held a body in the last increment tried
        fallen: NothingHolds | None = None  # or in one before, from this state: what is told
        with progress(None, "load step") as bar:
            while done < 1.0 - 1e-12:
                stop = stop if done < stop else 1.0
                end = stop if done + part > stop - 1e-12 else done + part
                begins(end - done)
                try:
                    self._reached = self._next(step, end, bar)
                except StepFailed as failed:
                    _check_start(self.equations.bodies, self._reached.u, failed)
                    part = 0.5 * min(part, end - done)
                    hopeless = unheld and isinstance(failed, NothingHolds)
                    if unheld := isinstance(failed, NothingHolds):
                        fallen = failed
                    log.info("increment to %.4g failed: %s; halved", end, failed)
                    if part < smallest or hopeless:
                        raise ContactError(
                            f"Newton's iteration fails at {done:.4g} of the load step, also with "
                            f"increments of {2.0 * part:.2g} of it: {fallen or failed}. The state "
                            f"at {done:.4g} is kept, of bodies with a memory that of the start. "
                            "Take smaller load steps, or check supports, loads and the mesh; where "
                            "bodies snap through or tip over no state is near: prescribe motions "
                            "there, or take steps in time"
                        ) from None
                else:
                    done, part, unheld, fallen = end, min(2.0 * part, 1.0 / increments), False, None
                    yield self._reached
        self._say()

    def unbalanced(self, start: NewtonState) -> Array:
        """(n_local,) residual of a state under the loads as they are now, but for follower loads;
        collective."""
        bodies = self.equations.bodies
        return np.where(bodies.dofs.fixed, 0.0, bodies.residual(start.u) - start.pushed)

    def _next(self, step: LoadStep, end: float, bar: Any) -> NewtonState:
        """The state at the end of an increment; where it may be one of several of bodies that
        friction alone holds, the nearer one that damped iterations come to."""
        try:
            found = self._increment(step, end, bar)
        except StepFailed as failed:
            if not rubbing(self.equations):
                raise
            log.info("increment to %.4g failed: %s; damped", end, failed)
            try:
                found = self._increment(step, end, bar, damped=True)
            except StepFailed:
                raise failed from None
        else:
            if doubt := slid_away(self.equations, found):
                log.info("increment to %.4g: %s; damped", end, doubt)
                with suppress(StepFailed):
                    again = self._increment(step, end, bar, damped=True)
                    found = min(found, again, key=lambda arrived: arrived.far)
        return self._arrive(found)

    def _increment(self, step: LoadStep, end: float, bar: Any, damped: bool = False) -> Arrived:
        """Newton's iteration from the last state to the part ``end`` of a load step."""
        start = self._reached
        K = self.equations.measure(start.u)
        try:
            if not np.isfinite(self.equations.scale):
                raise StepFailed("the derivative of F has entries that are NaN or infinite")
            run, rests = self._begun(step, end, damped)
            if run.turned:
                K.destroy()
            before, going = [t.place for t in run.terms], Going()
            for iteration in range(1, NEWTON_ITERATIONS + 1):
                if not rests:
                    run.iterate(None if run.turned or iteration > 1 else K, going.part)
                entry = _entry(run, iteration)
                self.history.append(entry)
                tell_iteration(entry, bar)
                if run.converged(going.noise, going.lingers(run.rest)):
                    left = check_way(self.equations, run, before, start)
                    gone = self._gone(run, step, start)
                    return Arrived(run, before, start.status, rests, left, *gone)
                if going.stopped(run.far / self.equations.bodies.size, run.changes, run.error):
                    raise unbalanced(self.equations, run.error, _left(run))
        finally:
            K.destroy()  # where no iteration has
        turns = f"{run.changes} pairs open or close by turns, " if run.changes else ""
        raise StepFailed(
            f"no convergence in {NEWTON_ITERATIONS} iterations, {turns}residual {run.error:.1e}, "
            f"the largest {where(self.equations, _left(run))}"
        )

    def _begun(self, step: LoadStep, end: float, damped: bool) -> tuple[Increment, bool]:
        """An increment before its first iteration, and whether it needs none: bodies are apart, and
        nothing is asked of them."""
        start = self._reached
        unknown = any(status is None for status in start.status)
        steps = replace(self.equations, damped=damped)
        if end == 1.0 and let_go(self._freed, step.start, start, steps.bodies.dofs.comm):
            steps = held_by_springs(steps, self._freed)
        run = Increment(steps, start, step, end, not unknown)
        rests = unknown and run.converged()
        if run.undrawn and not rests:
            run = Increment(steps, start, step, end)
        check_poses(self.equations, run, start)
        return run, rests

    def _arrive(self, found: Arrived) -> NewtonState:
        """Take what an increment has come to."""
        run = found.run
        self._left = [a | b for a, b in zip(self._left, found.left, strict=True)]
        far, driven = found.far, found.driven
        if found.alone and driven > 0.0 and far * self._leapt[1] >= self._leapt[0] * driven:
            self._leapt = far, driven
        self.terms = run.terms
        of = zip(self._slid, found.before, run.terms, run.held, found.status, strict=True)
        self.slips = [slid.on(*then) for slid, *then in of]
        state = _state(run)
        return replace(state, status=found.status) if found.rests else state

    def _gone(
        self, run: Increment, step: LoadStep, start: NewtonState
    ) -> tuple[float, float, bool]:
        """How far bodies have gone in an increment, how far supports and obstacles have, but for
        turns, and whether these alone moved bodies, without turns and forces. Collective.

        Raises:
            StepFailed: bodies that nothing holds have flown away.
        """
        equations, comm = self.equations, self.equations.bodies.dofs.comm
        moved, pushed = np.abs(run.u - start.u), np.abs(step.unbalanced)
        mine = [float(a.max(initial=0.0)) for a in (moved[run.fixed], moved, pushed)]
        supports, far, load = np.max(comm.allgather(mine), axis=0).tolist()
        of, gdim = zip(run.poses, start.poses, strict=True), equations.bodies.dofs.gdim
        changes = [np.abs(now - before) for now, before in of]
        shifts = [float(change[gdim : 2 * gdim].max(initial=0.0)) for change in changes]
        driven, others = max([supports, *shifts]), any(c[2 * gdim :].any() for c in changes)
        check_flown(equations, far, driven)
        forced = equations.followers or load > DRIVEN * equations.scale * driven
        return far, np.inf if others else driven, not (forced or others)

    def _say(self) -> None:
        """Warn of what is doubtful in a load step, where that was not told of the last one."""
        told, before = doubts.leapt(*self._leapt), self.told
        of = zip(self.equations.interfaces, self._left, self.terms, strict=True)
        for placed, left, t in of:
            told += doubts.left_over(placed.what.sides, left, t.place)
            told += doubts.missed(placed.what, t, self.equations.size)
            for doubt in doubts.OF_PAIRS:
                told += doubt(placed.what, t)
            if not self.equations.bodies.in_time:
                told += doubts.apart(placed.what, t)
        equations, reached = self.equations, self._reached
        for load, p in zip(equations.followers, reached.pressures, strict=True):
            closed = touching_of(load, equations.interfaces, reached.status)
            of_load = load.what, load.at(equations.bodies.dofs, reached.u), closed, float(p)
            told += chosen(equations.bodies.dofs.comm, partial(doubts.uncovered, *of_load))
        self.told = told
        warn(self.equations.bodies.dofs.comm, told, before)


def _check_start(bodies: Bodies, u: Array, failed: StepFailed) -> None:
    """Require that no cells are inside out at u (n_local,), where an increment that has failed
    starts: smaller ones are of no help; collective."""
    count, first = bodies.inside_out(u)
    if count:
        raise ContactError(
            f"elements are inside out where the load step starts: {count}, the first drawn at "
            f"{first}; Newton's iteration fails from there: {failed}. Give u a displacement that "
            "turns none, as 0, or check how the mesh was moved"
        ) from None


def _left(run: Increment) -> Array:
    """(n_local,) sizes of the residual that is left [force]."""
    return np.where(run.fixed, 0.0, np.abs(run.r))


def _state(run: Increment) -> NewtonState:
    """Where an increment has come to; what touches is not known where bodies have no load then."""
    with collective(run.dofs.comm):  # users' laws may fail
        kept = tuple(t.kept() if t.kept else None for t in run.terms)
    status, springs = tuple(run.status), run.steps.springs
    if springs is not None:
        both = zip(run.steps.interfaces, status, strict=True)
        status = tuple(None if p.values(run.dofs, springs).any() else s for p, s in both)
    of_each = tuple(run.own), status, run.pressures, tuple(run.poses), kept
    return NewtonState(run.u, *of_each, run.pushed)


def _entry(run: Increment, iteration: int) -> dict[str, Any]:
    """Of an iteration, for the history."""
    counts = np.bincount(np.concatenate([np.zeros(0, int), *run.status]), minlength=4)
    return {
        "part": run.end,
        "iteration": iteration,
        "active": int(counts[1:].sum()),
        "stick": int(counts[STICK]),
        "slip": int(counts[SLIP]),
        "changes": run.changes,
        "residual": run.error,
        "linear": run.steps.system.taken(),
    }
