"""Where all that is prescribed turns alike, bodies turn with it before Newton's iteration begins,
which sees turns as strains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.finite.failures import StepFailed, failing
from dolfinx_llm.finite.load_step import Equations, NewtonState
from dolfinx_llm.finite.obstacles.mean_obstacle import MovingMean
from dolfinx_llm.finite.obstacles.obstacle_contact import ObstacleFriction
from dolfinx_llm.finite.obstacles.pose import Pose
from dolfinx_llm.finite.obstacles.pressed_obstacle import Pressed
from dolfinx_llm.laws.rows import OPEN
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.numbering import BodyDofs

CHORD = 0.8  # rad, by which obstacles with friction turn in an increment at most
RIGID = 1e-9  # of the size of what is prescribed, up to which a rigid motion is one
AT_REST = 1e-6  # turn in radians that is none


@dataclass(frozen=True, eq=False)
class Carrier:
    """An obstacle that leads no dofs."""

    before: Array  # (n, gdim) points on it
    after: Array  # (n, gdim) where it takes them
    held: Array  # dofs of nodes that friction holds on it; none where nothing does


def with_what_turns(
    steps: Equations, good: NewtonState, target: Array, poses: Sequence[Array]
) -> NewtonState | None:
    """The state after the rigid motion by which supports and obstacles go to where they are to be;
    None where there is no such motion, it does not turn, or steps are in time. Collective.

    Args:
        steps: what is solved.
        good: the state that an increment starts from.
        target: (n_local,) of dofs that supports prescribe.
        poses: per interface what places its obstacle there; empty without one.
    """
    given = None if steps.bodies.in_time else _prescribed(steps, good, target, poses)
    found = None if given is None else _turned(steps.bodies.dofs, good.u, *given)
    if found is None:
        return None
    u, R = found
    own = tuple(i.what.carried(q, R) for i, q in zip(steps.interfaces, good.own, strict=True))
    return replace(good, u=u, own=own, poses=tuple(poses))


def _prescribed(
    steps: Equations, good: NewtonState, target: Array, poses: Sequence[Array]
) -> tuple[Array, Array, list[Carrier]] | None:
    """Where supports, and obstacles that bodies are tied to, lead to (n_local,), and which dofs;
    the other obstacles. None where obstacles yield."""
    dofs, goes = steps.bodies.dofs, list[Carrier]()
    fixed, target = dofs.fixed.copy(), target.copy()
    of_each = zip(steps.interfaces, good.poses, poses, good.status, strict=True)
    for placed, before, pose, status in of_each:
        if not len(pose):
            continue
        if led := placed.what.led(pose):
            at = placed.numbers - dofs.first
            mine = led[0] & (at >= 0) & (at < len(fixed)) & placed.free
            fixed[at[mine]], target[at[mine]] = True, (led[1] - placed.drawn)[mine]
        elif isinstance(placed.what, Pressed | MovingMean):
            return None
        else:
            x = placed.at(dofs, good.u).reshape(-1, dofs.gdim)
            then, now = (Pose.of(numbers, dofs.gdim) for numbers in (before, pose))
            presses = status is not None and bool(np.any(status != OPEN))
            rubs = presses and isinstance(placed.what, ObstacleFriction)
            held = placed.numbers if rubs else placed.numbers[:0]
            goes.append(Carrier(x, now.on(then.back(x)), held))
    return target, fixed, goes


def _turned(
    dofs: BodyDofs,
    u: Array,
    target: Array,
    fixed: Array,
    goes: Sequence[Carrier],
) -> tuple[Array, Array] | None:
    """All dofs after the rigid motion that takes prescribed ones to their targets, or where there
    are none obstacles to theirs, and its rotation (gdim, gdim); None where there is no such motion,
    it does not turn, or a body is held neither by as many nodes as tell it nor by friction on an
    obstacle. Collective.

    Args:
        dofs: of the bodies.
        u: (n_local,) where they are.
        target: (n_local,) where prescribed dofs are to be.
        fixed: (n_local,) which they are.
        goes: obstacles that lead no dofs.
    """
    comm, gdim, at = dofs.comm, dofs.gdim, dofs.of_nodes
    X = dofs.points
    x, y = (X + values[at].reshape(X.shape) for values in (u, target))
    fixed = fixed[at].reshape(X.shape)
    whole = fixed.all(axis=1)
    n = comm.allreduce(int(whole.sum()))
    carry = [one for one in goes if len(one.held)]
    if n < gdim and len(carry) < 2:  # one alone may turn below a body that springs hold
        return None
    if n < gdim:
        before = np.concatenate([one.before for one in carry])
        after = np.concatenate([one.after for one in carry])
        a, b = before.mean(axis=0), after.mean(axis=0)
        spread = np.einsum("ni,nj->ij", after - b, before - a)
    else:
        a, b = comm.allreduce(np.array([x[whole].sum(axis=0), y[whole].sum(axis=0)])) / n
        spread = comm.allreduce((y - b)[whole].T @ (x - a)[whole])
    first, size, last = np.linalg.svd(spread)
    first[:, -1] *= np.linalg.det(first @ last)
    R = first @ last
    there = (x - a) @ R.T + b
    left = [(one.before - a) @ R.T + b - one.after for one in goes]
    parts = np.concatenate([(there - y)[fixed], *map(np.ravel, left)]), x - a
    mine = [float(np.abs(part).max(initial=0.0)) for part in parts]
    off, reach = np.max(comm.allgather(mine), axis=0)
    told = size[gdim - 2] > AT_REST * size[0] and np.abs(R - np.eye(gdim)).max() > AT_REST
    if not told or off > RIGID * reach:
        return None
    bodies = Bodies(dofs.spaces)  # one that is not held may stay where it is
    held = comm.allreduce(np.bincount(bodies.label[whole], minlength=bodies.count)) >= gdim
    label = dofs.spread(bodies.label.astype(float))
    for one in carry:
        held[dofs.values(one.held, label).astype(int)] = True
    if not held.all():
        return None
    found = u.copy()
    found[at] = (there - X).ravel()
    return found, R


def check_poses(equations: Equations, run: Any, start: NewtonState) -> None:
    """Require that obstacles with friction turn against bodies by little, as slip is a chord,
    and forces on planes that contact can take; in time what pulls parts after the step. Collective.

    Args:
        equations: what is solved.
        run: an ``Increment`` that starts from ``start``.

    Raises:
        StepFailed: they do not.
    """
    of = zip(equations.interfaces, run.poses, start.poses, run.terms, strict=True)
    for placed, now, before, t in of:
        if isinstance(placed.what, Pressed) and not equations.bodies.in_time:
            with failing(), collective(run.dofs.comm):
                placed.what.check_pressed(t.place, now)
        if isinstance(placed.what, ObstacleFriction) and not run.turned:
            gdim = placed.what.sides.gdim
            turn = (now - before)[2 * gdim : 2 * gdim + (1 if gdim == 2 else 3)]
            if (angle := float(np.linalg.norm(turn))) > CHORD:
                raise StepFailed(
                    f"an obstacle with friction turns by {angle:.3g} rad in an increment, "
                    f"which are to turn it by at most {CHORD:g}"
                )
