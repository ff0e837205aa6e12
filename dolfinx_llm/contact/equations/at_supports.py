"""Frames at supports that hold both sides along them, as planes of symmetry across.

Rows there are left out (``operators/both_sides``), since others hold the frame. Where contact has
parted at these, a node of the frame is free across the plane but for small entries of corrected
rows: it went hundreds of times as far as the bodies to balance the friction of these, a little
farther in each iteration. The rows that are left out hold it then, and supports bear that friction,
as the mirrored half of the bodies would. They do not see jumps, and are no friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_matrix, vstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal
from dolfinx_llm.contact.equations.friction_nodes import FrictionNodes
from dolfinx_llm.operators.both_sides import MOSTLY

if TYPE_CHECKING:
    from dolfinx_llm.contact.equations.equations import Equations
    from dolfinx_llm.contact.equations.state import InterfaceState


def at_supports(nodes: FrictionNodes, tied: Array, least: Array) -> tuple[Array, Array]:
    """(m d,) motions of the frame along the surface that others hold by less than ``least``, and
    the rows left out (n c,) next to it that hold these.

    Args:
        nodes: of an interface.
        tied: (n,) pairs that follow the frame.
        least: (k,) sum of N²; 0: they tell nothing.
    """
    idle = nodes.operators.idle[nodes.rows]
    if not (idle.any() and least.any()):
        return np.zeros(len(nodes.v), dtype=bool), np.zeros(idle.size, dtype=bool)
    squares = abs(vstack(nodes.N)).power(2).tocsr()
    near = (squares > MOSTLY**2).astype(float)
    held = squares.T @ (nodes.kept.reshape(idle.shape) & tied[:, None]).astype(float)
    told = (held < least[:, None]) & (near.T @ idle > 0.0)
    told[:, -1] = False
    return told.ravel(), (idle & (near @ told.astype(float) > 0.0)).ravel()


def holding(states: Sequence[InterfaceState], forces: csr_matrix, scale: float) -> csr_matrix:
    """(n_v, n) what such rows are to the frames, by their gaps, as springs of the surfaces'
    stiffness [force / length].

    Args:
        states: of all interfaces.
        forces: (n_v, n) what forces of rows are to the frames.
        scale: that stiffness [force / length].
    """
    rows = np.concatenate([s.at_supports for s in states]).astype(float)
    return -scale * forces @ diagonal(rows)


def with_supports(equations: Equations, multiplier: Array, w: Array) -> Array:
    """λ (n,) with the forces of such rows [force].

    Args:
        equations: of the laws.
        multiplier, w: λ (n,) [force] and w (m,) [length].
    """
    rows, n_v = np.concatenate([s.at_supports for s in equations.states]), equations.n_v
    if not rows.any():
        return multiplier
    opening = equations.L[:, :n_v] @ w[:n_v] - equations.g
    return multiplier - equations.scale * rows * opening
