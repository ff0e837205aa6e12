"""Frame nodes beside contact whose slip runs away.

Corrected rows pass forces on to nodes beside contact. Where one of them bears a little less than
that, and hardly any pair holds it, its slip grows by as much in each iteration, without end: the
proximal term alone is in its way, and carries what is left.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.contact.equations.state import InterfaceState
from dolfinx_llm.contact.search.iterate import Iterate


def halt_slips(states: Sequence[InterfaceState], now: Iterate, before: Array) -> bool:
    """Have such nodes slip as a neighbour does, so that the law holds for the forces of both;
    whether there are new ones.

    Args:
        states: of the interfaces.
        now: what the last of many iterations has found in which nothing changes.
        before: (m,) frame and slip unknowns of the one before it [length].
    """
    moved, found = np.abs(now.w - before), False
    for s in states:
        if s.shares:
            far = moved[s.nodes.kappa].max(axis=1) > np.abs(now.position).max()
            new = far & (s.others.speaker == np.arange(len(far))) & ~s.pulled
            s.pulled, found = s.pulled | new, found or bool(new.any())
            s.touch(s.own.active)
    return found
