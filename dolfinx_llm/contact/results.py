"""What a solve gives per interface, the same on every rank."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import told
from dolfinx_llm.contact.sides import FELT, SideResult, between_bodies, nodal_sides, side_result
from dolfinx_llm.contact.state import InterfaceState
from dolfinx_llm.geometry.frame import Frame, displaced
from dolfinx_llm.interface.control import nodal_values
from dolfinx_llm.interface.density import along_normals
from dolfinx_llm.interface.forces import InterfaceForces
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.interface.join import Certificate
from dolfinx_llm.laws.rows import CLOSED, OPEN, STICK
from dolfinx_llm.operators.system import ContactOperators


@dataclass(frozen=True, eq=False)
class InterfaceResult(InterfaceForces):
    """Result of one interface; against a rigid obstacle the side's nodes take the frame's place.

    The force at frame node J is sum_p N_pJ F_p over the nodes p of side 0, with F_p what these
    exert on the frame; side 1 exerts the opposite, which is the frame's equilibrium. Its component
    along the normal of J, out of side 0, is ``frame_force``, the rest ``frame_friction``; where
    friction acts the former of the F_p along the pairs' own normals, the latter of what is left of
    them. Coulomb's law holds for these two.
    """

    frame: Frame | None  # with its displacement v, (m, gdim) [length]
    sides: tuple[SideResult, ...]  # two, in the interface's order; one against an obstacle
    certificate: Certificate | None  # of the frame; None against an obstacle
    frame_force: Array  # (m,) normal force at the frame's nodes [force]
    frame_area: Array  # (m,) tributary area of the frame's nodes, L_bᵀ of the sides' [area]
    frame_friction: Array  # (m, gdim) tangential force of side 0 at the frame's nodes, where
    # friction acts the mean of both sides' [force]
    frame_status: Array  # (m,) of its nodes: 0 open, 1 stick, 2 slip, 3 closed, no friction
    presses: bool = True  # the law lets bodies part: no force pulls
    # (gdim,) of an obstacle, prescribed or where a force brings it [length]; None with a frame
    displacement: Array | None = None
    rotation: Array | None = None  # (1,), (3,) of an obstacle, likewise [rad]
    frame_density: Array | None = None  # (m, 1 + gdim) see ``InterfaceForces``


def collect_results(
    operators: ContactOperators,
    u: Array,
    multiplier: Array,
    w: Array,
    states: Sequence[InterfaceState],
) -> list[InterfaceResult]:
    """Results of all interfaces; everything is the same on every rank.

    Args:
        operators: of the interfaces.
        u: (n_local,) displacement of this rank.
        multiplier, w: (n,), (m,) multipliers and frame unknowns of all interfaces.
        states: one per interface.
    """
    motions = [operators.motion(side, u) for side in range(len(operators.pairs))]
    gaps, results = operators.side_gaps(), []
    prescribed = operators.obstacle_motions()
    parts = zip(operators.geometries, operators.places, states, strict=True)
    for i, (geometry, place, state) in enumerate(parts):
        m, d, gdim = geometry.directions.shape
        moved = motions[place.sides]
        v = np.einsum("md,mdi->mi", w[place.frame].reshape(m, d), geometry.directions)
        if geometry.normals_alone:
            # Without tangential unknowns the frame follows both bodies.
            v = v + _tangential_average(geometry, moved)
        forces = multiplier[place.rows].reshape(-1, geometry.pairs[0].base.shape[1])
        status = state.pair_status()
        presses = geometry.interface.law.opens and not state.held.any()
        sides, first = [], 0
        for p, motion, gap in zip(geometry.pairs, moved, gaps[place.sides], strict=True):
            own = slice(first, first + len(p.nodes))
            follows = p.N @ v + prescribed[i]
            if geometry.swings is not None:
                follows += np.einsum("d,ndi->ni", w[place.frame], geometry.swings.motions)
            if geometry.normals_alone:  # across the mean of the nodes' normals, as the law has it
                across = operators.blocks[i][own] @ w[place.frame]
                across -= np.einsum("ni,ni->n", follows, p.normal)
                follows = follows + across[:, None] * p.normal
            sides.append(side_result(p, forces[own], motion, follows, gap, status[own], presses))
            first = own.stop
        if geometry.interface.law.components != "cartesian":
            sides = between_bodies(geometry, sides, operators.scale, state.held)
        nodal = nodal_sides(geometry, sides)
        found = _interface_result(geometry, sides, nodal, v, state)
        results.append(replace(found, rotation=geometry.rotation(w[place.frame])))
    return told(operators.comm, deepcopy(results))  # their arrays are the user's


def _tangential_average(geometry: InterfaceGeometry, moved: Sequence[Array]) -> Array:
    """(m, gdim) mean of the tangential motions of both sides, fitted to the frame's nodes."""
    total = np.zeros((len(geometry.directions), moved[0].shape[1]))
    for p, motion in zip(geometry.pairs, moved, strict=True):
        mean = motion.mean(axis=0)
        total += 0.5 * (mean + p.fit.solve(p.N.T @ (motion - mean)))
    normal = geometry.directions[:, -1]
    return total - np.einsum("mi,mi->m", total, normal)[:, None] * normal


def _interface_result(
    geometry: InterfaceGeometry,
    sides: Sequence[SideResult],
    nodal: tuple[SideResult, ...],
    v: Array,
    state: InterfaceState,
) -> InterfaceResult:
    """Of the sides, and of these with values at nodes."""
    side, pairs, law = sides[0], geometry.pairs[0], geometry.interface.law
    presses = law.opens and not state.held.any()
    obstacle, frame = geometry.interface.obstacle, geometry.frame
    if obstacle is not None:
        side = nodal[0]
        if obstacle.everywhere:  # about a mean
            shift = side.area @ side.u / side.area.sum()
        else:
            shift = np.array(obstacle.pose(v.shape[1])[0]) + v.sum(axis=0)
        density = None if side.density is None else along_normals(side.density, side.normal)
        own = side.normal_force, side.area, side.tangential_force, side.status
        return InterfaceResult(None, nodal, None, *own, presses, shift, frame_density=density)
    assert frame is not None
    cartesian, normal = law.components == "cartesian", geometry.normals
    force, friction = _at_frame(geometry, sides, normal)
    area = pairs.N.T @ side.area
    if geometry.normals_alone:
        force = pairs.N.T @ (side.normal_force / np.linalg.norm(pairs.N @ normal, axis=1))
    status = np.full(len(force), STICK)
    if not cartesian:
        pressed = force > FELT * np.abs(force).max(initial=0.0)
        if law.gives or law.slips:
            pressed = pressed | state.own.holds | (not law.opens)
        status = np.where(pressed, CLOSED, OPEN)
        if law.slips:
            told = pressed & (state.own.status != OPEN)
            status = np.where(told, state.own.status, status)
            friction = state.share_out(friction, force)
        elif law.components == "normal":
            friction = np.zeros_like(friction)
    frame, known = displaced(frame, nodal_values(geometry, v)), geometry.certificate
    density = _frame_density(geometry, sides, normal)
    return InterfaceResult(
        frame, nodal, known, force, area, friction, status, presses, frame_density=density
    )


def _at_frame(
    geometry: InterfaceGeometry, sides: Sequence[SideResult], normal: Array
) -> tuple[Array, Array]:
    """Force along the normals (m, gdim) of the frame's nodes (m,) and the rest (m, gdim)."""
    law, shapes = geometry.interface.law, [p.N.T for p in geometry.pairs]

    def total(forces: list[Array]) -> Array:
        own = shapes[0] @ forces[0]
        return 0.5 * (own - shapes[1] @ forces[1]) if law.slips else own  # friction holds for both

    press = drag = total([s.force for s in sides])
    if law.slips and not law.gives:
        drag = total([s.tangential_force for s in sides])
        press = press - drag
    return along_normals(press, normal)[:, 0], along_normals(drag, normal)[:, 1:]


def _frame_density(
    geometry: InterfaceGeometry, sides: Sequence[SideResult], normal: Array
) -> Array | None:
    """``InterfaceResult.frame_density``, where the frame's nodes have normals (m, gdim)."""
    k = int(len(sides[1].x) < len(sides[0].x))
    density = sides[k].density
    if density is None or sides[1 - k].density is None:
        return None
    assert geometry.frame is not None
    vector = (1.0 - 2.0 * k) * (geometry.pairs[k].interpolation(geometry.frame.x) @ density)
    return along_normals(vector, normal)
