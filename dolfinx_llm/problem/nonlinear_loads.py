"""Follower loads at finite deformation, made of the user's choices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.finite.load_step import Placed
from dolfinx_llm.finite.pressure import Follower, FreeSurfacePressure, sides_between
from dolfinx_llm.geometry.surface import Surface, extract_surface
from dolfinx_llm.interface.obstacle import Obstacle
from dolfinx_llm.interface.site import space_of
from dolfinx_llm.operators.numbering import BodyDofs
from dolfinx_llm.problem.nonlinear_parts import near, placed_at


def followers_of(
    loads: Sequence[FreeSurfacePressure], dofs: BodyDofs, contacts: Sequence[Placed]
) -> list[Placed]:
    """The pieces of follower pressures, in the order of ``pressures_of``; collective.

    Args:
        loads: the user's choices.
        dofs: of the bodies.
        contacts: the interfaces, which tell what is covered.

    Raises:
        ContactInputError: none is between a surface and what may cover it; surfaces have a part of
            their facets in common.
    """
    found = []
    for load in loads:
        space = space_of(load.facet_tags, dofs.spaces)
        surface = extract_surface(dofs.spaces[space], load.facet_tags, load.tag)
        with collective(dofs.comm):
            surface = surface.with_depth(load.thickness, "FreeSurfacePressure")
        for k, cover in enumerate(load.pieces):
            found.append(_piece((space, surface), cover, k == 0, dofs, contacts))
    return found


def _piece(
    loaded: tuple[int, Surface], cover: Any, whole: bool, dofs: BodyDofs, contacts: Sequence[Placed]
) -> Placed:
    """One of them, on a surface of a space; other arguments as of ``Follower``."""
    spaces, surfaces, sides = [loaded[0]], [loaded[1]], None
    if cover is None or isinstance(cover, Obstacle):
        nodes = dofs.of(*loaded)[:, 0]
        between = cover is None or any(
            np.isin(nodes, contact.moving).any() for contact in contacts if contact.against(cover)
        )
        drawn, other = near(surfaces), type(cover).__name__
    else:
        spaces.append(space_of(cover[0], dofs.spaces))
        surfaces.append(extract_surface(dofs.spaces[spaces[1]], *cover))
        both = [dofs.of(space, s)[:, 0] for space, s in zip(spaces, surfaces)]
        drawn, other = near(surfaces), surfaces[1].name
        sides = sides_between(drawn, both, [contact.meets for contact in contacts])
        between = sides is not None
    if not between:
        raise ContactInputError(
            f"FreeSurfacePressure: no interface has both {surfaces[0].name} and {other}, and "
            "contact tells what is covered: leave covered_by out, or give the interface between "
            "them"
        )
    obstacle = cover if isinstance(cover, Obstacle) else None
    return placed_at(Follower(drawn, sides, obstacle, whole), drawn, spaces, dofs)
