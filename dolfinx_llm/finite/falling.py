"""Bodies and obstacles that would fall: neither supports nor contact hold them. Those pairs touch
that meet first as they do, or where they meet none the nearest ones. Bodies that touch, or are tied
to, each other alone fall together, and so does what an obstacle under a force touches: it holds
none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import collective, told
from dolfinx_llm.finite.load_step import Placed
from dolfinx_llm.finite.obstacles.obstacle_contact import ObstacleContact
from dolfinx_llm.finite.obstacles.pressed_obstacle import Pressed
from dolfinx_llm.laws.rows import OPEN
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.motions import left_by_supports
from dolfinx_llm.operators.numbering import BodyDofs

NEARLY = 1e-6  # of a facet: beyond the gap of pairs that meet first, up to which others do as well
MEETINGS = 4  # of pairs, one after the other, that a body may have to be held by
STANDS = 1e-2  # of the way at first, up to which a body that has met some is held
CLOSES = 10.0  # gaps that it closes so, the same
HARDLY_HELD = 1e-6  # of the stiffness: springs that tell where loads drive what nothing holds


def falling(
    dofs: BodyDofs,
    interfaces: Sequence[Placed],
    status: Sequence[Array],
    asks: Sequence[bool],
    touched: Sequence[bool],
) -> list[int]:
    """Which of the interfaces asked for have touched, or have a body or an obstacle under a force
    that nothing holds, nor any other that touch leads to; collective.

    Args:
        dofs: of the bodies.
        interfaces: all there are.
        status: (n,) of the pairs of each.
        asks: which of them are asked for.
        touched: which of them did where the increment starts: an iterate has taken them apart.
    """
    if not any(asks):
        return []
    bodies = Bodies(dofs.spaces, dofs.of_nodes)
    of = on_bodies(bodies, dofs, interfaces)
    touch = np.array([bool(now.any()) for now in status])
    pressed = np.array([_is_pressed(placed.what) for placed in interfaces])
    rigid = np.array([isinstance(placed.what, ObstacleContact) for placed in interfaces])
    stands = of[touch & rigid & ~pressed].any(axis=0)
    stands[np.setdiff1d(np.arange(bodies.count), left_by_supports(bodies, dofs.fixed)[0])] = True
    falls = without_hold(of[touch], stands)
    falls_on = of[:, falls].any(axis=1) | pressed
    return [i for i, a in enumerate(asks) if a and (touched[i] or falls_on[i])]


def on_bodies(bodies: Bodies, dofs: BodyDofs, interfaces: Sequence[Placed]) -> Array:
    """(interfaces, bodies) which bodies each interface is on; collective."""
    label = dofs.spread(bodies.label.astype(float))
    on = np.zeros((len(interfaces), bodies.count), dtype=bool)
    for row, placed in zip(on, interfaces, strict=True):
        row[dofs.values(placed.numbers, label).astype(int)] = True
    return on


def held_by_contact_alone(on: Array, interfaces: Sequence[Placed], left: Array) -> Array:
    """(bodies,) which neither supports nor ties hold, in some motion as a whole.

    Args:
        on: (interfaces, bodies) as of ``on_bodies``.
        interfaces: all there are.
        left: numbers of the bodies that supports leave motions.
    """
    ties = np.array([not placed.what.parts for placed in interfaces], dtype=bool)
    rigid = np.array([isinstance(placed.what, ObstacleContact) for placed in interfaces], bool)
    stands = on[ties & rigid].any(axis=0)
    stands[np.setdiff1d(np.arange(on.shape[1]), left)] = True
    return without_hold(on[ties], stands)


def without_hold(joins: Array, stands: Array) -> Array:
    """(bodies,) which hang together, by interfaces, with none that stands.

    Args:
        joins: (k, bodies) which bodies each of these interfaces is on.
        stands: (bodies,) which are held by themselves.
    """
    joined = csr_matrix(joins.astype(float))
    _, group = connected_components(joined.T @ joined, directed=False)
    return np.asarray((np.bincount(group, stands) == 0.0)[group])


def flight(
    run: Any, falls: Sequence[int], places: list[Any], status: list[Any], held: list[Any]
) -> dict[int, Array]:
    """Per interface at which bodies fall (n,) gaps up to which pairs touch: those that meet first
    where weak springs alone hold bodies, which so go where their loads drive them, and where that
    turns them about these, those that meet then; collective.

    Args:
        run: an ``Increment``, whose terms and balance are then those of the given pairs.
        falls: the interfaces.
        places, status, held: of the pairs of all, those of ``falls`` open.
    """
    every, size, status, first = run.steps.interfaces, run.steps.size, list(status), 0.0
    reaches = {i: np.full(len(places[i].gap), -np.inf) for i in falls}
    for _ in range(MEETINGS if falls else 0):
        nears = _nearing(run, falls, places, status, held)
        far = max(float(np.abs(near).max(initial=0.0)) for near in nears.values())
        closed = {i: np.where(status[i] != OPEN, places[i].gap, 0.0) for i in falls}
        if first and far < max(STANDS * first, *(CLOSES * g.max() for g in closed.values())):
            break
        least, met = NEARLY * max(size, far), False
        for i, near in nears.items():
            if first and np.abs(near).max(initial=0.0) <= least:
                continue
            gap = np.where(status[i] == OPEN, places[i].gap, np.inf)
            reaches[i] = np.maximum(reaches[i], met_first(gap, near, least) + NEARLY * size)
            of = places[i], 0.0 * run.own[i], np.full(len(gap), OPEN), held[i], reaches[i]
            with collective(run.dofs.comm):
                now = every[i].what.touching(*of)[0]
            met, status[i] = met or bool((now != status[i]).any()), now
        if not met:
            break
        first = first or far
    return reaches


def _nearing(
    run: Any, falls: Sequence[int], places: list[Any], status: list[Any], held: list[Any]
) -> dict[int, Array]:
    """Per interface by how much pairs (n,) near each other where weak springs hold bodies."""
    steps, dofs = run.steps, run.dofs
    run.take(places, status, held)
    run.balance()
    K, springs = steps.bodies.tangent(run.u), np.zeros(len(run.u))
    springs[dofs.of_nodes] = HARDLY_HELD * steps.scale
    try:
        add_springs(K, springs)
        du, changes = run.solved(K, False)
    finally:
        K.destroy()
    every = ((i, steps.interfaces[i]) for i in falls)
    return {i: -p.what.nearing(places[i], p.values(dofs, du), changes[i]) for i, p in every}


def add_springs(K: PETSc.Mat, springs: Array) -> None:
    """Add springs (n_local,) of this rank's dofs to the diagonal of K [force / length]."""
    diagonal = K.getDiagonal()
    diagonal.array[:] += springs
    K.setDiagonal(diagonal)
    diagonal.destroy()


def caught(run: Any, now: list[Any]) -> dict[int, Array]:
    """Where pairs open in the linear model, and bodies fall then, those that meet first touch, of
    each interface once in an increment: the status to solve for next of those where it changes,
    none if bodies do not fall. Collective.

    Args:
        run: an ``Increment``.
        now: (n,) status of the pairs of each interface in the linear model, changed there.
    """
    every, comm = run.steps.interfaces, run.dofs.comm
    terms, before, held = run.terms, run.status, run.held
    touch = [bool(now_of.any()) for now_of in now]
    opened = any(b.any() and not t for b, t in zip(before, touch, strict=True))
    may = opened and not run.steps.bodies.in_time
    of_each = zip(touch, terms, run.drawn, strict=True)
    asks = [may and not (t or drawn) and bool(of.place.pairs.any()) for t, of, drawn in of_each]
    falls = falling(run.dofs, every, now, told(comm, asks), [False] * len(now))
    if not falls:
        return {}
    reaches = flight(run, falls, [t.place for t in terms], list(now), held)
    for i in falls:
        place = terms[i].place
        of = place, 0.0 * run.own[i], np.full(len(place.gap), OPEN), held[i], reaches[i]
        with collective(comm):
            now[i] = every[i].what.touching(*of)[0]
        run.drawn[i] = bool(now[i].any())
    run.terms, run.status, run.held = terms, before, held
    run.balance()
    if not any(run.drawn[i] for i in falls):
        return {}
    return {i: now[i] for i, b in enumerate(before) if (now[i] != b).any()}


def met_first(gap: Array, nears: Array, least: float) -> Array:
    """(n,) gaps up to which pairs touch: those that meet first, the nearest ones where no load
    moves any, or none where all go apart [length].

    Args:
        gap: (n,) of the pairs, inf where there is none [length].
        nears: (n,) by which they near each other in a time [length].
        least: of that, which no load but rounding moves bodies by [length].

    >>> met_first(np.array([0.1, 0.3, 0.2]), np.array([-1.0, 1.0, 0.5]), 1e-9).tolist()
    [-inf, 0.3, 0.15]
    """
    moves = np.isfinite(gap) & (np.abs(nears) > least)
    if not moves.any():
        return np.full(len(gap), gap.min())
    meets, reach = moves & (nears > 0.0), np.full(len(gap), -np.inf)
    reach[meets] = np.min(gap[meets] / nears[meets], initial=np.inf) * nears[meets]
    return reach


def _is_pressed(contact: Any) -> bool:
    """Whether it is with an obstacle under a force or moment."""
    return isinstance(contact, Pressed) and len(contact.axes) > 0
