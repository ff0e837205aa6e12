"""Follower loads at finite deformation, made of the user's choices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.finite.load_step import Placed
from dolfinx_llm.finite.pressure import Follower, FreeSurfacePressure, sides_between
from dolfinx_llm.geometry.surface import extract_surface
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
    return [
        _piece(load, cover, k == 0, dofs, contacts)
        for load in loads
        for k, cover in enumerate(load.pieces)
    ]


def _piece(
    load: FreeSurfacePressure, cover: Any, whole: bool, dofs: BodyDofs, contacts: Sequence[Placed]
) -> Placed:
    """One of them; arguments as of ``Follower``."""
    obstacle = cover if isinstance(cover, Obstacle) else None
    tagged = [(load.facet_tags, load.tag)]
    tagged += [] if cover is None or obstacle is not None else [tuple(cover)]
    spaces = [space_of(tags, dofs.spaces) for tags, _ in tagged]
    surfaces = [
        extract_surface(dofs.spaces[i], tags, tag) for i, (tags, tag) in zip(spaces, tagged)
    ]
    with collective(dofs.comm):
        surfaces[0] = surfaces[0].with_depth(load.thickness, "FreeSurfacePressure")
    drawn, sides, between = near(surfaces), None, cover is None
    nodes = [dofs.of(space, s)[:, 0] for space, s in zip(spaces, surfaces)]
    if obstacle is not None:
        on = [c for c in contacts if getattr(c.what, "obstacle", None) is obstacle]
        between = any(np.isin(nodes[0], contact.moving).any() for contact in on)
    elif cover is not None:
        sides = sides_between(drawn, nodes, [contact.meets for contact in contacts])
        between = sides is not None
    if not between:
        other = type(obstacle).__name__ if obstacle is not None else surfaces[1].name
        raise ContactInputError(
            f"FreeSurfacePressure: no interface has both {surfaces[0].name} and {other}, and "
            "contact tells what is covered: leave covered_by out, or give the interface between "
            "them"
        )
    return placed_at(Follower(drawn, sides, obstacle, whole), drawn, spaces, dofs)
