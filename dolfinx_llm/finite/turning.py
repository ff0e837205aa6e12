"""Where all that is prescribed turns alike, bodies turn with it before Newton's iteration begins,
which sees turns as strains."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.finite.load_step import Placed
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.numbering import BodyDofs

RIGID = 1e-9  # of the size of what is prescribed, up to which a rigid motion is one
AT_REST = 1e-6  # turn in radians that is none


def prescribed(
    dofs: BodyDofs, target: Array, interfaces: Sequence[Placed], poses: Sequence[Array]
) -> tuple[Array, Array] | None:
    """Where supports, and obstacles that bodies are tied to, lead to (n_local,), and which dofs;
    None where obstacles let go, or yield.

    Args:
        dofs: of the bodies.
        target: (n_local,) of dofs that supports prescribe.
        interfaces: of which some are with obstacles.
        poses: per interface what places its obstacle; empty without one.
    """
    fixed, target = dofs.fixed.copy(), target.copy()
    for placed, pose in zip(interfaces, poses, strict=True):
        if not len(pose):
            continue
        if not (led := placed.what.led(pose)):
            return None
        at = placed.numbers - dofs.first
        mine = led[0] & (at >= 0) & (at < len(fixed)) & placed.free
        fixed[at[mine]], target[at[mine]] = True, (led[1] - placed.drawn)[mine]
    return target, fixed


def turned(dofs: BodyDofs, u: Array, target: Array, fixed: Array) -> tuple[Array, Array] | None:
    """All dofs after the rigid motion that takes prescribed ones to their targets, and its rotation
    (gdim, gdim); None where there is no such motion, it does not turn, or a body is not held by as
    many nodes as tell it. Collective.

    Args:
        dofs: of the bodies.
        u: (n_local,) where they are.
        target: (n_local,) where prescribed dofs are to be.
        fixed: (n_local,) which they are.
    """
    comm, gdim, at = dofs.comm, dofs.gdim, dofs.of_nodes
    X = dofs.points
    x, y = (X + values[at].reshape(X.shape) for values in (u, target))
    fixed = fixed[at].reshape(X.shape)
    whole = fixed.all(axis=1)
    n = comm.allreduce(int(whole.sum()))
    if n < gdim:
        return None
    a, b = comm.allreduce(np.array([x[whole].sum(axis=0), y[whole].sum(axis=0)])) / n
    left, size, right = np.linalg.svd(comm.allreduce((y - b)[whole].T @ (x - a)[whole]))
    left[:, -1] *= np.linalg.det(left @ right)
    R = left @ right
    there = (x - a) @ R.T + b
    mine = [float(np.abs(part).max(initial=0.0)) for part in ((there - y)[fixed], x - a)]
    off, reach = np.max(comm.allgather(mine), axis=0)
    told = size[gdim - 2] > AT_REST * size[0] and np.abs(R - np.eye(gdim)).max() > AT_REST
    if not told or off > RIGID * reach:
        return None
    bodies = Bodies(dofs.spaces)  # one that is not held may stay where it is
    held = comm.allreduce(np.bincount(bodies.label[whole], minlength=bodies.count))
    if (held < gdim).any():
        return None
    found = u.copy()
    found[at] = (there - X).ravel()
    return found, R
