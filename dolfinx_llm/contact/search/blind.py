"""Friction that the ties of an interface cannot pass, whatever presses.

The frame balances node by node. One of its nodes that ties of one side alone reach moves with that
side, and where contact is about one facet wide, all may do so: the frame then follows both bodies
as they slide past each other, sticks, and no force is wrong, as there is none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import hstack, identity

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.sparse import diagonal, symmetric_factors
from dolfinx_llm.contact.equations.state import InterfaceState

RESISTS = 1e-6  # of ties that stretch with the bodies: what resists a slip less resists none
HELD_LOOSELY = 1e-6  # of that, by which what no tie reaches is held
BLIND = 5e-2  # of the normal force, most where no friction passes
BEARS_LITTLE = 1e-2  # of the largest force: an interface that bears less may be without


def blind_share(s: InterfaceState, multiplier: Array) -> float:
    """Share of an interface's normal force where a slip of the bodies along each other stretches no
    tie: the frame yields to it, and there is no friction.

    Args:
        s: the interface.
        multiplier: λ (n,) of all [force].
    """
    nodes, others = s.nodes, s.others
    pressed = np.maximum(nodes.L_normal @ multiplier[nodes.rows].ravel(), 0.0)
    speaks = others.speaker == np.arange(len(pressed))
    weight = np.where(speaks, others.sums @ pressed, 0.0)
    if not s.shares or not weight.any():
        return 0.0
    # Rows that are left out count: supports bear what acts along them.
    rows = np.repeat(s.tied[:, None], nodes.rows.shape[1], axis=1)
    rows[:, -1] = False
    q, n_v = nodes.kappa.shape[1], len(nodes.v)
    follow = nodes.L @ others.frame_gather.T, nodes.L_kappa @ others.gather.T
    L = hstack(follow, format="csr")[rows.ravel()]
    holds = RESISTS * np.append(np.zeros(n_v), np.repeat(weight / weight.sum(), q))
    squares = L.T @ L + diagonal(holds)
    factors = symmetric_factors(squares + RESISTS * HELD_LOOSELY * identity(len(holds)))
    shares = []
    for i in range(q):
        along = np.zeros(len(holds))
        along[n_v + i :: q] = holds[n_v + i :: q]
        shares.append(along @ factors.solve(along) / along.sum())
    return float(max(shares))


def require_sight(states: Sequence[InterfaceState], multiplier: Array) -> None:
    """Refuse a state whose friction is none because ties cannot pass any.

    Args:
        states: of all interfaces.
        multiplier: λ (n,) of all [force].

    Raises:
        ContactError: it is.
    """
    little = BEARS_LITTLE * np.abs(multiplier).max(initial=0.0)
    for s in states:
        if np.abs(multiplier[s.nodes.rows][:, -1]).sum() <= little:
            continue
        if (share := blind_share(s, multiplier)) > BLIND:
            raise ContactError(
                f"interface {s.nodes.geometry.interface.name}: no friction passes where "
                f"{share:.1%} of the normal force does (allowed {BLIND:.0%}), as the frame's nodes "
                "there follow one body alone: contact is small beside facets. Use a finer mesh "
                "where bodies touch, on the coarser side first"
            )
