"""Contact without friction, which is sought where sticking pairs do not tell which touch."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.contact.equations.equations import Equations
from dolfinx_llm.contact.search.flickering import keep
from dolfinx_llm.contact.search.iterate import Iterate
from dolfinx_llm.contact.search.reached import take_back, untied
from dolfinx_llm.contact.search.ties import ask_again, choose, unsettled

MANY = 0.2  # of the pairs: where more change at first, contact without friction tells which touch
FLOATS = 1e-6  # of the forces, that springs carry where contact without friction holds no body


class WithoutFriction:
    """One iteration of a load step in which no pair follows the frame tangentially, but those that
    carry it, where nodes share friction or a side carries the frame.

    Args:
        equations: of the laws, at the start of the load step.
        known: there has been one before.

    Attributes:
        carried: a side carries a frame.
        now: the next iteration is one, or this one until it has been told.
        vital: friction alone holds bodies: contact without it tells nothing.
    """

    def __init__(self, equations: Equations, known: bool) -> None:
        self._equations, self._states = equations, equations.states
        self._carried = [s.nodes.geometry.site.carrier is not None for s in self._states]
        self.now, self.vital = self._leave_out(False), False
        self._rest = untied(self._states)
        # Slips of single nodes, as where a side carries the frame, mostly tell in three.
        self.carried = any(self._carried)
        self._looks = 3 if self.carried else 1
        self._many = np.inf if known else MANY * sum(len(s.nodes.rows) for s in self._states)
        self._stuck: Any = None

    def sought(self, iterate: Iterate, number: int, lost: bool) -> bool:
        """Whether the next iteration is one.

        Args:
            iterate: what the last has found.
            number: of that in the load step.
            lost: slips have taken a frame away.
        """
        asked = not self.vital and unsettled(self._states)
        asked |= lost or (number == self._looks and iterate.changes > self._many)
        if not (asked and self._leave_out(True)):
            return False
        self.now, middle = True, self._equations.middle(iterate.position, iterate.w)
        self._stuck = untied(self._states), (iterate.multiplier, iterate.w), middle
        take_back(self._states, self._rest)
        return True

    def slips(self, position: Array, multiplier: Array, w: Array) -> Array:
        """(m,) w with slips of the bodies where pairs glide; from here on they have friction again,
        and ties where these were asked for.

        Args:
            position: (n,) of all rows [length].
            multiplier: λ (n,) [force].
            w: (m,) frame and slip unknowns [length].
        """
        gliding = [s.nodes.kappa.ravel() for s in self._states if s.glides]
        at, found = np.concatenate(gliding), w.copy()
        found[at] = self._equations.middle(position, w)[at]
        choose(self._states, multiplier)
        self._leave_out(False)
        return found

    def told_nothing(self, share: float) -> tuple[Any, Array] | None:
        """λ and w of the last iterate with friction and the frame's centre (m,) then, to go on from
        where it turns out that friction alone holds bodies; else None.

        Args:
            share: of the forces, that springs carry that hold free bodies.
        """
        if not (self.now and share > FLOATS):
            return None
        self.now, self.vital = False, True
        states, about, centre = self._stuck
        take_back(self._states, states)
        keep(self._states)
        ask_again(self._states)
        return about, centre

    def _leave_out(self, glides: bool) -> bool:
        """Leave out friction, or take it up again; whether any is left out."""
        for s, carried in zip(self._states, self._carried, strict=True):
            s.glides = glides and (s.shares or carried)
            s.touch(s.own.active)
        return any(s.glides for s in self._states)
