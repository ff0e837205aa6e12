"""Frames and slips that no pair in contact sees, at the end of a load step.

Where few pairs are in contact they do not determine how far single nodes of a frame have slipped: a
pair between two of these tells a mean of both. Friction would remember whatever the iteration left
there once other pairs close. What is not determined is therefore taken from the motion of the
bodies. Nodes that stick have not slipped, whether pairs see them or not. Supports see the frame.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import hstack, identity

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.base.sparse import symmetric_factors
from dolfinx_llm.contact.equations.state import InterfaceState
from dolfinx_llm.laws.answers import at_nodes
from dolfinx_llm.laws.rows import SLIP

NEAR_LIMIT = 1e-4  # of what a node can bear, by which it may be below that
UNSEEN = 1e-6  # of the largest square of what pairs see: less of it is not seen
TIMES = 3  # each makes what pairs see of a change less by that


def of_the_bodies(
    states: Sequence[InterfaceState], multiplier: Array, w: Array, fitted: Array, c: float
) -> Array:
    """(m,) frames and slips w, but for the part of slips that no pair in contact sees, of them and
    the frame's motion together: that is what fits all pairs best. The frame stays, from which open
    pairs have their gaps. Where all are in contact nothing changes.

    Args:
        states: of the interfaces.
        multiplier, w: λ (n,) and w (m,) at the end of a load step.
        fitted: (m,) frames and slips that fit the bodies best.
        c: stiffness of the surfaces [force / length].
    """
    w = w.copy()
    for s in states:
        closed, nodes = s.closed_rows(), s.nodes
        slips = nodes.kappa.size and s.law.opens and s.law.slips
        if not slips or closed[nodes.kept].all():
            continue
        gives_in = np.repeat(_gives_in(s, multiplier, w, c), nodes.kappa.shape[1])
        at = np.concatenate([nodes.v, nodes.kappa.ravel()[gives_in]])
        L = hstack([nodes.L, nodes.L_kappa[:, gives_in]], format="csr")[closed]
        holds = nodes.seen_by(s.at_supports)[s.at_supports]  # of the frame alone
        holds.resize(holds.shape[0], len(at))
        squares = L.T @ L + holds.T @ holds
        least = UNSEEN * (squares.diagonal().max(initial=0.0) or 1.0)
        factors = symmetric_factors(squares + least * identity(len(at)))
        change = fitted[at] - w[at]
        for _ in range(TIMES):
            change = factors.solve(least * change)
        w[at[len(nodes.v) :]] += change[len(nodes.v) :]
    return w


def _gives_in(s: InterfaceState, multiplier: Array, w: Array, c: float) -> Array:
    """(k,) nodes that slip, or bear so much that they stick and slip alike."""
    at = s.at(multiplier, w, c)
    with collective(s.nodes.comm):  # users' laws may fail
        stake, bears = at_nodes(s.law, "at_stake", at), at.sums(at_nodes(s.law, "strength", at))
    alike = (stake <= NEAR_LIMIT * bears)[s.others.speaker]
    return np.asarray((s.own.status == SLIP) | alike)
