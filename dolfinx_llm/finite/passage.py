"""Where nodes have gone in an increment: through the frame, or over its edge."""

from __future__ import annotations

import numpy as np

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.finite.inside import deepest
from dolfinx_llm.finite.location import INSIDE
from dolfinx_llm.finite.normal_contact import OVER, NormalPlace
from dolfinx_llm.finite.self_sides import CROSSED, SelfSides
from dolfinx_llm.finite.sides import Sides
from dolfinx_llm.finite.terms import MovingContact, Place
from dolfinx_llm.geometry.cells import areas_around, cell_sizes
from dolfinx_llm.geometry.facing import TURN

AHEAD = 0.5  # of a facet: no deeper lies what is in front of the frame at first
THROUGH = 1.0  # of a facet: deeper lies what has gone through it
BORE = 1e-9  # of the largest force, below which there is none


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
        x, moving = sides.split(after.z)[0], sides.surfaces[sides.moving].name
        raise ContactError(
            f"bodies pass through each other: {behind.sum()} node(s) of {moving} have gone through "
            f"{sides.surfaces[sides.frame].name}, the deepest, at {x[worst].round(6).tolist()}, by "
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
    for k, surface in enumerate((sides.frame, sides.moving)):
        x, y = (start[k], end[k]), (start[1 - k], end[1 - k])
        deep, size = deepest(x, y, sides.facets(k == 1))
        if deep.max(initial=0.0) > THROUGH * size:
            worst, other = int(deep.argmax()), sides.surfaces[1 - surface].name
            raise ContactError(
                f"bodies pass through each other: {(deep > THROUGH * size).sum()} node(s) of "
                f"{other} go through {sides.surfaces[surface].name} on their way, whose outline is "
                f"closed; the deepest, on its way to {end[k][worst].round(6).tolist()}, by "
                f"{deep[worst]:.3g} where facets have the size {size:.3g}"
            )


def _sizes(sides: Sides, place: NormalPlace) -> np.ndarray:
    """(n,) size of the frame's facet under each node [length]."""
    return cell_sizes(sides.split(place.z)[1], sides.facets(False))[place.at.facet]


def _ahead(sides: Sides, place: NormalPlace) -> np.ndarray:
    """(n,) which nodes lie in front of the frame, and face it."""
    at = place.at
    vectors = areas_around(sides.split(place.z)[0], sides.skin(True))
    cosine = np.einsum("ni,ni->n", vectors, at.normal) / np.linalg.norm(vectors, axis=1)
    there = at.met & (at.beyond <= INSIDE) & (cosine < -np.cos(TURN))
    return there & (at.gap > -AHEAD * _sizes(sides, place))


def left_over_edge(before: Place, force: np.ndarray, after: Place) -> np.ndarray:
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


def say_left(sides: Sides, left: np.ndarray, after: Place) -> str:
    """What to say of nodes (n,) that have left the frame over its edge."""
    moving, frame = sides.surfaces[sides.moving].name, sides.surfaces[sides.frame].name
    first = sides.split(after.z)[0][np.flatnonzero(left)[0]].round(6).tolist()
    return (
        f"{left.sum()} node(s) of {moving} that carried force have left {frame} over its edge in "
        f"this load step, the first is at {first}: nothing presses on them there. If the body goes "
        "on, tag more of it"
    )
