"""What laws at finite deformation are told of their nodes as drawn, and read anew."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.finite.frame.divided_sides import DividedSides
from dolfinx_llm.finite.frame.location import INSIDE, find_on_frame
from dolfinx_llm.finite.frame.sides import Sides
from dolfinx_llm.finite.obstacles.obstacle_contact import OneSide
from dolfinx_llm.geometry.spaces import is_function
from dolfinx_llm.interface.choices import Interface
from dolfinx_llm.interface.site import Site
from dolfinx_llm.laws.rows import LawNodes, at_positions
from dolfinx_llm.operators.numbering import BodyDofs


def nodes_of(
    interface: Interface, sides: Sides | OneSide, site: Site, drawn: Array, dofs: BodyDofs
) -> LawNodes:
    """The moving side's nodes, of whole facets, as a law is told of them, with unit areas."""
    mover = sides.whole if isinstance(sides, DividedSides) else sides.mover
    x = mover.x
    places = x + mover.origin
    n, q = len(x), sides.gdim - 1

    def sampled(value: Any) -> Array:
        if not is_function(value):
            return at_positions(value, places)
        for side in (sides.moving, sides.frame):
            if side is None:  # rigid
                continue
            if value.function_space.mesh is not dofs.spaces[site.spaces[side]].mesh:
                continue
            space = site.spaces[side]
            nodal = dofs.sampled(value, space, dofs.of(space, site.whole[side])[:, 0])
            if side == sides.moving:
                return nodal
            assert isinstance(sides, Sides)
            frame = sides.surfaces[side]
            found = find_on_frame(x, frame.x, frame.cells, sides.outward(drawn))
            inside = found.beyond[:, None] <= INSIDE
            N = np.where(inside, found.N, np.maximum(found.N, 0.0))
            return np.einsum("nk,nk->n", N, nodal[frame.cells[found.facet]]) / N.sum(axis=1)
        raise ContactInputError(
            f"interface {interface.name}: a Function that a law varies by lives on the mesh of "
            "neither side. Give one of a side's mesh, or a function of positions"
        )

    zeros = np.zeros((n, q))
    return LawNodes(
        places, np.ones(n), zeros, np.zeros(n), zeros, zeros, np.ones(n), np.zeros(n, dtype=int),
        sample=sampled,
    )  # fmt: skip
