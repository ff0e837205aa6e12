"""One load step of contact laws: the search for a state that meets all conditions.

Each iteration finds the pairs in contact exactly, for laws linearised about the last iterate
(``equations``). The frame is held about the mid-surface between the bodies while contact changes,
then about its own last value, where the proximal term carries no force. What has come to rest, and
is not as it should be, is let go (``flickering``, ``ties``), and the search goes on. Frame nodes
that balance on their own from then on may be held by next to nothing: frames are held more firmly
again until contact stays. Without that a node beside one slipped by 400 widths of slender towers,
where bodies slip by 50, or stuck, as rounding told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from tqdm import tqdm

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.log import tell_iteration
from dolfinx_llm.base.parallel import told
from dolfinx_llm.contact.equations.equations import Equations, runaway, spread
from dolfinx_llm.contact.search.circles import Circles, failure
from dolfinx_llm.contact.search.flickering import lets_go, release, require_friction
from dolfinx_llm.contact.search.gross_slip import slide
from dolfinx_llm.contact.search.iterate import ENOUGH, Iterate, entry, take_over
from dolfinx_llm.contact.search.let_go import let_go
from dolfinx_llm.contact.search.parted import Parted
from dolfinx_llm.contact.search.reached import Reached
from dolfinx_llm.contact.search.runaways import halt_slips
from dolfinx_llm.contact.search.soft_rows import CALM, CONSTANT, GivingWay
from dolfinx_llm.contact.search.ties import ask, tie_more
from dolfinx_llm.contact.search.without_friction import WithoutFriction
from dolfinx_llm.forms.floating import Pull
from dolfinx_llm.forms.step import GRAZING, LinearStep, StepForm, StepResult
from dolfinx_llm.forms.verdict import FinalError
from dolfinx_llm.operators.system import ContactOperators

HOLD_FIRMLY = 1e-8  # what holds frames while contact changes, over the softest side's stiffness
HOLD_IF_CARRIED = 1e-11  # over the surfaces', where one side carries a frame: with more a pin with
# much clearance takes up to 150 iterations
HOLD_AGAIN = 0.1  # of that, where frame nodes have been let go
SOFTER_THAN_SPRINGS = 0.3  # the most, over springs that hold bodies: it must not push these away
LED = 10  # iterations in which what springs alone press together sticks
LAST_PULL = 1e-13  # of the forces, that the proximal term may carry, however loose solves are
PATIENT, LONG_ENOUGH = 20, 1e-9  # iterations of rest, after which this may be left, as about frame
# nodes far from contact, which forces of corrected rows reach a millionth of
UNTIL_DRIFT = 3  # the same where frame nodes that drift are all that is left
MAXIMUM = 100  # iterations, and as many again once ties have been chosen
MEETING_ENDS = 10  # iterations in which all sticks while it is found which pairs touch, at most
FALLING = 4  # of them in which the motion of what nothing holds is looked for
RUNS = 5  # iterations in which contact does not balance the force on an obstacle: it never will
WARY, TRUSTING = 1.2, 4.0  # trust in slips of the first iterate, by what it grows with each
FASTEST = 20  # doublings of how fast a frame node goes to where it touches


class Search:
    """From the state at the end of one load step to that of the next.

    Args:
        equations, form: of the laws; solves linear steps.
        start: where the last load step ended.
        f, g: this rank's load and the gaps.
        pressed: largest force on an obstacle at the start of the load step [force].
        history: of the load step, which grows.
        bar: progress line, if there is one.

    Attributes:
        step: the last linear step, with what is in contact.
    """

    step: LinearStep

    def __init__(
        self,
        equations: Equations,
        form: StepForm,
        start: Reached,
        f: Array,
        g: Array,
        pressed: float,
        history: list[dict[str, Any]],
        bar: tqdm | None,
    ) -> None:
        self._equations, self._form, self._f, self._g = equations, form, f, g
        self._operators, self._states = equations.operators, equations.states
        self._scale, self._comm = self._operators.scale, self._operators.floating.comm
        self._pressed = max(pressed, np.abs(equations.loads).max(initial=0.0))
        self._history, self._began, self._bar = history, len(history), bar
        self._known = start.w is not None  # there has been a load step
        self._first = not self._known  # it is being found which pairs touch at all
        w = start.w if self._known else np.zeros(equations.m)
        multiplier = start.multiplier if self._known else np.zeros(equations.n)
        self._about = multiplier, w  # of which laws are linearised
        self._centre = w if self._known else equations.middle(g, w)  # where frames are held
        self._frame = w  # and slips, of the last iteration
        equations.begin(multiplier, start.moved, g)
        floating = self._operators.floating
        self._spring = floating.spring(self._scale)
        alpha = start.alpha if self._known else np.zeros(floating.count)
        before = 0.0 if self._pressed else start.ended
        self._pull = Pull(floating, self._spring, f, (start.rounding, before), alpha)
        self._corrections = min(floating.count, 1)  # what springs hold is corrected once at least
        self._giving, self._circles = GivingWay(equations), Circles(history)
        self._parted = Parted(equations, self._comm)
        self._number, self._last, self._runs = 0, MAXIMUM, 0  # of iterations
        self._calm, self._before = 0, np.inf  # iterations without change; residual of the last
        self._held_alike, self._calmed = True, False  # as before; has come to rest once
        self._let_go = False  # frame nodes balance on their own, since contact was at rest last
        for s in self._states:
            s.begin()
        self._without_friction = WithoutFriction(equations, self._known)
        self._firmly = _firm_hold(self._operators, self._spring, self._without_friction.carried)

    def find(self, falls: Callable[[], Any]) -> StepResult:
        """The state that meets all conditions; soon, or else given up, where no forces balance the
        loads, which ``falls`` tells.

        Raises:
            ContactError: no convergence.
        """
        while self._number < self._last and (self._number < FALLING or not falls()):
            self._number += 1
            now = self._iterate()
            if self._operators.tied:  # one linear step is all
                return now.result
            lost = self._parted.lost(now.multiplier, now.position)
            if self._without_friction.sought(now, self._number, lost):
                continue
            self._watch(now)
            if back := self._without_friction.told_nothing(self._pull.share):
                self._about, self._centre = back
                continue
            rests = self._rests(now)
            released = self._releases(now, rests)
            if rests and not released:
                require_friction(self._states, now.borne)
                self._parted.require_contact(now.multiplier, now.position)
                # The adjoint, and what rounding makes of forces, are those of frames held weakly.
                if self._equations.frames.epsilon != self._form.proximal:
                    self._equations.frames.epsilon = self._form.proximal
                    self.step = replace(self._linear_step(), active=now.result.active)
                return now.result
            self._go_on(now, released)
        raise ContactError(failure(self._history[self._began :]))

    @property
    def _hold(self) -> float:
        """What holds frames, over the surfaces' stiffness: firm while contact changes, so that no
        rounding tells what touches them."""
        weakly = self._calmed or not (self._form.light or self._first or self._number > 1)
        share = HOLD_AGAIN if self._let_go else float(not weakly)
        return max(share * self._firmly, self._form.proximal)

    def _iterate(self) -> Iterate:
        """Solve a linear step, and take over what is in contact, sticks and slips then."""
        equations, glides, hold = self._equations, self._without_friction.now, self._hold
        self._held_alike, equations.frames.epsilon = hold == equations.frames.epsilon, hold
        equations.lags = self._circles.lag(self._calm <= CALM)
        equations.trust = WARY * TRUSTING ** (self._number - 2)
        settled = self._calm > 0 and self._before <= CONSTANT
        self._giving.begin(settled, self._number)
        step = self._linear_step()
        if glides or self._first:
            step = equations.all_stick(step)
        found = self._form.solve(self._f, step)
        multiplier, w, position = found.multiplier, found.w, found.y + self._g
        drawn = equations.frames.pull(w - self._centre)
        self.step = replace(step, active=found.active)
        largest = max(step.level(multiplier, found.y, self._scale), GRAZING * self._pressed)
        slid = slide(equations, found, position, self._known * self._number)
        if glides:
            slid = self._without_friction.slips(position, multiplier, w)
        changes = sum(take_over(s, equations, found, self._calmed) for s in self._states)
        for s in self._states if self._first else ():
            s.own.closings[:] = 0  # that pairs come and go by then tells nothing of friction
        judged = changes, equations.miss(multiplier, w) / largest, drawn / largest
        self._runs = self._runs + 1 if (lost := runaway(equations, multiplier)) else 0
        if self._runs > RUNS:
            raise FinalError(lost)
        now = Iterate(found, position, slid, largest, *told(self._comm, judged))
        self._history.append(entry(self._number, self._states, now))
        tell_iteration(self._history[-1], self._bar)
        return now

    def _linear_step(self) -> LinearStep:
        held = self._pull.anchor, self._spring
        return self._equations.step(self._about, self._g, self._centre, held, self._calmed)

    def _watch(self, now: Iterate) -> None:
        """See whether contact stays, and what springs that hold free bodies carry."""
        # That all stick or glide at first is a state that changes.
        supposed = self._without_friction.now or (self._first and now.miss > self._form.accuracy)
        self._calm = 0 if now.changes or supposed else self._calm + 1
        # What springs carry is compared where frames, which bear a part, are held alike.
        calm = self._calm if self._held_alike else min(self._calm, 1)
        self._pull.watch(now.result.floating, now.multiplier, calm, self._form.noise)
        self._equations.idle = self._pull.most if self._number < LED else 0.0

    def _stalls(self, now: Iterate) -> bool:
        """Whether contact stays, and what is left does not fall."""
        return self._calm > CALM and now.miss > 0.5 * self._before

    def _rests(self, now: Iterate) -> bool:
        """Whether contact stays, and hardly anything is left."""
        left = ENOUGH if self._calm <= (UNTIL_DRIFT if now.drifts else PATIENT) else LONG_ENOUGH
        enough = max(left, spread(self._equations, self._form.noise) / now.largest)
        settled = now.miss <= self._form.accuracy and now.drawn <= LAST_PULL
        settled |= self._stalls(now) and now.miss <= enough
        settled &= self._giving.rest(now.multiplier, now.largest, self._calm)
        return settled and self._calm > self._corrections and self._pull.rests

    def _releases(self, now: Iterate, rests: bool) -> bool:
        """Whether something is let go, or tied, that rests, or nearly so, and is not as it should
        be."""
        released = (rests or self._calm > 1) and release(self._equations, now.multiplier, now.w)
        self._let_go = released or (self._let_go and not self._calm)
        released |= tie_more(self._states, now.borne, now.miss)
        released |= self._calm > PATIENT and halt_slips(self._states, now, self._frame)
        if not rests or released:
            return released
        gaps = self._scale * (self._equations.L @ now.w - now.position)
        if lets_go(self._states, now.borne, gaps, ENOUGH * now.largest):
            return True
        asked = ask(self._states, now.borne, self._without_friction.vital)
        self._last = self._number + MAXIMUM if asked else self._last
        return asked

    def _go_on(self, now: Iterate, released: bool) -> None:
        """About what the laws are linearised next, and where frames are held."""
        equations, w, stalled = self._equations, now.w, self._stalls(now)
        # Friction is linearised about the last iterate, or halfway where that did not help.
        ahead, (force, slid) = (now.multiplier, now.slid), self._about
        if self._number > 1 and now.changes and now.miss > 0.9 * self._before:
            ahead = 0.5 * (force + ahead[0]), 0.5 * (slid + ahead[1])
        self._about, self._without_friction.now = ahead, False
        met = self._number >= MEETING_ENDS or not now.result.wrong.any()
        self._first &= not met and self._history[-1]["stick"] > self._history[-1]["slip"]
        self._calm, self._before = (0, np.inf) if released else (self._calm, now.miss)
        # From then on the frame goes on from where it is, and what no force holds stays.
        if self._calm > 0 and not self._calmed:
            self._calmed = True
            firmly, weakly = equations.frames.epsilon, self._form.proximal
            if firmly > weakly and not self._form.light:
                w = let_go(equations, self.step, weakly / firmly, now, self._f)
        centre = w if self._calmed else equations.middle(now.position, w)
        # A frame node under a tiny force goes to where it touches, ever faster: a pin in a 3D
        # lug takes 22 iterations by the whole system, and 83 without.
        if stalled:
            farther = 2.0 ** min(self._calm, FASTEST) - 1.0
            centre = w + farther * np.where(equations.drifts, w - self._frame, 0.0)
        changing = self._number if now.changes else 0
        self._centre = self._parted.frame(centre, now.multiplier, now.position, changing)
        self._frame = w
        if self._calm:
            self._form.correct(now.result)


def _firm_hold(operators: ContactOperators, spring: float, carried: bool) -> float:
    """What holds frames firmly, over the surfaces' stiffness, where springs hold free bodies; a
    side may carry a frame."""
    if carried:
        return HOLD_IF_CARRIED
    softest = min(float(sides.min()) for sides in operators.stiffness)
    hold = HOLD_FIRMLY * min(softest / operators.scale, 1.0)
    if operators.floating.count:
        hold = min(hold, SOFTER_THAN_SPRINGS * spring / operators.scale)
    return hold
