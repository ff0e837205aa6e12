"""Nodes of friction whose motion supports prescribe: no motion tells their forces there.

What slips has the force of its law. What is at rest keeps the one that it had at the start of the
load step, as far as the law allows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.contact.equations.state import InterfaceState
from dolfinx_llm.laws.rows import OPEN, STICK, LawNodes, LawRows

FIRM = 1e11  # of the bodies' stiffness: what supports set against slip
UNMOVED = 1e-9  # part of the largest motion up to which slip that supports prescribe is none


def told(
    s: InterfaceState, multiplier: Array, start: Array, w: Array, c: float
) -> tuple[LawNodes, Array]:
    """What an interface's law is told of its nodes, and those (k,) that supports keep at rest.

    Args:
        s: the interface.
        multiplier: λ (n,) [force].
        start: the same at the start of the load step.
        w: (m,) frame and slip unknowns [length].
        c: stiffness of the surfaces [force / length].
    """
    at = s.at(multiplier, w, c)
    if not s.law.slips or s.law.gives or not s.nodes.led.any():
        return at, np.zeros(len(at.x), dtype=bool)
    slip = np.linalg.norm(at.slip, axis=1)
    rests = s.nodes.led & (slip <= UNMOVED * np.abs(w).max(initial=0.0))
    force = np.where(rests[:, None], s.at(start, w, c).force, at.force)
    jump = np.where(rests[:, None], at.before, at.jump)
    return replace(at, force=force, jump=jump), rests


def rows_of(
    s: InterfaceState, multiplier: Array, start: Array, w: Array, c: float, trust: float
) -> LawRows:
    """Rows of an interface's law about λ and w, arguments as of ``told``; trust as of
    ``newton_rows``."""
    at, rests = told(s, multiplier, start, w, c)
    firm = np.where(s.law.slips & s.nodes.led & ~rests, FIRM, 1.0)
    rows = s.rows_at(replace(at, c=at.c * firm, trust=trust)).scaled(at.c)
    if not s.law.slips or s.law.gives or not (s.nodes.led.any() or rests.any()):
        return rows
    # Nothing in contact reaches them: no force would tell their slip.
    reached = s.nodes.reached(s.own.active).astype(float)
    idle = s.nodes.led & ~(s.others.sums @ reached > 0.0)
    return _at_rest(rows, rests, idle, at.force)


def _at_rest(rows: LawRows, rests: Array, idle: Array, force: Array) -> LawRows:
    """The same, but that nodes at rest (k,) keep their forces (k, q), as far as the law lets them,
    and that idle ones (k,) are open, whatever their jumps."""
    kept = force - np.einsum("nij,nj->ni", rows.C_T, force) + rows.rhs
    kept = np.where((rows.status == STICK)[:, None], force, kept)
    at, none = (rests | idle)[:, None, None], idle[:, None]
    return replace(
        rows,
        status=np.where(idle, OPEN, rows.status),
        C_T=np.where(at, np.eye(force.shape[1]), rows.C_T),
        C_jump=np.where(at, 0.0, rows.C_jump),
        C_N=np.where(none, 0.0, rows.C_N),
        rhs=np.where(none, 0.0, np.where(rests[:, None], kept, rows.rhs)),
    )
