"""Iteration of contact laws: which pairs are in contact, which stick and which slip.

Each iteration finds the pairs in contact exactly, for laws linearised about the last iterate
(``equations``). The frame is held about the mid-surface between the bodies while contact changes,
then about its own last value, where the proximal term carries no force. Works on the interface
alone: arrays that are the same on every rank.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from mpi4py import MPI
from tqdm import tqdm

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.log import tell_iteration
from dolfinx_llm.base.parallel import told
from dolfinx_llm.contact.circles import Circles, failure
from dolfinx_llm.contact.equations import Equations, spread, unfelt
from dolfinx_llm.contact.flickering import count, keep, lets_go, require_friction
from dolfinx_llm.contact.gross_slip import slide
from dolfinx_llm.contact.parted import Parted
from dolfinx_llm.contact.reached import ATTRIBUTES, Reached, take_back, untied
from dolfinx_llm.contact.soft_rows import CALM, CONSTANT, GivingWay
from dolfinx_llm.contact.state import InterfaceState
from dolfinx_llm.contact.ties import ask, ask_again, choose, tie_more, unsettled
from dolfinx_llm.contact.unseen_slips import of_the_bodies
from dolfinx_llm.contact.without_friction import glide, look, slips
from dolfinx_llm.forms.floating import Pull
from dolfinx_llm.forms.step import GRAZING, SIGN, StepForm, StepResult, unless_none
from dolfinx_llm.forms.verdict import FinalError, Verdict
from dolfinx_llm.laws.rows import OPEN, SLIP, STICK
from dolfinx_llm.operators.system import ContactOperators

LED = 10  # iterations in which what springs alone press together sticks
LAST_PULL = 1e-13  # of the forces, that the proximal term may carry, however loose solves are
ENOUGH = 1e-10  # residual that may be left where it has stopped falling
PATIENT, LONG_ENOUGH = 20, 1e-9  # iterations of rest, after which this may be left, as about frame
# nodes far from contact, which forces of corrected rows reach a millionth of
MAXIMUM = 100  # iterations, and as many again once ties have been chosen
FALLING = 4  # of them in which the motion of what nothing holds is looked for
LIGHT = 1e-3  # of the largest force: pairs with less are at the rim of contact
MANY = 0.2  # of the pairs: where more change at first, contact without friction tells which touch
FLOATS = 1e-6  # of the forces, that springs carry where contact without friction holds no body
RUNS = 5  # iterations in which contact does not balance the force on an obstacle: it never will
FASTEST = 20  # doublings of how fast a frame node goes to where it touches


class ContactIteration:
    """From the state at the end of one load step to that of the next.

    Args:
        operators: of the interfaces.
        form: solves linear steps.
        f, g: this rank's load and the gaps at rest, from which the first load step starts.

    Attributes:
        operators, equations, states: as given; of the laws; per interface ``InterfaceState``.
        multiplier, w, ...: all but the first two of ``Reached``.
        pressed: largest force on an obstacle at the start of this load step [force].
        bar: progress line, if there is one.
    """

    def __init__(self, operators: ContactOperators, form: StepForm, f: Array, g: Array) -> None:
        self.scale, self.form, self._rest = operators.scale, form, (f, g)
        self.operators, self.equations = operators, Equations(operators, form.proximal)
        self.states = self.equations.states
        self.bar: tqdm | None = None
        self._calmed = self._vital = False  # has come to rest once; friction alone holds bodies
        self.forget()

    def forget(self) -> None:
        """Start anew: at rest, all in contact, no slip history."""
        for state in self.states:
            state.forget()
        nothing: Any = None
        self.multiplier = self.w = self.alpha = self.last = nothing
        self.forces = self.ended = self.pressed = self.rounding = self.rounded = self.felt = 0.0
        self.verdict = Verdict(0.0, 0.0)
        self.f, self.g = self._rest
        self.equations.loads = np.zeros(self.equations.n_v)
        self.history: list[dict[str, Any]] = []

    def resume(self, other: ContactIteration, f: Array, g: Array, u: Array) -> None:
        """Go on from the state of another iteration of the same pairs and frames.

        Args:
            other: where it ended.
            f, g: this rank's load and the gaps with which bodies and operators of this one are in
                balance there.
            u: this rank's displacement there.
        """
        alpha = self.operators.floating.amounts(u)  # of other modes, perhaps
        self.restore(replace(other.snapshot(), f=f, g=g, alpha=alpha, last=None))

    def snapshot(self) -> Reached:
        """Where it stands."""
        plain = {name: getattr(self, name) for name in ATTRIBUTES}
        return Reached([s.own.copy() for s in self.states], self.equations.loads, **plain)

    def restore(self, reached: Reached) -> None:
        """Go on from there, or back to it."""
        for name in ATTRIBUTES:
            setattr(self, name, getattr(reached, name))
        self.equations.loads = reached.loads
        take_back(self.states, reached.states)

    def accept(self, found: StepResult, g: Array) -> None:
        """End a load step: what has slipped is the reference of the next."""
        fitted = self.equations.middle(found.y + g, found.w)
        ended = found.multiplier, found.w
        w = of_the_bodies(self.states, *ended, fitted, self.scale)
        self.w = told(self.operators.floating.comm, w)
        for s in self.states:
            s.accept(found.multiplier, self.w, fitted, self.scale, self.rounding)

    def iterate(self, f: Array, g: Array, falls: Callable[[], Any]) -> StepResult:
        """To a state that meets all conditions, for this rank's f and gaps g; soon, or else given
        up, where no forces balance the loads, which ``falls`` tells.

        Raises:
            ContactError: no convergence.
        """
        first, known, equations = len(self.history), self.w is not None, self.equations
        w = self.w if known else np.zeros(equations.m)
        pressed = max(self.pressed, np.abs(equations.loads).max(initial=0.0))
        centre = w if known else equations.middle(g, w)
        floating, spring = self.operators.floating, self.operators.floating.spring(self.scale)
        alpha = self.alpha if known else np.zeros(floating.count)
        about: Any = (self.multiplier if known else np.zeros(equations.n), w)
        equations.idle, equations.least = 0.0, unfelt(equations, w)
        equations.start, self._calmed, self._vital = about[0], False, False
        calm, before, w_last = 0, np.inf, w  # iterations without change
        runs, iteration, last = 0, 0, MAXIMUM
        giving, circles = GivingWay(equations), Circles(self.history)
        many = np.inf if known else MANY * sum(len(s.nodes.rows) for s in self.states)
        parted = Parted(equations, floating.comm)
        corrections = min(floating.count, 1)  # what springs hold is corrected once at least
        pull = Pull(floating, spring, f, self.rounding, alpha)
        for s in self.states:
            s.begin()
        glides, looks, rest = glide(equations, False), look(self.states), untied(self.states)
        while iteration < last and (iteration < FALLING or not falls()):
            iteration += 1
            equations.lags = circles.lag(calm <= CALM)
            equations.about = giving.about(calm > 0 and before <= CONSTANT, iteration)
            step = equations.step(about, g, centre, (pull.anchor, spring), self._calmed)
            if glides or (not known and iteration == 1):
                step = equations.all_stick(step)
            found, drawn = _told(self.form.solve(f, step), equations, centre, floating.comm)
            multiplier, y, w = found.multiplier, found.y, found.w
            self.last = replace(step, active=found.active)
            largest = max(step.level(multiplier, y, self.scale), GRAZING * pressed)
            borne = np.where(np.abs(multiplier) > SIGN * largest, multiplier, 0.0)
            met = slide(equations, found, y + g, known * iteration)
            if glides:
                met = slips(equations, y + g, w)
                choose(self.states, multiplier)
                glide(equations, False)
            taken = sum(self._take(s, found) for s in self.states)
            missed = equations.miss(multiplier, w)
            changes, miss, drawn = told(floating.comm, (taken, missed / largest, drawn / largest))
            runs = runs + 1 if (lost := equations.runaway(multiplier)) else 0
            if runs > RUNS:
                raise FinalError(lost)
            self.history.append(_entry(iteration, self.states, changes, miss))
            tell_iteration(self.history[-1], self.bar)
            if self.operators.tied:  # one linear step is all
                self.multiplier, self.w, self.alpha = multiplier, w, found.floating
                return found
            anew = not self._vital and unsettled(self.states)
            anew |= parted.lost(multiplier, y + g)
            anew |= iteration == looks and changes > many
            if anew and glide(equations, True):
                glides = True  # contact is sought anew, without friction
                stuck = untied(self.states), (multiplier, w), equations.middle(y + g, w)
                take_back(self.states, rest)
                continue
            # That all stick or glide at first is a state that changes.
            supposed = glides or (not known and iteration == 1 and miss > self.form.accuracy)
            calm = 0 if changes or supposed else calm + 1
            pull.watch(found.floating, multiplier, calm, self.form.noise)
            equations.idle = pull.most if iteration < LED else 0.0
            if glides and pull.share > FLOATS:  # friction alone holds bodies: on from what stuck
                glides, self._vital, (_, about, centre) = False, True, stuck
                take_back(self.states, stuck[0])
                keep(self.states)
                ask_again(self.states)
                continue
            stalled = calm > CALM and miss > 0.5 * before
            left = ENOUGH if calm <= PATIENT else LONG_ENOUGH
            enough = max(left, spread(equations, self.form.noise) / largest)
            settled = miss <= self.form.accuracy and drawn <= LAST_PULL
            settled |= stalled and miss <= enough
            settled &= giving.rest(multiplier, largest, calm)
            rests = settled and calm > corrections and pull.rests
            released = (rests or calm > 1) and equations.release(multiplier, ENOUGH * largest)
            released |= tie_more(self.states, borne, miss)
            if rests and not released:
                gaps = self.scale * (equations.L @ w - y - g)
                released = lets_go(self.states, borne, gaps, ENOUGH * largest)
            if rests and not released and ask(self.states, borne, self._vital):
                last, released = iteration + MAXIMUM, True
            if rests and not released:
                require_friction(self.states, borne)
                parted.require_contact(multiplier, y + g)
                self.multiplier, self.w, self.alpha = multiplier, w, found.floating
                return found
            # Friction is linearised about the last iterate, or halfway where that did not help.
            half = iteration > 1 and changes and miss > 0.9 * before
            about = tuple(0.5 * (a + b) if half else b for a, b in zip(about, (multiplier, met)))
            glides, calm, before = False, 0 if released else calm, np.inf if released else miss
            # From then on the frame goes on from where it is, and what no force holds stays.
            self._calmed = self._calmed or calm > 0
            centre = w if self._calmed else equations.middle(y + g, w)
            # A frame node under a tiny force goes to where it touches, ever faster: a pin in a 3D
            # lug takes 22 iterations by the whole system, and 83 without.
            if stalled:
                farther = 2.0 ** min(calm, FASTEST) - 1.0
                centre = w + farther * np.where(equations.drifts, w - w_last, 0.0)
            centre = parted.frame(centre, multiplier, y + g, iteration if changes else 0)
            w_last = w
            if calm:
                self.form.correct(found)
        raise ContactError(failure(self.history[first:]))

    def _take(self, s: InterfaceState, found: StepResult) -> int:
        """Take over the pairs of an interface in contact, and find what sticks and slips; number of
        changes that matter."""
        rows, own = s.nodes.rows, s.own
        normal = rows[:, -1]
        chosen = found.active[normal] ^ found.wrong[normal] if s.law.opens else own.active
        changed, force = chosen != own.active, np.abs(found.multiplier)
        largest = unless_none(float(force.max(initial=0.0)), self.equations.least)
        light = force[normal] <= LIGHT * largest
        count(s, chosen, found.wrong[normal], light)
        s.touch(chosen)
        # What carries nothing changes to no effect. A sign that is wrong has to change, also where
        # its pair then is as it was.
        felt = changed & (force[rows].max(axis=1) > self.equations.felt * largest)
        changes = int((felt | found.wrong[normal]).sum())
        if s.nodes.kappa.size:
            changes += _follow(s, self.equations, found, self._calmed, largest)
        return changes


def _told(
    found: StepResult, equations: Equations, centre: Array, comm: MPI.Comm
) -> tuple[StepResult, float]:
    """What is found, without tension that is what holds frames far from their centre (m,), and the
    largest force of that."""
    most = told(comm, equations.frames.pull(found.w - centre))
    idle = found.active & (found.multiplier < 0.0) & (found.multiplier >= -most)
    return replace(found, wrong=found.wrong & ~idle), most


def _follow(
    s: InterfaceState, equations: Equations, found: StepResult, calmed: bool, largest: float
) -> int:
    """Take over what sticks and slips on an interface; the number of changes that matter."""
    stake = s.law.at_stake(s.at(found.multiplier, found.w, equations.scale))
    felt = stake > equations.felt * largest
    now = equations.law_rows(s, found.multiplier, found.w, calmed)
    differs = ((now.status != s.own.status) & felt) | (now.holds != s.own.holds)
    s.take(now)
    return int(differs.sum())


def _entry(
    iteration: int, states: list[InterfaceState], changes: int, miss: float
) -> dict[str, Any]:
    """Of the history: numbers of pairs in contact, of those that stick and slip, of changes."""
    status = np.concatenate([s.pair_status() for s in states])
    of = [int((status == one).sum()) for one in (OPEN, STICK, SLIP)]
    counts = {"active": len(status) - of[0], "stick": of[1], "slip": of[2], "changes": changes}
    return {"iteration": iteration, **counts, "residual": miss}
