"""Contact without friction, which comes first where sticking pairs do not tell which touch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.contact.equations import Equations
from dolfinx_llm.contact.state import InterfaceState


def look(states: Sequence[InterfaceState]) -> int:
    """Iteration of the first load step after which too many pairs still change to tell which touch;
    slips of single nodes, as where a side carries the frame, mostly do in three.

    Args:
        states: of all interfaces.
    """
    return 3 if any(s.carried for s in states) else 1


def glide(equations: Equations, glides: bool) -> bool:
    """Leave out friction where nodes share, or a side carries the frame, or take it up again;
    whether any is left out. Then no pair follows the frame tangentially but those that carry it.

    Args:
        equations: of the laws.
        glides: friction is left out.
    """
    for s in equations.states:
        s.glides = glides and (s.shares or s.carried)
        s.touch(s.own.active)
    return any(s.glides for s in equations.states)


def slips(equations: Equations, position: Array, w: Array) -> Array:
    """(m,) w with slips of the bodies where pairs glide.

    Args:
        equations: of the laws.
        position: (n,) of all rows [length].
        w: (m,) frame and slip unknowns [length].
    """
    gliding = [s.nodes.kappa.ravel() for s in equations.states if s.glides]
    at, found = np.concatenate(gliding), w.copy()
    found[at] = equations.middle(position, w)[at]
    return found
