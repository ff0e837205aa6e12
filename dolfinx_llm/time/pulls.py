"""What pairs with friction pull with as they open, over what they press with.

A pair that opens in a step is held in it for one moment, in which it pulls, without friction; it
has pressed by as much more before, with friction. Bodies that swing undamped do so all the time,
and friction then is that of more normal force than there is: a block stopped 26 % short of v²/2μg.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array

PULL_SHARE = 0.01  # of what pairs have pressed with, up to which nothing is said
HAS_PRESSED = 1e-6  # of the largest impulse of an interface, below which another has none
SWINGS_NO_MORE = 0.1  # damping from which on smaller steps alone help
ADVICE = (
    f"Bodies swing: give damping={SWINGS_NO_MORE:g} to the TimeStepper, or take smaller steps",
    "Take smaller steps: half a cell over the speed of waves is small enough",
)
TOLD_AGAIN = 2.0  # times the share that has been told, from which on it is told again


class Pulls:
    """Impulses of the pairs of one interface since the start.

    Args:
        name: of the interface.

    Attributes:
        pressed: impulse of what has pressed so far [force time].
    """

    def __init__(self, name: str) -> None:
        self.name, self._told = name, PULL_SHARE / TOLD_AGAIN
        self._last, self.pressed, self._pulled = np.zeros(0), 0.0, 0.0

    def take(self, sides: Sequence[Any], dt: float) -> None:
        """See a step of length dt [time].

        Args:
            sides: of the interface's result.
        """
        now: Array = np.concatenate([side.pressing for side in sides])
        if len(now) == len(self._last):
            self._pulled -= dt * float(now[(now < 0.0) & (self._last > 0.0)].sum())
        self.pressed += dt * float(now[now > 0.0].sum())
        self._last = now

    def told(self, largest: float, damping: float) -> list[str]:
        """What is to be said after a step.

        Args:
            largest: impulse so far of any interface: one with next to none of it has been touched
                by rounding alone [force time].
            damping: of the step.
        """
        if self.pressed <= HAS_PRESSED * largest:
            return []
        if self._pulled <= TOLD_AGAIN * self._told * self.pressed:
            return []
        self._told = share = self._pulled / self.pressed
        return [
            f"interface {self.name}: pairs that open have pulled with {share:.1%} of what they "
            "pressed with since the start, in moments without friction: friction may be too large "
            f"by as much. {ADVICE[damping >= SWINGS_NO_MORE]}"
        ]
