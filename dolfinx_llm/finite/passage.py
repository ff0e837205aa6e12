"""Where nodes have gone in an increment: through the frame, through another body or an obstacle,
or over the frame's edge.

An increment that carries a body wholly through another leaves no node behind a facet: what tells of
it are the states between, with all nodes on straight ways, and how deep they go into closed
outlines.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.finite.frame.crossing import CROSSED
from dolfinx_llm.finite.frame.location import INSIDE
from dolfinx_llm.finite.frame.self_sides import SelfSides
from dolfinx_llm.finite.frame.sides import Sides
from dolfinx_llm.finite.obstacles.obstacle_contact import ObstacleContact
from dolfinx_llm.finite.pairs.normal_contact import OVER, NormalPlace
from dolfinx_llm.finite.pairs.terms import ContactTerms, MovingContact, Place
from dolfinx_llm.geometry.cells import areas_around, cell_sizes, outline_edges
from dolfinx_llm.geometry.facing import TURN
from dolfinx_llm.interface.against import checked_clearance
from dolfinx_llm.interface.supports import HELD_IN

AHEAD = 0.5  # of a facet: no deeper lies what is in front of the frame at first
THROUGH = 1.0  # of a facet: deeper lies what has gone through it
BORE = 1e-9  # of the largest force, below which there is none
INTO = 0.2  # of a facet: no deeper in an obstacle has been what has not gone through it
FINE = 0.1  # of a facet, by which nodes move between the states looked at beside obstacles
STRIDE = 0.5  # of a facet, at most, by which nodes move between the states looked at
LOOKED_AT = 100  # states, at most: bodies that go farther are looked at more seldom
ANGLES = 1_000_000  # pairs of points and facets that are looked at together

Reached = tuple[Array, Array, Array]  # coordinates, own unknowns, what places an obstacle


def winding(x: Array, y: Array, facets: Array) -> Array:
    """(n,) how often a closed outline goes round points: 1 within it, 0 outside.

    Args:
        x: (n, gdim) points, not on the outline.
        y: (m, gdim) nodes of the outline.
        facets: (f, k) its facets; quads count as two triangles.
    """
    found = np.zeros(len(x))
    if facets.shape[1] == 4:
        facets = np.concatenate([facets[:, [0, 1, 2]], facets[:, [0, 2, 3]]])
    for points in np.array_split(np.arange(len(x)), len(x) * len(facets) // ANGLES + 1):
        a = y[facets] - x[points][:, None, None]  # (p, f, k, gdim)
        if facets.shape[1] == 2:
            (ax, ay), (bx, by) = np.moveaxis(a[:, :, 0], 2, 0), np.moveaxis(a[:, :, 1], 2, 0)
            angle = np.arctan2(ax * by - ay * bx, ax * bx + ay * by)
            found[points] = angle.sum(axis=1) / (2.0 * np.pi)
            continue
        # A. van Oosterom and J. Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125-126.
        size = np.linalg.norm(a, axis=3)
        dots = np.einsum("pfki,pfki->pfk", np.roll(a, -1, axis=2), np.roll(a, -2, axis=2))
        below = size.prod(axis=2) + (dots * size).sum(axis=2)
        volume = np.einsum("pfi,pfi->pf", a[:, :, 0], np.cross(a[:, :, 1], a[:, :, 2]))
        found[points] = 2.0 * np.arctan2(volume, below).sum(axis=1) / (4.0 * np.pi)
    return np.abs(found)


def depth(x: Array, y: Array, facets: Array) -> Array:
    """(n,) distance of points within a closed outline from its nodes, 0 outside [length].

    Args:
        x, y, facets: as of ``winding``.
    """
    found = np.zeros(len(x))
    near = np.flatnonzero(((x > y.min(axis=0)) & (x < y.max(axis=0))).all(axis=1))
    within = near[winding(x[near], y, facets) > 0.5]
    found[within] = cKDTree(y).query(x[within])[0]
    return found


def deepest(x: tuple[Array, Array], y: tuple[Array, Array], facets: Array) -> tuple[Array, float]:
    """(n,) how deep nodes go into a body on the way to a state, beyond where they were at first,
    and the size of its facets [length].

    Args:
        x: (n, gdim) nodes at the start and at the end [length].
        y: (m, gdim) nodes of the other body's outline then.
        facets: (f, k) of the outline; nothing is found where it is not closed.
    """
    size = float(cell_sizes(y[0], facets).max())
    went = [np.linalg.norm(b - a, axis=1).max(initial=0.0) for a, b in (x, y)]
    if sum(went) < size or len(outline_edges(facets)):
        return np.zeros(len(x[0])), size
    at_first, found = depth(x[0], y[0], facets), np.zeros(len(x[0]))
    for t in np.linspace(0.0, 1.0, min(LOOKED_AT, int(sum(went) / (STRIDE * size))) + 1)[1:]:
        (p, q) = (a + t * (b - a) for a, b in (x, y))
        found = np.maximum(found, depth(p, q, facets))
    return np.where(found > at_first, found, 0.0), size


def check_passage(contact: MovingContact, before: Place, after: Place) -> None:
    """Require that what was in front of the frame does not lie behind it, and has not gone through
    a closed outline: contact that was far at the start of an increment is not looked for during it.

    Args:
        contact: an interface.
        before, after: how its pairs stand at the start and at the end of an increment.

    Raises:
        ContactError: nodes have passed the frame by more than a facet; the same on every rank.
    """
    if not isinstance(before, NormalPlace) or not isinstance(after, NormalPlace):
        return
    sides, at = contact.sides, after.at
    size = _sizes(sides, after)
    behind = at.met & (at.beyond <= INSIDE) & (at.gap < -THROUGH * size) & _ahead(sides, before)
    if behind.any():
        worst = int(np.where(behind, at.gap / size, 0.0).argmin())
        moving, frame = sides.mover, sides.carrier
        x = sides.split(after.z)[0][worst] + moving.origin
        raise ContactError(
            f"bodies pass through each other: {behind.sum()} node(s) of {moving.name} have gone "
            f"through {frame.name}, the deepest, at {checks.place(x)}, by "
            f"{-at.gap[worst]:.3g} where facets have the size {size[worst]:.3g}"
        )
    if isinstance(sides, SelfSides):
        allowed = THROUGH if contact.overlaps else CROSSED
        sides.check_crossed(sides.split(after.z)[0], allowed)
    else:
        _check_outlines(sides, before, after)


def _check_outlines(sides: Sides, before: Place, after: Place) -> None:
    """Require that no node has gone through the other surface where that is closed."""
    start, end = sides.split(before.z), sides.split(after.z)
    both = sides.mover, sides.carrier
    for k, (one, hit) in enumerate((both, both[::-1])):
        x, y = (start[k], end[k]), (start[1 - k], end[1 - k])
        deep, size = deepest(x, y, hit.facets)
        if deep.max(initial=0.0) > THROUGH * size:
            worst = int(deep.argmax())
            place = end[k][worst] + hit.origin
            raise ContactError(
                f"bodies pass through each other: {(deep > THROUGH * size).sum()} node(s) of "
                f"{one.name} go through {hit.name} on their way, whose outline is "
                f"closed; the deepest, on its way to {checks.place(place)}, by "
                f"{deep[worst]:.3g} where facets have the size {size:.3g}"
            )


def _sizes(sides: Sides, place: NormalPlace) -> Array:
    """(n,) size of the frame's facet under each node [length]."""
    return cell_sizes(sides.split(place.z)[1], sides.carrier.facets)[place.at.facet]


def _ahead(sides: Sides, place: NormalPlace) -> Array:
    """(n,) which nodes lie in front of the frame, and face it."""
    at = place.at
    vectors = areas_around(sides.split(place.z)[0], sides.mover.skin)
    cosine = np.einsum("ni,ni->n", vectors, at.normal) / np.linalg.norm(vectors, axis=1)
    there = at.met & (at.beyond <= INSIDE) & (cosine < -np.cos(TURN))
    return there & (at.gap > -AHEAD * _sizes(sides, place))


def check_obstacle(contact: ObstacleContact, ends: tuple[Reached, Reached], after: Place) -> None:
    """Require that what has turned its back on an obstacle, or lies beyond it, has not gone through
    it, on straight ways as the obstacle sees them.

    Args:
        contact: an interface.
        ends: coordinates, own unknowns and what places the obstacle, at the start and at the end of
            an increment.
        after: how its pairs stand at the end.

    Raises:
        ContactError: nodes have gone through it; the same on every rank.
    """
    surface = contact.sides.surfaces[0]
    start, end = (
        contact.posed(contact.placing(pose, q)).back(contact.sides.split(z)[0])
        for z, q, pose in ends
    )
    size = np.zeros(len(start))  # as drawn: what is pressed in stretches facets
    np.maximum.at(size, surface.skin, cell_sizes(surface.x, surface.skin)[:, None])
    far = np.linalg.norm(end - start, axis=1)
    beyond = np.flatnonzero(np.isinf(after.gap) & (far > 0.0))
    if not len(beyond):
        return

    def deep(X: Array) -> Array:
        """How deep nodes are in the obstacle at X, over the size of their facets."""
        clearance = checked_clearance(contact.obstacle, X)[0] - contact.rise[beyond]
        return np.asarray(-clearance / size[beyond])

    start, end = start[beyond], end[beyond]
    outside = deep(start) < INTO
    found, states = np.full(len(beyond), -np.inf), far[beyond].max() / (FINE * size[beyond].min())
    for t in np.linspace(0.0, 1.0, min(LOOKED_AT, int(states)) + 2)[1:]:
        found = np.maximum(found, np.where(outside, deep(start + t * (end - start)), -np.inf))
    if found.max() > INTO:
        worst = int(found.argmax())
        x = contact.sides.split(after.z)[0][beyond[worst]]
        raise ContactError(
            f"bodies pass through each other: {(found > INTO).sum()} node(s) of {surface.name} "
            f"have gone through the {type(contact.obstacle).__name__}, the deepest, now at "
            f"{checks.place(x)}, by {found[worst]:.2g} of its facet"
        )


def check_held(contact: MovingContact, after: ContactTerms) -> None:
    """Require that supports do not hold both sides where the law forbids: no force moves them.

    Args:
        contact: an interface.
        after: of an equilibrium.

    Raises:
        ContactError: pairs are in each other, or ties torn, by more than chords of facets are; the
            same on every rank.
    """
    off, mover = contact.astray(after.place, after.status), contact.sides.mover
    far = off > HELD_IN * mover.facet_size
    if not far.any():
        return
    worst = int(off.argmax())
    x = contact.sides.split(after.place.z)[0][worst] + mover.origin
    raise ContactError(
        f"supports hold both sides at {far.sum()} node(s) between {contact.named}, "
        f"{'in each other' if contact.parts else 'torn apart'} by up to {off[worst]:.3g}, there at "
        f"{checks.place(x)}, and no force of contact moves them. Leave the motion of one side free "
        "there, or prescribe another one"
    )


def left_over_edge(before: Place, force: Array, after: Place) -> Array:
    """(n,) which nodes carried a force at the start of an increment and have left the frame over
    its edge at the end.

    Args:
        before, after: how the pairs of an interface stand there.
        force: own unknowns of the interface at the start; on a moving frame the first (n,) are
            normal forces [force].
    """
    if not isinstance(before, NormalPlace) or not isinstance(after, NormalPlace):
        return np.zeros(len(after.gap), dtype=bool)
    force = force[: len(after.gap)]
    bore = (force > BORE * force.max(initial=0.0)) & (before.at.beyond <= OVER)
    return bore & (~after.at.met | (after.at.beyond > OVER))
