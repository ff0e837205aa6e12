"""Whether what a load step ends in depends on the way there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.contact.equations.state import ContactState, InterfaceState
from dolfinx_llm.laws.rows import OPEN, STICK, LawNodes, LawRows

ALIKE_ROWS = 1e-9  # of their size: coefficients of laws that differ by less are the same


def from_the_past(
    states: Sequence[InterfaceState],
    began: Sequence[ContactState],
    multiplier: Array,
    w: Array,
    c: float,
) -> str:
    """What is said of the nodes whose law would be another one, had the last part of the last load
    step begun at rest; empty where there are none.

    Args:
        states: of the interfaces, at the end.
        began: of the same, where that part began.
        multiplier, w: λ (n,) and w (m,) at the end.
        c: stiffness of the surfaces [force / length].
    """
    for s, before in zip(states, began, strict=True):
        if not s.nodes.kappa.size:
            continue
        rest, at = InterfaceState(s.nodes).own, s.at(multiplier, w, c)
        now = replace(at, before=before.kappa_before / s.nodes.theta, history=before.history)
        anew = replace(at, before=np.zeros_like(at.jump), history=rest.history)
        felt = _differ(s.rows_at(now), s.rows_at(anew), now, anew)
        if s.law.slips:  # a jump may vanish by symmetry alone
            felt |= (before.status != STICK) & (s.own.status != OPEN)
            felt |= s.nodes.led
        if felt.any():
            return (
                f"at {int(felt.sum())} of {len(felt)} nodes of interface "
                f"{s.nodes.geometry.interface.name} the law {s.law} goes on from earlier load "
                "steps, or from earlier parts of the last one, and what these left there depends "
                "on the parameters as well"
            )
    return ""


def _differ(one: LawRows, other: LawRows, now: LawNodes, anew: LawNodes) -> Array:
    """(k,) nodes at which two rows say different things of forces and jumps."""
    size, c = np.abs(now.force).max(initial=0.0), now.c
    size = max(size, np.abs(c[:, None] * now.jump).max(initial=0.0))
    parts = [
        (np.abs(one.C_T - other.C_T).max(axis=(1, 2)), 1.0),
        (np.abs(one.C_N - other.C_N).max(axis=1), 1.0),
        (np.abs(one.C_jump - other.C_jump).max(axis=(1, 2)), c),
        (np.abs(_given(one, now) - _given(other, anew)).max(axis=1), size),
    ]
    return np.any([off > ALIKE_ROWS * scale for off, scale in parts], axis=0)


def _given(rows: LawRows, nodes: LawNodes) -> Array:
    """(k, q) right-hand side of rows that are written with whole jumps."""
    return rows.rhs + np.einsum("nij,nj->ni", rows.C_jump, nodes.before)
