"""Forces of rows that give way to changes alone, as they settle from iteration to iteration."""

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.contact.equations.equations import Equations
from dolfinx_llm.forms.step import SOFT

CONSTANT = 1e-8  # part of the largest force by which those at supports may still change
ROUGH = 1e-5  # the same where that falls no more: by ``SOFT`` less than 1e-11 of what bodies give
CALM = 2  # iterations without a change after which a residual may have stopped falling
LONG = 12  # the same, after which all last changes are combined
MIXED = 8  # changes of which the best combination is looked for
NEWS = 1e-6  # of the largest: differences of changes that say nothing new
LATE = 24  # iterations in which most scenes come to rest
GIVES_LESS = 0.1  # of ``SOFT``, from then on


class GivingWay:
    """Where supports, or other rows, leave forces open, rows give way by ``SOFT`` to what changes
    of λ, and the next iteration starts from there. Combinations of rows that nearly follow from
    others then change by a part of the last change each time: after ``LONG`` iterations the next
    start is where the combination of the last changes is least (Anderson 1965).

    While pairs still change rows give way about the start of the load step, so that λ does not
    depend on the way there. Where it is one and then the other of two pairs that share a force,
    this goes on for ever: from iteration ``LATE`` on rows give way about the last λ. They do so by
    less then, as combinations of changes miss where friction slips.

    Args:
        equations: of the rows, about λ at the start of the load step.
    """

    def __init__(self, equations: Equations) -> None:
        self._equations, self._ahead, self._last = equations, equations.start, equations.start
        self._given = np.inf
        self._changes: list[Array] = []
        self._found: list[Array] = []

    def begin(self, settled: bool, iteration: int) -> None:
        """About what, and by how much, rows give way in an iteration.

        Args:
            settled: pairs and laws have come to rest.
            iteration: its number.
        """
        equations, late = self._equations, iteration > LATE
        equations.gives = GIVES_LESS * SOFT if late else SOFT
        equations.about = self._ahead if settled else self._last if late else equations.start

    def rest(self, multiplier: Array, largest: float, calm: int) -> bool:
        """Whether the forces λ (n,) differ little from those about which rows give way now.

        Args:
            multiplier: λ of this iteration [force].
            largest: force [force].
            calm: iterations in which nothing else has changed.
        """
        equations = self._equations
        soft = equations.soft & equations.closed_rows()
        change = np.where(soft, multiplier - equations.about, 0.0)
        last, self._given = self._given, float(np.abs(change).max(initial=0.0))
        self._last = self._ahead = multiplier
        self._changes = [*self._changes[-MIXED:], change] if calm else []
        self._found = [*self._found[-MIXED:], multiplier] if calm else []
        if calm > LONG:
            self._ahead = self._best()
        falls = calm <= CALM or self._given <= 0.5 * last
        return self._given <= (CONSTANT if falls else ROUGH) * largest

    def _best(self) -> Array:
        """(n,) the combination of what was found whose change is least."""
        steps = np.diff(self._changes, axis=0).T
        part = np.linalg.lstsq(steps, self._changes[-1], rcond=NEWS)[0]
        return np.asarray(self._found[-1] - np.diff(self._found, axis=0).T @ part)
