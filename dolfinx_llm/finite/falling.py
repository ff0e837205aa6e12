"""Bodies and obstacles that would fall: neither supports nor contact hold them. Their nearest pairs
touch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.finite.load_step import Placed
from dolfinx_llm.finite.obstacles.pressed_obstacle import Pressed
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.numbering import BodyDofs


def falling(
    dofs: BodyDofs,
    interfaces: Sequence[Placed],
    status: Sequence[Array],
    asks: Sequence[bool],
    touched: Sequence[bool],
) -> list[int]:
    """Which of the interfaces asked for have touched, or have a body or an obstacle under a force
    that nothing holds, as they and all others there touch nowhere; collective.

    Args:
        dofs: of the bodies.
        interfaces: all there are.
        status: (n,) of the pairs of each.
        asks: which of them are asked for.
        touched: which of them did where the increment starts: an iterate has taken them apart.
    """
    if not any(asks):
        return []
    bodies = Bodies(dofs.spaces)
    whole = dofs.fixed[dofs.of_nodes].reshape(-1, dofs.components).all(axis=1)
    held = dofs.comm.allreduce(np.bincount(bodies.label[whole], minlength=bodies.count))
    label = dofs.spread(bodies.label.astype(float))
    of = np.zeros((len(interfaces), bodies.count), dtype=bool)
    for row, placed in zip(of, interfaces, strict=True):
        row[dofs.values(placed.numbers, label).astype(int)] = True
    touch = np.array([bool(now.any()) for now in status])
    falls = (held < dofs.gdim) & ~of[touch].any(axis=0)
    falls_on = of[:, falls].any(axis=1) | [isinstance(i.what, Pressed) for i in interfaces]
    return [i for i, a in enumerate(asks) if a and (touched[i] or falls_on[i])]
