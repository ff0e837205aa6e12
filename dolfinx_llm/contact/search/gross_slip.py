"""Bodies that are about to slide past each other as a whole."""

from __future__ import annotations

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.contact.equations.equations import Equations
from dolfinx_llm.contact.equations.state import InterfaceState
from dolfinx_llm.forms.step import StepResult
from dolfinx_llm.laws.answers import at_nodes

DEEP = 8.0  # softness of bodies against sliding, over that of a row of their nodes side by side


def slide(equations: Equations, step: StepResult, position: Array, iteration: int) -> Array:
    """(m,) w with slips along the friction of an interface, where that is more than all its nodes
    can bear.

    Newton's method lets those nodes slip that bear too much. The others follow one iteration after
    the other, and what they bear until then, at the rim of what sticks, points along no slip.

    Args:
        equations: of the laws.
        step: what an iteration has found.
        position: (n,) of the bodies at all rows [length].
        iteration: its number in a load step that goes on from another, 0 in the first: slip is
            foreseen after iteration 1, where contact stays as it is.
    """
    found = _told(equations, step, position)
    if iteration != 1 or step.wrong.any():
        return found
    for s in equations.states:
        if s.nodes.kappa.size and s.shares and not s.glides:
            _slide(s, step, equations.scale, found)
    return found


def _told(equations: Equations, step: StepResult, position: Array) -> Array:
    """(m,) w with the bodies' slips along obstacles where pairs have no friction in this step, as
    where nothing pressed them in the last. Nothing tells their own, which may be none: where they
    have friction again they would stick then, and hold a body that has gone on."""
    found = step.w.copy()
    for s in equations.states:
        if s.nodes.kappa.size and s.nodes.geometry.rigid and s.law.opens:
            rows, kappa = s.nodes.rows, s.nodes.kappa
            moved = position[rows] - (s.nodes.L @ step.w[s.nodes.v]).reshape(rows.shape)
            untold = ~step.active[rows[:, :-1]].any(axis=1)
            found[kappa[untold]] = moved[untold, : kappa.shape[1]]
    return found


def _slide(s: InterfaceState, step: StepResult, scale: float, found: Array) -> None:
    nodes = s.at(step.multiplier, step.w, scale)
    with collective(s.nodes.comm):
        bears = np.maximum(at_nodes(s.law, "strength", nodes), 0.0)
    total = np.einsum("ka,kai->i", nodes.force, s.nodes.tangents)
    size = float(np.linalg.norm(total))
    along = s.nodes.tangents @ (total / max(size, 1e-300))
    left = size - float(bears @ np.linalg.norm(along, axis=1))
    if not left > 0.0:
        return
    across = len(bears) ** (1.0 / max(s.nodes.kappa.shape[1], 1))
    slip = DEEP * across * left / nodes.c.sum() * along
    found[s.nodes.kappa] = s.nodes.theta * (nodes.before + slip)
