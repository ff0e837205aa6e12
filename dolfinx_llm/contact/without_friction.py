"""Contact without friction, which comes first where sticking pairs do not tell which touch."""

from __future__ import annotations

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.contact.equations import Equations


def glide(equations: Equations, glides: bool) -> bool:
    """Leave out friction where nodes share, or take it up again; whether any is left out. Then no
    pair follows the frame tangentially.

    Args:
        equations: of the laws.
        glides: friction is left out.
    """
    for s in equations.states:
        s.glides = glides and s.shares
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
