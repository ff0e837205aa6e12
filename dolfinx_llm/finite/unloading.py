"""Load steps that take all load off bodies which contact alone holds.

Without load contact holds nothing: nothing resists what bodies do as a whole then, and iterates
would go where rounding drives them. Weak springs that count from the last iterate, as of the
proximal point algorithm (Rockafellar 1976), let them stay: they bear nothing once it is at rest.
With all but a hundredth of the load friction holds them still; what is left goes without.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeGuard

import numpy as np
from mpi4py import MPI

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.finite.falling import HARDLY_HELD, held_by_contact_alone, on_bodies
from dolfinx_llm.finite.load_step import Equations, LoadStep, NewtonState
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.motions import left_by_supports

NEARLY_ALL = 0.99  # of a load, up to which it goes with friction
LEFT_OVER_LOAD = 0.05  # of what bore bodies, to which it has gone with nearly all of the load
BEARS_IT = 1e-6  # of the largest force of contact, from which on their sum bears a body
NO_LOAD = 1e-9  # of what bears a body at the start of a step, that does not load it


def freed(steps: Equations, step: LoadStep) -> Array | None:
    """(n_local,) the dofs of bodies that supports do not hold, that contact bears at the start of a
    step, and that have no load at its end, 1 and 0; None: there are no such bodies, or it is not
    looked for, in time and with follower loads. Collective."""
    if steps.bodies.in_time or steps.followers or not any(p.what.parts for p in steps.interfaces):
        return None
    dofs, start = steps.bodies.dofs, step.start
    mine = [float(np.abs(a).max(initial=0.0)) for a in (start.pushed, step.unbalanced)]
    pushed, changed = np.max(dofs.comm.allgather(mine), axis=0)
    if not changed > BEARS_IT * pushed > 0.0:  # as where supports alone move
        return None
    bodies = Bodies(dofs.spaces, dofs.of_nodes)
    of, parts = left_by_supports(bodies, dofs.fixed)
    on = on_bodies(bodies, dofs, steps.interfaces)
    loose = held_by_contact_alone(on, steps.interfaces, of)
    if not loose.any():
        return None
    bears, loads = start.pushed[bodies.dofs], (start.pushed + step.unbalanced)[bodies.dofs]
    label, work = np.repeat(bodies.label, bodies.components), np.zeros((2, 2, bodies.count))
    for k, moved in enumerate((0.0, 1.0)):
        x = bodies.points + moved * start.u[bodies.dofs].reshape(bodies.points.shape)
        modes = bodies.own_modes(bodies.label, x).reshape(-1, bodies.ways)
        both = np.zeros((2, bodies.count, bodies.ways))
        for total, force in zip(both, (bears, loads), strict=True):
            np.add.at(total, label, modes * force[:, None])
        along = np.einsum("akw,kw->ak", bodies.comm.allreduce(both)[:, of], parts)
        for most, found in zip(work[k], np.abs(along), strict=True):
            np.maximum.at(most, of, found)
    # Internal forces have no moment about where nodes are, of bodies that are linear as drawn.
    bore, load = work.min(axis=0)
    presses = np.zeros(bodies.count)
    np.maximum.at(presses, label, np.abs(bears))
    bodies.comm.Allreduce(MPI.IN_PLACE, presses, op=MPI.MAX)
    empty = loose & (bore > BEARS_IT * presses) & (load <= NO_LOAD * bore)
    return dofs.spread(1.0 * empty[bodies.label]) if empty.any() else None


def let_go(
    of: Array | None, start: NewtonState, now: NewtonState, comm: MPI.Comm
) -> TypeGuard[Array]:
    """Whether what bore bodies goes with their load: others, or supports, may press on them, too;
    collective.

    Args:
        of: as of ``freed``.
        start, now: of the load step, and with nearly all of the load off.
        comm: of the bodies.
    """
    if of is None:
        return False
    mine = [float(np.abs(state.pushed[of > 0.0]).max(initial=0.0)) for state in (start, now)]
    before, after = np.max(comm.allgather(mine), axis=0)
    return bool(after <= LEFT_OVER_LOAD * before)


def held_by_springs(steps: Equations, of: Array) -> Equations:
    """The same with weak springs at some dofs, and without friction on their bodies, where it would
    be rounding's; collective.

    Args:
        steps: with the bodies' stiffness as it is now.
        of: (n_local,) as of ``freed``.
    """
    on_them = [placed.values(steps.bodies.dofs, of).any() for placed in steps.interfaces]
    smooth = [
        replace(placed, what=placed.what.reading({"mu": 0.0 * m, "cohesive": 0.0 * m}))
        if on and (m := getattr(placed.what, "mu", None)) is not None
        else placed
        for on, placed in zip(on_them, steps.interfaces, strict=True)
    ]
    return replace(steps, interfaces=smooth, springs=HARDLY_HELD * steps.scale * of)
