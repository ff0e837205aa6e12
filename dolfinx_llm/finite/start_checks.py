"""What cannot be meant where a nonlinear problem starts: bodies inside of each other or of
obstacles, surfaces that point the same way.

At finite deformation bodies may be far apart at first, and meet later with whatever faces then, so
that nothing else is refused.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.finite.frame.self_sides import SelfSides
from dolfinx_llm.finite.frame.sides import Sides
from dolfinx_llm.finite.load_step import Placed
from dolfinx_llm.finite.obstacles.obstacle_contact import ObstacleContact
from dolfinx_llm.finite.obstacles.pose import Pose
from dolfinx_llm.geometry.cells import vector_areas
from dolfinx_llm.geometry.facing import TURN, Facets, facet_sizes, separation
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.against import checked_clearance
from dolfinx_llm.interface.choices import Interface
from dolfinx_llm.interface.touching import BURIED

SAME_WAY = 0.5  # cosine between mean normals from which on they point the same way
UPON = 1e-9  # of a surface's size, within which nodes lie on an obstacle


def check_start(interface: Interface, placed: Placed, z: Array) -> None:
    """Require that bodies of an interface do not lie in what they are to touch.

    Args:
        interface: the user's choices.
        placed: what is made of it.
        z: (width,) coordinates of its surfaces at the start [length].

    Raises:
        ContactError: they do, or the surfaces point the same way; how many nodes, and how deep.
    """
    what = placed.what
    sides = what.sides
    if not interface.law.opens or isinstance(sides, SelfSides):
        return
    ends = np.cumsum([s.x.size for s in sides.surfaces])
    x = [part.reshape(s.x.shape) for part, s in zip(np.split(z, ends), sides.surfaces)]
    surfaces = [replace(s, x=now) for s, now in zip(sides.surfaces, x, strict=True)]
    if isinstance(what, ObstacleContact):
        _check_outside(what, surfaces[0])
    elif isinstance(sides, Sides):
        _check_sides(surfaces[0], surfaces[1], sides.within)


def _check_sides(one: Surface, other: Surface, within: float) -> None:
    """Of two surfaces, where contact is looked for ``within`` so many facets."""
    apart = separation(one, other), separation(other, one)
    over = max(float(s.over.mean()) for s in apart)
    turned = [_way(s) for s in (one, other)]
    if over >= 0.5 and turned[0] @ turned[1] > SAME_WAY:
        n0, n1 = (normal.round(4).tolist() for normal in turned)
        raise ContactError(
            f"the outward normals of {one.name}, {n0}, and {other.name}, {n1}, point the same way, "
            "and one lies behind the other; surfaces in contact face each other. Check the tags, "
            "and the cells for negative Jacobians"
        )
    for s, side, hit in zip(apart, (one, other), (other, one), strict=True):
        deep = s.depth > within * s.size
        if deep.any():
            worst = int(np.where(deep, s.depth, 0.0).argmax())
            raise ContactError(
                f"{int(deep.sum())} node(s) of {side.name} lie inside of the body of {hit.name} at "
                f"the start, the deepest at {checks.place(side.x[worst] + side.origin)} by "
                f"{s.depth[worst]:.3g}, where facets have the size {s.size[worst]:.3g}: contact is "
                "not looked for so deep. Draw the bodies nearer to where they touch, or check tags "
                "and units"
            )


def _way(surface: Surface) -> Array:
    """(gdim,) the unit normal from which no facet's differs by more than TURN, or 0."""
    areas = vector_areas(surface.x, surface.facets)
    normals = areas / np.maximum(np.linalg.norm(areas, axis=1), 1e-300)[:, None]
    mean = areas.sum(axis=0)
    mean = mean / max(float(np.linalg.norm(mean)), 1e-300)
    return mean if (normals @ mean > np.cos(TURN)).all() else 0.0 * mean


def _check_outside(contact: ObstacleContact, side: Surface) -> None:
    """Of a surface and an obstacle, which may be moved out of the body in the first step."""
    obstacle, kind = contact.obstacle, type(contact.obstacle).__name__
    if obstacle.everywhere:
        return
    distance, normal = checked_clearance(obstacle, side.x)
    moved = Pose.of(contact.pose(), side.x.shape[1]).back(side.x)
    distance = np.maximum(distance, checked_clearance(obstacle, moved)[0])
    area = vector_areas(side.x, side.facets)
    toward = normal[side.facets].mean(axis=1)
    size = np.linalg.norm(area, axis=1) * np.maximum(np.linalg.norm(toward, axis=1), 1e-300)
    cosine = np.einsum("fi,fi->f", area, toward) / size
    away = (distance[side.facets] <= UPON * side.diameter).all(axis=1) & (cosine < -np.cos(TURN))
    if away.any() and not (cosine > np.cos(TURN)).any():
        raise ContactError(
            f"{int(away.sum())} facet(s) of {side.name} lie on the {kind} or inside of it and face "
            "away, and none faces it: the body is on its inner side. Check the obstacle's normal, "
            "`inside`, the tag and positions"
        )
    facing = np.zeros(len(side.x), dtype=bool)
    facing[side.cells[cosine > np.cos(TURN)]] = True
    depth = np.where(facing, -distance, 0.0)
    worst = int(depth.argmax())
    if depth[worst] > max(BURIED * Facets.of(side).reach, facet_sizes(side)[worst]):
        raise ContactError(
            f"{int((depth > 0.0).sum())} node(s) of {side.name} lie inside of the {kind} at the "
            f"start, the deepest at {checks.place(side.x[worst])} by {depth[worst]:.3g}: the "
            "body lies inside of the obstacle. Check positions, units, the obstacle's normal, "
            "`inside` and displacement"
        )
