"""What is told of a frame that one side carries, where the law holds at the nodes of the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, nearest, of_nearest
from dolfinx_llm.contact.equations.state import InterfaceState
from dolfinx_llm.contact.results.sides import FELT, SideResult
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.laws.rows import CLOSED, OPEN


def at_carried_frame(
    geometry: InterfaceGeometry, sides: Sequence[SideResult], state: InterfaceState
) -> tuple[Array, Array, Array, Array]:
    """Normal forces, areas, friction of side 0 and status at the frame's nodes (m,).

    Those of the side at which the law holds are shared by the positive entries of its rows, and
    friction is turned into the tangent planes there: so at most μ N, as at each node of that side.
    """
    law_side, normal = geometry.law_side, geometry.normals
    assert law_side is not None
    sign, side = (1.0, -1.0)[law_side], sides[law_side]
    share = geometry.shares.tocoo()
    force, area = share.T @ side.normal_force, share.T @ side.area
    n, to = sign * side.normal[share.row], normal[share.col]
    drag = sign * side.tangential_force[share.row]
    middle = (n + to) / (1.0 + np.einsum("ki,ki->k", n, to))[:, None]
    drag = share.data[:, None] * (drag - np.einsum("ki,ki->k", drag, to)[:, None] * middle)
    friction = np.column_stack([np.bincount(share.col, a, len(force)) for a in drag.T])
    touching = share.T @ diagonal(state.own.status != OPEN)
    status = of_nearest(nearest(touching).astype(bool), state.own.status)
    pressed = force > FELT * np.abs(force).max(initial=0.0)
    status = np.where(pressed, np.where(status == OPEN, CLOSED, status), OPEN)
    return force, area, friction, status


def halved_slips(
    geometry: InterfaceGeometry, sides: Sequence[SideResult]
) -> tuple[SideResult, ...]:
    """The sides (of nodes) with half of the slip each, as about a frame that moves with both."""
    law_side = geometry.law_side
    assert law_side is not None
    slip = 0.5 * sides[law_side].slip
    found = [replace(side, slip=slip) for side in sides]
    k = 1 - law_side
    other, closed = sides[k], sides[k].status != OPEN
    own = -(geometry.opposite[k] @ slip)
    own -= np.einsum("ni,ni->n", own, other.normal)[:, None] * other.normal
    found[k] = replace(other, slip=np.where(closed[:, None], own, 0.0))
    return tuple(found)
