"""What in a solution the method does not allow for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.checks import place
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.contact.equations.state import InterfaceState
from dolfinx_llm.contact.iteration import ContactIteration
from dolfinx_llm.contact.results.results import InterfaceResult
from dolfinx_llm.contact.search.flickering import lost
from dolfinx_llm.forms.verdict import EPS
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.interface.control import of_control_values
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.interface.supports import HELD_IN
from dolfinx_llm.interface.tool_forces import check_beside
from dolfinx_llm.interface.touching import NEARER, nothing_touches
from dolfinx_llm.laws.rows import OPEN, SLIP, STICK

SPIN = 1e-9  # part of an obstacle's rotation along its normals, up to which it does not tilt
TILT = 0.1  # [rad] angle by which an obstacle may turn: half its square of the motion is left out
LOOSE_SHARE = 1e-3  # of the normal force, on pairs without friction of their own
UNTIED_SHARE = 1e-2  # the same, on pairs that have none from the start of a load step, and of
# friction on pairs that do not press
GRAZING_SHARE = 0.2  # the same of that friction, from where on it is no answer
UNEVEN = 2.0  # friction of a side's nodes over that of the law's, where all slip
CARRIES = 1e-10  # of the largest force in the load step: an interface with less carries none
RIM_SHARE = 1e-2  # of the normal force, on pairs next to facets that were left out
UNCERTAIN = 0.2  # part of the bodies' motion to which gaps must be known


def doubts(
    geometries: Sequence[InterfaceGeometry],
    results: Sequence[InterfaceResult],
    iteration: ContactIteration,
    in_time: bool,
) -> list[str]:
    """What in a solution lies outside of what the method allows for: contact at the rim of what may
    touch, sliding farther than a facet, pairs that lost their friction, bodies that come nearer and
    do not touch.

    Raises:
        ContactError: what presses lies beside a tool, or next to what was left out as too far
            away, pairs that do not press bear much friction, or a mean that is prescribed is not
            met; the same on every rank.
    """
    out = []
    largest = [max(np.abs(side.force).max() for side in result.sides) for result in results]
    carries = [size > CARRIES * iteration.forces for size in largest]
    for state, result, bears in zip(iteration.states, results, carries, strict=True):
        out += _held_in_each_other(state) + _torn(state)
        if not bears:
            continue
        share = lost(state, iteration.multiplier)
        if state.own.ties is not None and share > UNTIED_SHARE:
            out.append(
                f"interface {state.nodes.geometry.interface.name}: pairs at the rim of contact "
                f"carry {share:.1%} of the normal force, and those next to them the friction that "
                "belongs to it. Use a finer mesh where contact ends"
            )
        elif state.own.ties is None and share > LOOSE_SHARE:
            out.append(
                f"interface {state.nodes.geometry.interface.name}: pairs that opened and closed by "
                f"turns have been left without friction of their own, and carry {share:.1%} of the "
                "normal force. Apply the load in more increments"
            )
        grazes = max(state.grazes, _borne_open(state.nodes.geometry, result))
        if grazes > UNTIED_SHARE:
            refused = state.grazes > GRAZING_SHARE
            allowed = f" (allowed {GRAZING_SHARE:.0%})" if refused else ""
            out.append(
                f"interface {state.nodes.geometry.interface.name}: pairs that are just about to "
                f"part bear friction of {grazes:.1%} of the normal force without "
                f"pressing{allowed}. Use a finer mesh where contact ends"
            )
            if refused:
                raise ContactError(out[-1])
        out += _rough(state.nodes.geometry, result)
        _check_tool(state.nodes.geometry, result)
        _check_cuts(state.nodes.geometry, result)
    each = zip(iteration.states, geometries, results, carries, strict=True)
    for state, geometry, result, bears in each:
        out += [] if in_time or state.overlap or bears else _apart(geometry, result)
        out += _uncertain_gaps(geometry, result)
        for pairs, side, rim in zip(geometry.pairs, result.sides, geometry.rims, strict=True):
            reached, total = side.normal_force[rim].sum(), side.normal_force.sum()
            count = int((rim & (side.status != OPEN)).sum())
            if reached > RIM_SHARE * total > 0.0:
                out.append(
                    f"interface {geometry.interface.name}: contact reaches the rim of what "
                    f"{pairs.surface.name} may touch with: {count} node(s) "
                    f"there carry {reached / total:.1%} of the normal force; facets beyond "
                    "are too steep to face the other side. Check the tags, or split the surface "
                    "into several interfaces"
                )
            closed = side.status != OPEN
            spun, tilted = _turned(geometry, result)
            slip = np.linalg.norm((side.slip + spun)[closed], axis=1).max(initial=0.0)
            size = _facet_size(pairs)
            if geometry.interface.law.opens and slip > size:
                out.append(
                    f"interface {geometry.interface.name}: nodes of {pairs.surface.name} slide by "
                    f"{slip:.3g}, more than a facet's size, {size:.3g}: contact is found for the "
                    "drawn positions (small sliding). Move the bodies in the drawing instead"
                )
            if tilted > TILT:
                out.append(
                    f"interface {geometry.interface.name}: the obstacle is turned by {tilted:.3g} "
                    f"rad, which counts as small: its points are off by about "
                    f"{0.5 * tilted**2:.1%} of their distance from the pivot. Draw it turned"
                )
    return out


def _held_in_each_other(state: InterfaceState) -> list[str]:
    """Bodies that overlap, or are in an obstacle, where supports hold all."""
    geometry, count = state.nodes.geometry, int(state.clamped.sum())
    if not state.overlap > HELD_IN * max(_facet_size(pairs) for pairs in geometry.pairs):
        return []
    if geometry.rigid:
        return [
            f"interface {geometry.interface.name}: supports hold nodes in the obstacle, by up to "
            f"{state.overlap:.2g}: it exerts no force there, and supports bear all. Leave their "
            "motion free, or move the obstacle"
        ]
    return [
        f"interface {geometry.interface.name}: supports hold both sides at {count} node(s), in "
        f"each other by up to {state.overlap:.2g}: forces there are what supports make of it. "
        "Leave the motion of one side free there, or draw the bodies apart"
    ]


def _torn(state: InterfaceState) -> list[str]:
    """Ties that something else holds apart."""
    torn, geometry = int((state.torn > 0.0).sum()), state.nodes.geometry
    if not torn:
        return []
    name, obstacle = geometry.interface.name, geometry.interface.obstacle
    others = "supports, or another interface, prescribe other motions there"
    if obstacle is not None and obstacle.everywhere:
        raise ContactError(f"interface {name}: the mean displacement is not met: {others}")
    return [
        f"interface {name}: the tie is torn at {torn} node(s), by up to {state.torn.max():.2g}: "
        f"{others}. Leave them free, or prescribe the same"
    ]


def _facet_size(pairs: ContactPairs) -> float:
    """Of the largest nodal area [length]."""
    return float(np.abs(pairs.forces).max() ** (1.0 / (pairs.x.shape[1] - 1)))


def _borne_open(geometry: InterfaceGeometry, result: InterfaceResult) -> float:
    """Friction over the normal force, of open pairs of a side that carries the frame: for those
    that press beside them."""
    if geometry.site.carrier is None:
        return 0.0
    side = result.sides[geometry.site.carrier]
    borne = np.linalg.norm(side.tangential_force[side.status == OPEN], axis=1).sum()
    return float(borne / max(side.normal_force.sum(), 1e-300))


def _rough(geometry: InterfaceGeometry, result: InterfaceResult) -> list[str]:
    """Sides that slip whose friction node by node is far more than that of the law's nodes."""
    status, law = result.frame_status, geometry.interface.law
    out: list[str] = []
    if geometry.rigid or not (law.shares and (status == SLIP).any()) or (status == STICK).any():
        return out
    rubs = list[float]()
    for pairs, side in zip(geometry.pairs, result.sides, strict=True):
        force = of_control_values(pairs, side.force)
        across = np.einsum("ni,ni->n", force, pairs.normal)[:, None] * pairs.normal
        rubs.append(np.linalg.norm(force - across, axis=1).sum())
    own = geometry.law_side
    of_law = np.linalg.norm(result.frame_friction, axis=1).sum() if own is None else rubs[own]
    there = "the frame" if own is None else geometry.pairs[own].surface.name
    for pairs, rub in zip(geometry.pairs, rubs, strict=True):
        if rub > UNEVEN * of_law:
            out.append(
                f"interface {geometry.interface.name}: friction at the nodes of "
                f"{pairs.surface.name} is {rub / of_law:.1f} times that of {there}, where the law "
                "holds, and cancels but for that: a side that slips keeps the shape of the coarser "
                "one along the surface. Use cells of about the same size where bodies touch, finer "
                "ones where they are"
            )
    return out


def _check_tool(geometry: InterfaceGeometry, result: InterfaceResult) -> None:
    """Require forces that a tool which supports move as a whole can bear."""
    if geometry.site.prescribed is not None:
        names, forces = [s.name for s in geometry.sides], [s.pressing for s in result.sides]
        check_beside(geometry.interface.name, names, forces, geometry.site.prescribed)


def _check_cuts(geometry: InterfaceGeometry, result: InterfaceResult) -> None:
    """Require contact that ends before facets that were left out as too far away."""
    for part in geometry.parts:
        if part.piece.cut is None:
            continue
        both = zip(geometry.pairs, result.sides, geometry.site.whole, part.piece.cut, strict=True)
        for pairs, side, whole, cut in both:
            reached = np.where(np.isin(pairs.dofs, whole.dofs[cut]), side.pressing, 0.0)
            share = reached.sum() / max(side.pressing.sum(), 1e-300)
            if share > RIM_SHARE:
                raise ContactError(
                    f"interface {geometry.interface.name}: contact reaches facets of "
                    f"{pairs.surface.name} that lie too far from the other body in the drawing "
                    f"for rows that balance: nodes next to them carry {share:.1%} of the normal "
                    f"force, most at {place(pairs.x[int(reached.argmax())])}. Draw the bodies "
                    "nearer to each other there, or give them meshes that are more alike, or finer"
                )


def _uncertain_gaps(geometry: InterfaceGeometry, result: InterfaceResult) -> list[str]:
    """Gaps of coarse curved surfaces that are known no better than the bodies move."""
    known = geometry.certificate.place if geometry.certificate else 0.0
    moved = max(np.linalg.norm(side.u, axis=1).max() for side in result.sides)
    rounding = EPS * geometry.sides[0].diameter
    if not (geometry.interface.law.closes_gap and known > UNCERTAIN * moved > rounding):
        return []
    return [
        f"interface {geometry.interface.name}: the meshes tell the gap between the curved surfaces "
        f"to about {known:.2g}, and the bodies move by {moved:.2g}: contact forces are off by as "
        "much of themselves. Refine both meshes along the interface, or tie the bodies as drawn"
    ]


def _turned(geometry: InterfaceGeometry, result: InterfaceResult) -> tuple[Array | float, float]:
    """By how much an obstacle has turned: the motion (n, gdim) of its points where that leaves its
    surface where it is, else the angle [rad]."""
    obstacle, pairs = geometry.interface.obstacle, geometry.pairs[0]
    if obstacle is None:
        return 0.0, 0.0
    if geometry.swings is not None and result.rotation is not None:  # under a moment
        return 0.0, float(np.linalg.norm(result.rotation))
    motion = obstacle.turning(pairs.met)
    along = np.abs(np.einsum("ni,ni->n", motion, pairs.normal)).max()
    if along > SPIN * np.abs(motion).max():
        return 0.0, float(np.linalg.norm(obstacle.pose(motion.shape[1])[1]))
    return motion, 0.0


def _apart(geometry: InterfaceGeometry, result: InterfaceResult) -> list[str]:
    """Bodies that have come nearer to each other than in the drawing, and touch nowhere."""
    law, sides = geometry.interface.law, result.sides
    if not law.opens or any((side.status != OPEN).any() for side in sides):
        return []
    drawn = [-np.einsum("ni,ni->n", p.gap, p.normal) for p in geometry.pairs]
    before = _gaps(geometry, drawn).min()
    if geometry.rigid:
        moved = [side.frame_gap for side in sides]
    else:  # between the bodies: frames that nothing touches may be anywhere
        each = zip(drawn, geometry.pairs, sides, strict=True)
        moved = [gap - np.einsum("ni,ni->n", side.u, p.normal) for gap, p, side in each]
    now = _gaps(geometry, moved).min()
    if not now < before - NEARER * geometry.sides[0].diameter:
        return []
    side = min(sides, key=lambda side: float(side.gap.min()))
    where, named = side.x[side.gap.argmin()], f"interface {geometry.interface.name}"
    return [nothing_touches(named, before, now, where)]


def _gaps(geometry: InterfaceGeometry, gaps: Sequence[Array]) -> Array:
    """Distance between both sides at the frame's nodes, or of the nodes from the obstacle."""
    shapes = geometry.law_shapes if geometry.rigid else [pairs.N for pairs in geometry.pairs]
    total = np.zeros(shapes[0].shape[1])
    for pairs, N, gap in zip(geometry.pairs, shapes, gaps, strict=True):
        area = N.T @ pairs.forces
        at = N.T @ (gap * pairs.forces)
        total += np.where(area > 0.0, at / np.where(area > 0.0, area, 1.0), np.inf)
    return total
