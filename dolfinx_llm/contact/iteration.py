"""The state of contact laws from load step to load step: which pairs are in contact, stick or slip.

Works on the interface alone: arrays that are the same on every rank.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from tqdm import tqdm

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import told
from dolfinx_llm.contact.equations.equations import Equations
from dolfinx_llm.contact.search.reached import ATTRIBUTES, Reached, take_back
from dolfinx_llm.contact.search.search import Search
from dolfinx_llm.contact.unseen_slips import of_the_bodies
from dolfinx_llm.forms.step import StepForm, StepResult
from dolfinx_llm.forms.verdict import Verdict
from dolfinx_llm.operators.system import ContactOperators


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
        self.operators, self.equations = operators, Equations(operators)
        self.states = self.equations.states
        self.bar: tqdm | None = None
        self._rests()

    def forget(self) -> None:
        """Start anew: at rest, all in contact, no slip history."""
        for state in self.states:
            state.forget()
        self._rests()

    def _rests(self) -> None:
        """No load step has been taken."""
        nothing: Any = None
        self.multiplier = self.w = self.alpha = self.last = nothing
        self.forces = self.ended = self.pressed = self.rounding = self.rounded = self.felt = 0.0
        self.moved = 0.0
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

    def stay(self, stays: bool) -> None:
        """Whether pairs that press, by more than rounding, stay in contact in the load step."""
        for s in self.states:
            if s.law.opens and (s.law.shares or not s.nodes.kappa.size):
                s.stays = (self.multiplier[s.nodes.rows[:, -1]] > self.rounding) & stays

    def accept(self, found: StepResult, g: Array) -> None:
        """End a load step: what has slipped is the reference of the next."""
        fitted = self.equations.middle(found.y + g, found.w)
        ended = found.multiplier, found.w
        w = of_the_bodies(self.states, *ended, fitted, self.scale)
        self.w = told(self.operators.floating.comm, w)
        self.moved = float(np.abs(found.y).max(initial=0.0))
        for s in self.states:
            s.accept(found.multiplier, self.w, fitted, self.scale, self.rounding)

    def iterate(self, start: Reached, f: Array, g: Array, falls: Callable[[], Any]) -> StepResult:
        """From where it stands, ``start``, to a state that meets all conditions, for this rank's f
        and gaps g; soon, or else given up, where no forces balance the loads: ``falls`` tells.

        Raises:
            ContactError: no convergence.
        """
        more = self.pressed, self.history, self.bar
        search = Search(self.equations, self.form, start, f, g, *more)
        found = search.find(falls)
        self.multiplier, self.w, self.alpha = found.multiplier, found.w, found.floating
        self.last = search.step
        return found
