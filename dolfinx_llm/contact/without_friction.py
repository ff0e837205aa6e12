"""Contact without friction, which comes first where sticking pairs do not tell which touch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal
from dolfinx_llm.contact.equations import Equations, seen_by
from dolfinx_llm.contact.state import InterfaceState


def look(states: Sequence[InterfaceState]) -> int:
    """Iteration of the first load step after which too many pairs still change to tell which touch;
    slips of single nodes, as where a side carries the frame, mostly do in three.

    Args:
        states: of all interfaces.
    """
    return 3 if any(s.carried for s in states) else 1


def glide(equations: Equations, glides: bool) -> bool:
    """Leave out friction where nodes share, or a side carries a frame, or take it up again; whether
    any is left out.

    Then no pair follows the frame tangentially, and all press on it along its own normals: what
    theirs have along its tangents would find no balance.

    Args:
        equations: of the laws.
        glides: friction is left out.
    """
    seen = np.ones(equations.m)
    for s in equations.states:
        s.glides = glides and (s.shares or s.carried)
        s.touch(s.own.active)
        if s.glides:
            v = s.nodes.v.reshape(s.nodes.geometry.directions.shape[:2])
            seen[v[:, :-1]] = seen[s.nodes.kappa] = 0.0
    found = not seen.all()
    if found or equations.L is not equations.whole:
        L = (equations.whole @ diagonal(seen)).tocsr() if found else equations.whole
        equations.L, equations.L_t = seen_by(L, equations.n_v)
    return found


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
