"""What of the tagged surfaces takes part, and what is said or refused before any solve."""

from collections.abc import Sequence
from typing import NoReturn

import numpy as np

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.log import log, warn_of
from dolfinx_llm.geometry.cells import areas_around, unit_normals, vector_areas
from dolfinx_llm.geometry.facing import TURN, Separation, separation
from dolfinx_llm.geometry.overlap_curved import is_flat, vector_areas_in_contact
from dolfinx_llm.geometry.overlap_flat import Plane, common_area, common_plane
from dolfinx_llm.geometry.pieces import Piece, touching_pieces
from dolfinx_llm.geometry.surface import Surface

NEARER = 1e-9  # of the surface's size: gaps that fall by less do not close
BURIED = 0.5  # depth, in the radius of the smaller surface, that no drawing can mean


def find_pieces(
    sides: Sequence[Surface], unilateral: bool, name: str, notes: list[str]
) -> tuple[list[Piece], list[Array]]:
    """The pieces of two surfaces that can touch, and per side its ``steep_rim``; ``notes`` gets
    what was left out and how bodies overlap.

    Raises:
        ContactError: nothing faces, or one body lies inside of the other.
    """
    if not unilateral and _flat(sides):  # the common area says what takes part
        every = np.arange(len(sides[0].facets)), np.arange(len(sides[1].facets))
        piece = Piece(every, common_plane(sides[0], sides[1]), 0)
        return [piece], [np.zeros(len(side.x), dtype=bool) for side in sides]
    separations = separation(sides[0], sides[1]), separation(sides[1], sides[0])
    pieces = touching_pieces(sides, separations, unilateral)
    if unilateral:
        _say_overlap(sides, separations, pieces, name, notes)
    if not pieces:
        _refuse(sides, separations)
    rims = []
    for k, side in enumerate(sides):
        facets = np.concatenate([piece.facets[k] for piece in pieces])
        rims.append(steep_rim(side, facets, separations[k].over))
        left = len(side.facets) - len(facets)
        if left:
            notes.append(f"{left} of {len(side.facets)} facets of {side.name} left out: they do "
                         "not face the other side")  # fmt: skip
    edges = sum(piece.edges for piece in pieces)
    if edges > 0:
        text = (
            f"the facets that face each other meet at {edges} sharp edge(s), where the contact "
            "normal is rounded off: forces there are not exact. Tag one face of the edge only"
        )
        warn_of(name, text, notes)
    return pieces, rims


def _say_overlap(
    sides: Sequence[Surface],
    separations: Sequence[Separation],
    pieces: Sequence[Piece],
    name: str,
    notes: list[str],
) -> None:
    """Bodies that overlap in the drawing: noted, said beyond a facet, refused where one lies inside
    of the other."""
    k = int(np.argmax([s.depth.max() for s in separations]))
    side, other, depth = sides[k], sides[1 - k], separations[k].depth
    if not depth.any():
        return
    radius = min(np.linalg.norm(s.x - s.x.mean(axis=0), axis=1).max() for s in sides)
    say_depth(
        side, depth, separations[k].size, BURIED * radius if pieces else 0.0, name, notes,
        what=f"the body of {other.name}",
        wrong="one body lies inside of the other, or the tags mark sides that face away from each "
        "other. Check tags, positions and units",
        pushes="them apart",
    )  # fmt: skip


def say_depth(
    side: Surface,
    depth: Array,
    size: Array,
    most: float,
    name: str,
    notes: list[str],
    *,
    what: str,
    wrong: str,
    pushes: str,
) -> None:
    """Nodes of a side that lie inside of something by depth (n,), where facets have a size (n,):
    noted, a warning beyond that size, refused where also deeper than ``most``."""
    worst = int(depth.argmax())
    text = (
        f"{int((depth > 0.0).sum())} node(s) of {side.name} lie inside of {what} as drawn, the "
        f"deepest at {checks.place(side.x[worst])} by {depth[worst]:.3g}"
    )
    if depth[worst] > max(most, size[worst]):
        raise ContactError(f"{text}, where facets have the size {size[worst]:.3g}: {wrong}")
    notes.append(text)
    if depth[worst] > size[worst]:
        log.warning(
            "interface %s: %s, more than a facet's size, %.3g: contact pushes %s by as much in the "
            "first load step. Check positions and units", name, text, size[worst], pushes,
        )  # fmt: skip


def _flat(sides: Sequence[Surface]) -> bool:
    """Whether both surfaces are flat, to rounding."""
    size = max(side.diameter for side in sides)
    return all(is_flat(side, 1e-6 * size) for side in sides)


def _refuse(sides: Sequence[Surface], separations: Sequence[Separation]) -> NoReturn:
    """Say why nothing of two surfaces faces."""
    if _flat(sides):
        common_area(sides[0], sides[1], common_plane(sides[0], sides[1]))
    else:
        vector_areas_in_contact(sides[0], sides[1])
    near = int(separations[0].distance.argmin())
    raise ContactError(
        f"no facet of {sides[0].name} faces one of {sides[1].name}: they are nearest at "
        f"{checks.place(sides[0].x[near])}, {separations[0].distance[near]:.3g} apart, and "
        "nowhere lie in front of each other with opposite normals. Check tags, positions and units"
    )


def steep_rim(whole: Surface, facets: Array, over: Array) -> Array:
    """(n,) nodes of a tagged surface where it goes on, without a sharp edge, into others than the
    given facets, left out though the other side is there: some of their nodes (n,) lie over it."""
    normal = unit_normals(whole.x, whole.facets)
    left = over[whole.facets].any(axis=1)
    left[facets] = False
    mean = areas_around(whole.x, whole.facets[facets])
    size = np.linalg.norm(mean, axis=1)
    mean /= np.where(size > 0.0, size, 1.0)[:, None]
    rim = np.zeros(len(whole.x), dtype=bool)
    cosine = np.einsum("fki,fi->fk", mean[whole.facets[left]], normal[left])
    rim[whole.facets[left][cosine > np.cos(TURN)]] = True
    return rim


def check_flat(sides: Sequence[Surface], plane: Plane, rule: str) -> None:
    """Require flat sides parallel to each other, closer than a facet's size; the rule is said where
    they are not."""
    size = max(side.diameter for side in sides)
    heights = [plane.height(side.x) for side in sides]
    for side, height in zip(sides, heights):
        if np.ptp(height) > 1e-6 * size:
            raise ContactError(
                f"{side.name} is flat, but not parallel to the other side: its nodes lie within "
                f"{np.ptp(height):.3g} along the normal {checks.place(plane.normal)} (allowed "
                f"{1e-6 * size:.3g}). Check the geometry"
            )
    gap = abs(heights[1].mean() - heights[0].mean())
    areas = [np.linalg.norm(vector_areas(side.x, side.facets), axis=1).max() for side in sides]
    facet = max(areas) ** (1.0 / (len(plane.origin) - 1))
    if gap > facet:
        raise ContactError(
            f"the surfaces {sides[0].name} and {sides[1].name} lie {gap:.3g} apart along the "
            f"normal, more than the largest facet's size, {facet:.3g}; {rule}. Check tags, "
            "positions and units"
        )


def nothing_touches(what: str, before: float, now: float, where: Array) -> str:
    """What is said of bodies that a load brings nearer to each other, and that touch nowhere.

    Args:
        what: the interface, or what touches there.
        before, now: distance as drawn and now [length].
        where: (gdim,) they are nearest now.
    """
    return (
        f"{what}: nothing touches: the load brings both sides nearer to each other, from "
        f"{before:.2g} as drawn to about {max(now, 0.0):.2g} at {checks.place(where)}, and no "
        "contact force arises. Check positions, units and the load, or draw the bodies nearer"
    )
