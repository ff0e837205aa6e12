"""Second tries of increments, by damped iterations, of bodies that friction alone holds.

Where they are is not told by what presses on them: an iterate that slips too far may come to an
equilibrium farther on, or to none, though friction holds them close by. Springs that count from
the last iterate, in proportion to what is left of the forces (Levenberg 1944), keep iterates near.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import told
from dolfinx_llm.finite.falling import held_by_contact_alone, on_bodies
from dolfinx_llm.finite.increment import Increment
from dolfinx_llm.finite.load_step import Equations
from dolfinx_llm.finite.pairs.terms import Place
from dolfinx_llm.laws.rows import OPEN, SLIP
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.motions import left_by_supports

FAR_SLIP = 1.0  # facets that every pair on a body slips in an increment, the least of them
SLID_ALONG = 2.0  # times how far supports go, that bodies slip which they drive


@dataclass(frozen=True, eq=False)
class Arrived:
    """An increment at its end, where bodies can have come to."""

    run: Increment
    before: list[Place]  # how pairs stood at its start
    status: tuple[Array | None, ...]  # of the pairs of each interface there; None: not known
    rests: bool  # it has needed no iteration
    left: list[Array]  # per interface (n,) which nodes have left the other side over its edge
    far: float  # how far bodies have gone [length]
    driven: float  # how far supports and obstacles have; inf: they turn [length]
    alone: bool  # these alone moved bodies


def rubbing(steps: Equations) -> list[int]:
    """Which interfaces have friction, on bodies that contact alone holds; none in time, where
    inertia does. Collective."""
    rubs = [getattr(placed.what, "mu", None) is not None for placed in steps.interfaces]
    if steps.bodies.in_time or not any(rubs):
        return []
    dofs = steps.bodies.dofs
    bodies = Bodies(dofs.spaces, dofs.of_nodes)
    on = on_bodies(bodies, dofs, steps.interfaces)
    left = left_by_supports(bodies, dofs.fixed)[0]
    loose = held_by_contact_alone(on, steps.interfaces, left)
    return [i for i, rub in enumerate(rubs) if rub and on[i, loose].any()]


def slid_away(steps: Equations, found: Arrived) -> str:
    """Words where all pairs in contact of one of ``rubbing``'s interfaces have slipped by facets,
    and farther than supports and obstacles go, as where a body has gone past where friction holds
    it; else none. Collective."""
    if steps.bodies.in_time:
        return ""
    run, gone = found.run, dict[int, str]()
    for i, (placed, t, held) in enumerate(zip(steps.interfaces, run.terms, run.held, strict=True)):
        closed = t.status != OPEN
        if not closed.any() or (t.status[closed] != SLIP).any():
            continue
        slip = np.linalg.norm(placed.what.slip(t.place, held, closed, None), axis=1)
        least, mover = float(slip[closed].min()), placed.what.sides.mover
        if least > FAR_SLIP * mover.facet_size + SLID_ALONG * found.driven:
            gone[i] = (
                f"all of {mover.name} in contact has slipped, by {least:.3g} at least, where "
                f"facets are {mover.facet_size:.3g} large"
            )
    gone = told(steps.bodies.dofs.comm, gone)
    rubs = rubbing(steps) if gone else []
    return next((words for i, words in gone.items() if i in rubs), "")
