"""Frames with friction at supports that hold both sides along them, as across planes of symmetry.

Of the whole of a symmetric scene frame nodes stay on the plane: what pairs of one half ask of them
across it, those of the other half take. Of a half, rows on the plane are left out; frame nodes that
balanced what pairs ask moved across it, by hundreds of times as far as the bodies where contact had
parted at others that held them, and friction was off by up to 0.02 of the largest force. One of the
rows left out (``operators/both_sides``) holds each frame node there, by a spring, along dofs that
supports prescribe: these bear what it carries, also where the mean plane of coarse round surfaces
leans by 1e-3. It does not see jumps, and is no friction; friction across the plane that pairs of
the half itself ask for counts as such at nodes on it.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, vstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal
from dolfinx_llm.contact.equations.friction_nodes import FrictionNodes
from dolfinx_llm.operators.both_sides import MOSTLY

PINNED = 1e3  # times the surfaces' stiffness: more would make rounding of motions felt


def at_supports(nodes: FrictionNodes) -> tuple[Array, Array]:
    """(m d,) motions of the frame along the surface that supports hold, and the rows (n c,) by
    which they do.

    Args:
        nodes: of an interface.
    """
    pins = nodes.operators.pins[nodes.rows]
    if not pins.any():
        return np.zeros(len(nodes.v), dtype=bool), pins.ravel()
    near = abs(vstack(nodes.N)) > MOSTLY
    return np.asarray(near.T @ pins.astype(float)).ravel() > 0.0, pins.ravel()


def holding(rows: Array, forces: csr_matrix, scale: float) -> csr_matrix:
    """(n_v, n) what such rows are to the frames, by their gaps [force / length].

    Args:
        rows: (n,) which rows.
        forces: (n_v, n) what their forces along prescribed dofs are to the frames.
        scale: stiffness of the surfaces [force / length].
    """
    return -PINNED * scale * forces @ diagonal(rows.astype(float))


def borne(rows: Array, opening: Array, scale: float) -> Array:
    """(n,) what supports bear by such rows [force].

    Args:
        rows: (n,) which rows.
        opening: (n,) by how much the frame has left them [length].
        scale: stiffness of the surfaces [force / length].
    """
    return -PINNED * scale * rows * opening
