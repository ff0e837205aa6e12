"""Bodies and obstacles that would fall: neither supports nor contact hold them. Their nearest pairs
touch. Bodies that touch, or are tied to, each other alone fall together, and so does what an
obstacle under a force touches: it holds none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.finite.load_step import Placed
from dolfinx_llm.finite.obstacles.obstacle_contact import ObstacleContact
from dolfinx_llm.finite.obstacles.pressed_obstacle import Pressed
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.motions import left_by_supports
from dolfinx_llm.operators.numbering import BodyDofs


def falling(
    dofs: BodyDofs,
    interfaces: Sequence[Placed],
    status: Sequence[Array],
    asks: Sequence[bool],
    touched: Sequence[bool],
) -> list[int]:
    """Which of the interfaces asked for have touched, or have a body or an obstacle under a force
    that nothing holds, nor any other that touch leads to; collective.

    Args:
        dofs: of the bodies.
        interfaces: all there are.
        status: (n,) of the pairs of each.
        asks: which of them are asked for.
        touched: which of them did where the increment starts: an iterate has taken them apart.
    """
    if not any(asks):
        return []
    bodies = Bodies(dofs.spaces, dofs.of_nodes)
    label = dofs.spread(bodies.label.astype(float))
    of = np.zeros((len(interfaces), bodies.count), dtype=bool)
    for row, placed in zip(of, interfaces, strict=True):
        row[dofs.values(placed.numbers, label).astype(int)] = True
    touch = np.array([bool(now.any()) for now in status])
    pressed = np.array([_is_pressed(placed.what) for placed in interfaces])
    rigid = np.array([isinstance(placed.what, ObstacleContact) for placed in interfaces])
    stands = of[touch & rigid & ~pressed].any(axis=0)
    stands[np.setdiff1d(np.arange(bodies.count), left_by_supports(bodies, dofs.fixed)[0])] = True
    meets = csr_matrix(of[touch].astype(float))
    _, group = connected_components(meets.T @ meets, directed=False)
    falls = (np.bincount(group, stands) == 0.0)[group]
    falls_on = of[:, falls].any(axis=1) | pressed
    return [i for i, a in enumerate(asks) if a and (touched[i] or falls_on[i])]


def _is_pressed(contact: Any) -> bool:
    """Whether it is with an obstacle under a force or moment."""
    return isinstance(contact, Pressed) and len(contact.axes) > 0
