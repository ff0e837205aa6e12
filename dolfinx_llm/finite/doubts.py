"""What is to be said of a load step at finite deformation."""

from __future__ import annotations

import numpy as np

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.finite.frame.crossing import crossing
from dolfinx_llm.finite.frame.divided_sides import DividedSides
from dolfinx_llm.finite.frame.location import INSIDE, find_on_frame
from dolfinx_llm.finite.frame.self_sides import SelfSides
from dolfinx_llm.finite.frame.sides import Sides
from dolfinx_llm.finite.frame_side import on_mover
from dolfinx_llm.finite.obstacles.obstacle_contact import ObstacleContact
from dolfinx_llm.finite.pairs.normal_contact import OVER, NormalPlace
from dolfinx_llm.finite.pairs.terms import ContactTerms, MovingContact, Place
from dolfinx_llm.finite.pressure import Follower
from dolfinx_llm.geometry.cells import areas_around, unit, unit_normals
from dolfinx_llm.geometry.drawn import SHARP, edges
from dolfinx_llm.geometry.facing import TURN
from dolfinx_llm.interface.against import checked_clearance
from dolfinx_llm.interface.touching import NEARER, nothing_touches
from dolfinx_llm.laws.rows import OPEN

LEAPS = 10.0  # times as far as supports and obstacles have gone
EDGE_IN = 0.1  # of a facet: deeper do not lie nodes of a frame behind facets that turn
A_FACET = 1.0  # deeper lies what does not touch there
EDGE_AWAY = 0.01  # of a facet: an edge so far off is not what presses beyond it
LEANS = 0.1  # of the force, as it may lean by beside sharp edges that bend what they press
UNSAID = 1e-11  # of a facet, by which what laws ask for is missed without a word, as at any rest
BEYOND_SHARE = 0.01  # of the force on pairs, up to which such nodes do not matter


def leapt(far: float, driven: float) -> list[str]:
    """Of bodies that have gone much farther than what moves them [length]."""
    if far <= LEAPS * driven:
        return []
    return [
        "a body snapped, or nothing but contact holds one, and did not at first: in an increment "
        f"of this load step bodies moved by {far:.2g}, what moves them by {driven:.2g}. There may "
        "be other states. Take smaller steps, or hold it with weak springs"
    ]


def left_over(sides: Sides, left: Array, after: Place) -> list[str]:
    """Of nodes (n,) that have left the frame over its edge."""
    if not left.any():
        return []
    moving, frame = sides.mover.name, sides.carrier.name
    place = sides.split(after.z)[0][np.flatnonzero(left)[0]] + sides.surfaces[0].origin
    return [
        f"{moving} on {frame}: {left.sum()} node(s) of {moving} that carried force have left "
        f"{frame} over its edge in this load step, the first is at {checks.place(place)}: nothing "
        "presses on them there. If the body goes on, tag more of it"
    ]


def uncovered(load: Follower, z: Array, closed: Array, p: float) -> list[str]:
    """Of a follower pressure p that acts on contact as well, where this covers no whole facet.

    Args:
        load: a piece of it.
        z: coordinates [length].
        closed: (n,) as of ``Follower.hold``.
        p: pressure [force / area].
    """
    held = load.hold(z, closed)
    if p == 0.0 or held is None or not closed.any() or held.facets.any():
        return []
    loaded, cover = load.surfaces[0], load.obstacle
    covers = load.surfaces[1].name if cover is None else f"the {type(cover).__name__}"
    return [
        f"FreeSurfacePressure on {loaded.name}: {closed.sum()} node(s) are in contact with "
        f"{covers}, which covers no whole facet there: {p:.3g} acts on all of it, facets of "
        f"{loaded.facet_size:.3g}. Use a finer mesh where they touch"
    ]


def apart(contact: MovingContact, t: ContactTerms) -> list[str]:
    """Of bodies that have come nearer to each other than in the drawing, and touch nowhere."""
    if not contact.parts or (t.status != OPEN).any() or isinstance(contact.sides, SelfSides):
        return []
    drawn = np.concatenate([surface.x.ravel() for surface in contact.sides.surfaces])
    (before, _), (now, where) = (_clearance(contact, z, t.place) for z in (drawn, t.place.z))
    if not now < before - NEARER * contact.sides.surfaces[0].diameter:
        return []
    return [nothing_touches(contact.named, before, now, where)]


def _clearance(contact: MovingContact, z: Array, now: Place) -> tuple[float, Array]:
    """Least distance of two sides at coordinates z, inf where they do not face each other, and
    where that is; of an obstacle as drawn, or where pairs are now."""
    sides = contact.sides
    if isinstance(contact, ObstacleContact):
        x = z.reshape(-1, sides.gdim)
        gap = now.gap if z is now.z else checked_clearance(contact.obstacle, x)[0]
    else:
        x, y = sides.split(z)
        at = find_on_frame(x, y, sides.carrier.cells, sides.outward(z))
        own = unit(areas_around(x, sides.mover.skin))
        faces = np.einsum("ni,ni->n", own, at.normal) < -np.cos(TURN)
        gap = np.where(at.met & (at.beyond < INSIDE) & faces, at.gap, np.inf)
    nearest = int(gap.argmin())
    return float(gap[nearest]), x[nearest] + sides.surfaces[0].origin


def missed(contact: MovingContact, t: ContactTerms, size: float) -> list[str]:
    """Of laws that iterations meet no nearer, by rounding or where supports hold both sides; size
    of facets, by which that is judged."""
    left = np.abs(t.rest).max(initial=0.0) / size
    if left <= UNSAID:
        return []
    return [
        f"{' on '.join(surface.name for surface in contact.sides.surfaces)}: what contact and "
        f"friction ask for stays missed by {left:.0e} of a facet. Where supports hold both sides "
        "in the contact, forces at the nodes are not unique: leave one side free along it"
    ]


def deep(contact: MovingContact, t: ContactTerms) -> list[str]:
    """Of the frame's nodes, as of a sharp edge, that lie behind facets of the other side: pairs are
    the nodes of these alone."""
    sides, place = contact.sides, _on_frame(contact, t)
    if place is None or contact.overlaps:
        return []
    y, cells = sides.split(place.z)[1], sides.mover.cells
    cells = cells[place.pairs[cells].all(axis=1)]
    if not len(cells):
        return []
    at, size = on_mover(sides, place.z, cells), sides.mover.facet_size
    faces = np.einsum("mi,mi->m", sides.outward(place.z), at.normal) < -np.cos(TURN)
    there = at.met & (at.beyond < INSIDE) & faces & (at.gap > -A_FACET * size)
    depth = np.where(there, -at.gap, 0.0)
    worst = int(depth.argmax())
    if depth[worst] <= EDGE_IN * size:
        return []
    frame, moving, count = sides.carrier, sides.mover, (depth > EDGE_IN * size).sum()
    remedy = f"Use smaller facets on {frame.name}"
    if not isinstance(sides, DividedSides):
        remedy += f" than on {moving.name}, so that its nodes are those that touch"
    return [
        f"{moving.name} on {frame.name}: {count} node(s) of {frame.name} are "
        f"in the body of {moving.name}, between its nodes, by up to {depth[worst]:.3g}, there at "
        f"{checks.place(y[worst] + frame.origin)}, where facets have the size {size:.3g}. "
        f"{remedy}, or finer meshes of both"
    ]


def crossed(contact: MovingContact, t: ContactTerms) -> list[str]:
    """Of edges in space that have gone through each other between their nodes, which alone touch
    facets."""
    sides, place = contact.sides, _on_frame(contact, t)
    if place is None or sides.gdim == 2 or contact.overlaps:
        return []
    frame, moving = sides.carrier, sides.mover
    near = place.pairs & (np.abs(place.gap) < A_FACET * moving.facet_size)
    meets = np.isin(frame.facets, frame.cells[place.at.facet[near]]).any(axis=1)
    facets = moving.facets[near[moving.facets].any(axis=1)], frame.facets[meets]
    x = sides.split(place.z)
    found, _, depth = crossing(x, facets)
    if not len(depth):
        return []
    where = x[0][facets[0][found[depth.argmax()]]].mean(axis=0) + frame.origin
    return [
        f"{moving.name} on {frame.name}: facets cross each other, {len(depth)} pair(s) of them, by "
        f"up to {depth.max():.3g} at {checks.place(where)}, where facets have the size "
        f"{moving.facet_size:.3g}: edges meet between their nodes, and press less than they do, "
        "aside as well. Use finer meshes there, or round one of the edges off"
    ]


def beside_edge(contact: MovingContact, t: ContactTerms) -> list[str]:
    """Of pairs that press beyond an edge of the frame, on what its facets go on to there, while the
    edge itself is away from the other side; where facets are cut the edge presses: ``overhang``."""
    sides, place = contact.sides, _on_frame(contact, t)
    if place is None or place.overhang is not None or contact.overlaps:
        return []
    out = (t.status != OPEN) & place.at.met & (place.at.beyond > OVER)
    force = np.linalg.norm(sides.split(t.force)[0], axis=1)
    cells = sides.mover.cells[out[sides.mover.cells].any(axis=1)]
    if not len(cells) or force[out].sum() <= BEYOND_SHARE * force.sum():
        return []
    at, size = on_mover(sides, place.z, cells), sides.mover.facet_size
    edge = np.zeros(len(at.gap), dtype=bool)
    edge[sides.carrier.cells[place.at.facet[out]]] = True
    away = np.where(edge & at.met & (at.beyond < INSIDE), at.gap, 0.0)
    worst = int(away.argmax())
    if away[worst] <= EDGE_AWAY * size:
        return []
    frame, moving = sides.carrier, sides.mover
    return [
        f"{moving.name} on {frame.name}: {out.sum()} node(s) of {moving.name} press beyond an edge "
        f"of {frame.name}, with {force[out].sum() / force.sum():.0%} of the force, on what its "
        f"facets go on to there; the edge is away by up to {away[worst]:.3g} at "
        f"{checks.place(sides.split(place.z)[1][worst] + frame.origin)}, where facets have the "
        f"size {size:.3g}: bodies are pressed as by so much. Use smaller facets on {frame.name} "
        f"than on {moving.name}, so that its nodes are those that touch, or finer meshes of both"
    ]


def edge_leans(contact: MovingContact, t: ContactTerms) -> list[str]:
    """Of an end of the frame that presses facets which hang over it, along the normal of its own
    facet: with an edge alone a body presses along theirs."""
    sides, place = contact.sides, _on_frame(contact, t)
    if place is None or place.overhang is None:
        return []
    x = sides.split(place.z)[0]
    force = np.linalg.norm(sides.split(t.force)[0], axis=1)
    out = (t.status != OPEN) & place.at.met & (place.at.beyond > OVER)
    cells = sides.mover.cells[out[sides.mover.cells].any(axis=1)]
    lean = np.linalg.norm(place.normal + unit(areas_around(x, sides.mover.skin)), axis=1)
    lean = np.where(np.isin(np.arange(len(x)), cells), force * lean, 0.0)
    if lean.sum() <= LEANS * force.sum():
        return []
    frame, moving = sides.carrier, sides.mover
    return [
        f"{moving.name} on {frame.name}: an edge of {frame.name} presses along the normals of its "
        f"own facets, most at {checks.place(x[lean.argmax()] + frame.origin)}: forces lean by "
        f"{lean.sum() / force.sum():.0%} of all that press. Use smaller facets on {frame.name} "
        f"than on {moving.name}, so that its nodes are those that touch"
    ]


def rounded_off(contact: MovingContact, t: ContactTerms) -> list[str]:
    """Of edges of the frame, as drawn, where something presses on both sides of sharp ones, or
    beside any with forces that lean: along the normal neither of the facet nor of what presses on
    it."""
    sides, place = contact.sides, _on_frame(contact, t)
    if place is None:
        return []
    frame, facet, pressed = sides.carrier, place.at.facet, t.status != OPEN
    i, j, angle, edge = edges(frame.x, frame.facets)
    edge |= angle > SHARP
    if not edge.any():
        return []
    i, j, angle = i[edge], j[edge], angle[edge]
    x, y = sides.split(place.z)
    own = unit_normals(y, frame.facets)[facet], -unit(areas_around(x, sides.mover.skin))
    lean = np.min([np.linalg.norm(place.normal - n, axis=1) for n in own], axis=0)
    force = np.where(pressed, np.linalg.norm(sides.split(t.force)[0], axis=1), 0.0)
    leaning = np.where(np.isin(facet, (i, j)), force * lean, 0.0)
    both = (angle > SHARP) & np.isin(i, facet[pressed]) & np.isin(j, facet[pressed])
    if not both.any() and leaning.sum() <= LEANS * force.sum():
        return []
    share = leaning.sum() / force.sum() if force.any() else 0.0
    on = np.bincount(facet, leaning, len(frame.facets))
    worst = int((on[i] + on[j]).argmax())
    node = np.intersect1d(frame.facets[i[worst]], frame.facets[j[worst]])[0]
    return [
        f"{sides.mover.name} on {frame.name}: presses beside sharp edges of {frame.name}, most at "
        f"{checks.place(y[node] + frame.origin)}: normals turn along all of the facets there, "
        f"forces lean by {share:.0%} of all that press, and do work. Leave "
        f"facets beyond sharp edges out of the tag of {sides.mover.name}, so that it carries the "
        "frame; else round the edges off"
    ]


def _on_frame(contact: MovingContact, t: ContactTerms) -> NormalPlace | None:
    """How pairs stand, of contact that may part with a frame on another surface; None: of other."""
    another = contact.parts and not isinstance(contact.sides, SelfSides)
    return t.place if another and isinstance(t.place, NormalPlace) else None


OF_PAIRS = deep, crossed, beside_edge, edge_leans, rounded_off
