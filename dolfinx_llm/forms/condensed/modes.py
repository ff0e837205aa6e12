"""Motions that cost a step hardly any energy: near-null spaces, and what supports leave."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_matrix, identity

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import symmetric_factors
from dolfinx_llm.geometry.cells import rigid_modes
from dolfinx_llm.operators.bodies import sliding_ways, two_sides
from dolfinx_llm.operators.control import frame_places
from dolfinx_llm.operators.system import ContactOperators

Modes = tuple[Array, Array]  # at dofs of the bodies (n_local, k), at unknowns w (m, k)
ModesAsked = Callable[[], Modes]  # made when they are asked for: they take as much as k solutions


def rigid_modes_of(operators: ContactOperators) -> Modes:
    """Rigid modes at this rank's dofs of the bodies (n_local, k) and at all unknowns w (m, k),
    about the middle of the scene and of its size, so that far coordinates cost no digits."""
    bodies = operators.bodies
    low, high = bodies.low.min(axis=0), bodies.high.max(axis=0)
    centre, size = 0.5 * (low + high), np.linalg.norm(high - low)
    body = rigid_modes((bodies.points - centre) / size, bodies.components)
    k = body.shape[2]
    modes = np.zeros((operators.unknowns.sizes[1], k))
    for geometry, place in zip(operators.geometries, operators.places, strict=True):
        at, places, directions = place.frame, frame_places(geometry), geometry.directions
        if geometry.rigid and not len(directions):  # bodies slip past it
            at, places = place.slips, geometry.law_nodes[0]
            directions = geometry.jump_directions
            if at.start == at.stop:
                continue
        of = rigid_modes((places - centre) / size, bodies.components)
        modes[at] = np.einsum("mdi,mik->mdk", directions, of).reshape(-1, k)
    return body.reshape(-1, k), modes


def sliding_modes_of(operators: ContactOperators) -> Modes:
    """The same of bodies that slide past each other: what meets along a surface moves by a half to
    one side and to the other.

    Aggregates of GAMG reach across a surface where both sides share the normal motion. Without
    these motions their parts could only move alike, and slip took twice the iterations.
    """
    normals = [
        geometry.normals
        for geometry in operators.geometries
        if not (geometry.rigid or geometry.interface.law.ties or operators.bodies.components == 1)
    ]
    bodies, m = operators.bodies, operators.unknowns.sizes[1]
    none = np.zeros((len(bodies.points) * bodies.components, 0)), np.zeros((m, 0))
    if not normals:
        return none
    n = np.concatenate(normals)
    ways = sliding_ways(n)
    side, sides = _sides_of(operators)
    w = np.zeros((m, ways.shape[1]))
    for geometry, place, of in zip(operators.geometries, operators.places, sides, strict=True):
        if geometry.rigid:
            continue
        carrier = geometry.site.carrier
        moves = 0.25 * of.sum() if carrier is None else 0.5 * of[carrier]
        w[place.frame] = moves * (geometry.directions @ ways).reshape(-1, w.shape[1])
        if place.slips.stop > place.slips.start:
            jumps = (geometry.jump_directions @ ways).reshape(-1, w.shape[1])
            w[place.slips] = geometry.theta * 0.5 * (of[0] - of[1]) * jumps
    body = 0.5 * side[bodies.label, None, None] * ways
    return body.reshape(-1, w.shape[1]), w


def sides_of(operators: ContactOperators) -> Modes:
    """1 or -1 at this rank's dofs of the bodies (n_local,) and at the unknowns w (m,): of bodies on
    either side of what slips. Jumps have the second body's."""
    side, sides = _sides_of(operators)
    w = np.zeros(operators.unknowns.sizes[1])
    for place, of in zip(operators.places, sides, strict=True):
        w[place.frame], w[place.slips] = of
    return operators.dofs.spread(side[operators.bodies.label]), w


def soft_modes_of(operators: ContactOperators) -> Modes:
    """Rigid motions of all, and the sliding of bodies past each other, side by side."""
    modes = rigid_modes_of(operators), sliding_modes_of(operators)
    body, w = zip(*modes, strict=True)
    return np.hstack(body), np.hstack(w)


def _sides_of(operators: ContactOperators) -> tuple[Array, Array]:
    """Per body, and per interface and its sides (interfaces, 2), 1 or -1: bodies that are tied are
    on one side, bodies that meet on both, as far as there are two sides to all of it."""
    dofs, count = operators.dofs, operators.bodies.count
    labels = dofs.spread(operators.bodies.label)
    of_sides = dofs.values(np.array([at[0, 0] for at in operators.side_dofs]), labels)
    pairs = np.array([len(geometry.pairs) == 2 for geometry in operators.geometries])
    ends = [(place.sides.start, place.sides.stop - 1) for place in operators.places]
    meet = of_sides[np.array(ends)].astype(np.int64)
    ties = np.array([geometry.interface.law.ties for geometry in operators.geometries])

    ties, meets = meet[ties & pairs], meet[~ties & pairs]
    side = two_sides(count, ties, meets)
    return side, side[meet]


def weak_motions(operators: ContactOperators, L: csr_matrix) -> ModesAsked | None:
    """Rigid motions that supports alone do not hold firmly of bodies (n_local, k), and of frames
    (m, k), which rows see by L (n, m); None where ties hold all."""
    if operators.tied:
        return None
    rigid = operators.floating.rigid.modes
    frame = np.zeros((L.shape[1], rigid.shape[1]))
    if frame.size:
        fit = symmetric_factors(L.T @ L + 1e-10 * identity(L.shape[1]))
        frame = fit.solve((L.T @ operators.floating.G).toarray())
    return lambda: (rigid.toarray(), frame)
