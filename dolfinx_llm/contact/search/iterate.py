"""What one iteration of contact laws has found, and what interfaces take over of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.contact.equations.equations import Equations
from dolfinx_llm.contact.equations.state import InterfaceState
from dolfinx_llm.contact.search.flickering import count
from dolfinx_llm.forms.step import SIGN, StepResult, unless_none
from dolfinx_llm.laws.answers import at_nodes
from dolfinx_llm.laws.rows import OPEN, SLIP, STICK

ENOUGH = 1e-10  # of the largest force: less may be left where that falls no more, and is not felt
ALL_BUT = 1.01  # times what the proximal term carries: nothing else is left
LIGHT = 1e-3  # of the largest force: pairs with less are at the rim of contact


@dataclass(frozen=True, eq=False)
class Iterate:
    """What one iteration has found."""

    result: StepResult
    position: Array  # (n,) y + g of the bodies at all rows [length]
    slid: Array  # (m,) w with the slips about which laws are linearised next [length]
    largest: float  # force, or what stands for it where bodies hardly touch [force]
    changes: int  # of what is in contact, sticks and slips, as far as they matter
    miss: float  # of balance and laws, over the largest force
    drawn: float  # that the proximal term carries, the same

    @property
    def multiplier(self) -> Array:
        """(n,) λ [force]."""
        return self.result.multiplier

    @property
    def drifts(self) -> bool:
        """Frame nodes that drift, which the proximal term alone holds, are all that is left."""
        return self.miss <= ALL_BUT * self.drawn

    @property
    def w(self) -> Array:
        """(m,) frame and slip unknowns [length]."""
        return self.result.w

    @cached_property
    def borne(self) -> Array:
        """(n,) λ but for what is rounding [force]."""
        force = self.multiplier
        return np.where(np.abs(force) > SIGN * self.largest, force, 0.0)


def take_over(s: InterfaceState, equations: Equations, found: StepResult, calmed: bool) -> int:
    """Take over the pairs of an interface in contact, and find what sticks and slips; number of
    changes that matter."""
    rows, own = s.nodes.rows, s.own
    normal = rows[:, -1]
    chosen = found.active[normal] ^ found.wrong[normal] if s.law.opens else own.active
    changed, force = chosen != own.active, np.abs(found.multiplier)
    largest = unless_none(float(force.max(initial=0.0)), equations.least)
    light = force[normal] <= LIGHT * largest
    count(s, chosen, found.wrong[normal], light)
    s.touch(chosen)
    # What carries nothing changes to no effect. A sign that is wrong has to change, also where
    # its pair then is as it was.
    felt = changed & (force[rows].max(axis=1) > equations.felt * largest)
    changes = int((felt | found.wrong[normal]).sum())
    if s.nodes.kappa.size:
        changes += _follow(s, equations, found, calmed, largest)
    return changes


def _follow(
    s: InterfaceState, equations: Equations, found: StepResult, calmed: bool, largest: float
) -> int:
    """Take over what sticks and slips on an interface; the number of changes that matter."""
    with collective(s.nodes.comm):
        stake = at_nodes(s.law, "at_stake", s.at(found.multiplier, found.w, equations.scale))
    # Nodes that stick at the limit of a slip that has ended may take either status: rounding, or
    # what holds frames for now, may tell which.
    felt = stake > max(equations.felt, ENOUGH) * largest
    now = equations.law_rows(s, found.multiplier, found.w, calmed)
    differs = ((now.status != s.own.status) & felt) | (now.holds != s.own.holds)
    s.take(now)
    return int(differs.sum())


def entry(number: int, states: list[InterfaceState], now: Iterate) -> dict[str, Any]:
    """Of the history: numbers of pairs in contact, of those that stick and slip, of changes."""
    status = np.concatenate([s.pair_status() for s in states])
    of = [int((status == one).sum()) for one in (OPEN, STICK, SLIP)]
    counts = {"active": len(status) - of[0], "stick": of[1], "slip": of[2], "changes": now.changes}
    return {"iteration": number, **counts, "residual": now.miss}
