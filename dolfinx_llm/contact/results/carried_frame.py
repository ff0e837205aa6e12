"""What is told of a frame that one side carries, where the law holds at the nodes of the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, nearest, of_nearest
from dolfinx_llm.contact.equations.state import InterfaceState
from dolfinx_llm.contact.results.sides import FELT, SideResult
from dolfinx_llm.interface.control import control_values, of_control_values
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.interface.tool_forces import tool_shares
from dolfinx_llm.laws.rows import CLOSED, OPEN


def with_tool_forces(
    geometry: InterfaceGeometry, sides: Sequence[SideResult], nodal: tuple[SideResult, ...]
) -> tuple[tuple[SideResult, ...], csr_matrix | None]:
    """The sides at nodes, with forces of a prescribed one, on which the frame lies, as
    ``tool_shares`` has them, and these parts (m, n) of the other's; None: they are those of rows.

    Args:
        sides: of control values.
        nodal: the same at nodes.
    """
    k, frame = geometry.site.prescribed, geometry.frame
    if k is None or frame is None:
        return nodal, None
    pairs, other, tool = geometry.pairs[1 - k], sides[1 - k], nodal[k]
    opposite = geometry.opposite[k]
    if pairs.control is not None:
        opposite = opposite @ pairs.control
    areas, places = (other.area, tool.area), (control_values(pairs, pairs.x), frame.x)
    shares = tool_shares(opposite, pairs.N, areas, *places, other.force, -tool.force)
    if shares is None:
        return nodal, None
    force = -(shares @ other.force)
    across = np.einsum("ni,ni->n", force, tool.normal)
    own = of_control_values(geometry.pairs[k], across)
    told = replace(tool, force=force, normal_force=across, pressing=own)
    return tuple(told if side is tool else side for side in nodal), shares


def at_carried_frame(
    geometry: InterfaceGeometry,
    sides: Sequence[SideResult],
    state: InterfaceState,
    shares: csr_matrix | None,
) -> tuple[Array, Array, Array, Array]:
    """Normal forces, areas, friction of side 0 and status at the frame's nodes (m,).

    Those of the side at which the law holds are shared by the positive entries of its rows, and
    friction is turned into the tangent planes there: so at most μ N, as at each node of that side.
    """
    law_side, normal = geometry.law_side, geometry.normals
    assert law_side is not None
    sign, side = (1.0, -1.0)[law_side], sides[law_side]
    share = geometry.shares.tocoo() if shares is None else shares.T.tocoo()
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
