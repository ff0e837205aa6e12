"""What a solve gives per interface, the same on every rank."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dolfinx_llm.geometry.frame import Frame, displaced
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.interface.control import at_nodes, nodal_values
from dolfinx_llm.interface.density import density_at_nodes
from dolfinx_llm.interface.forces import InterfaceForces
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.interface.join import Certificate
from dolfinx_llm.laws.rows import CLOSED, OPEN, STICK
from dolfinx_llm.operators.system import ContactOperators

FELT = 1e-9  # part of the largest force or motion, below which there is none
IDLE = 1e-14  # force over the surfaces' stiffness times their motion that is rounding


@dataclass(frozen=True, eq=False)
class SideResult:
    """One side of an interface; n nodes that may touch, sorted by position.

    A node is closed where it presses, or where the bodies touch without force; with friction it has
    the status of the frame node next to it. ``slip`` is counted from the drawing, and to the frame,
    which moves as the mean of both bodies do: of a sliding interface it is half of the way that one
    body goes along the other. Against a rigid obstacle that takes the frame's place.
    """

    x: np.ndarray  # (n, gdim) node positions X [length]
    u: np.ndarray  # (n, gdim) their displacements [length]
    force: np.ndarray  # (n, gdim) forces that the body exerts on the frame [force]
    normal: np.ndarray  # (n, gdim) frame normal, out of this side
    normal_force: np.ndarray  # (n,) positive in compression [force]
    gap: np.ndarray  # (n,) distance to the other body along the normal, 0 where closed [length]
    frame_gap: np.ndarray  # (n,) the same to the frame, which lies between the bodies [length]
    slip: np.ndarray  # (n, gdim) tangential motion relative to the frame, 0 where open [length]
    status: np.ndarray  # (n,) 0 open, 1 stick, 2 slip, 3 closed without friction
    area: np.ndarray  # (n,) tributary area: the force of unit pressure [area]
    facets: np.ndarray  # (m, c) corners of the facets that lie between these nodes
    density: np.ndarray | None = None  # (n, gdim) of the forces on the surface, see
    # ``density_at_nodes``; None at first order, where the frame's are [force / area]

    @property
    def drawn(self) -> np.ndarray:
        """(n, gdim) x [length]."""
        return self.x

    @property
    def tangential_force(self) -> np.ndarray:
        """(n, gdim) part of the force in the contact plane [force]."""
        return self.force - self.normal_force[:, None] * self.normal


@dataclass(frozen=True, eq=False)
class InterfaceResult(InterfaceForces):
    """Result of one interface; against a rigid obstacle the side's nodes take the frame's place.

    The force at frame node J is sum_p N_pJ F_p over the nodes p of side 0, with F_p what these
    exert on the frame; side 1 exerts the opposite, which is the frame's equilibrium. Its component
    along the normal of J, out of side 0, is ``frame_force``, the rest ``frame_friction``. Coulomb's
    law holds for these two.
    """

    frame: Frame | None  # with its displacement v, (m, gdim) [length]
    sides: tuple[SideResult, ...]  # two, in the interface's order; one against an obstacle
    certificate: Certificate | None  # of the frame; None against an obstacle
    frame_force: np.ndarray  # (m,) normal force at the frame's nodes [force]
    frame_area: np.ndarray  # (m,) tributary area of the frame's nodes, L_bᵀ of the sides' [area]
    frame_friction: np.ndarray  # (m, gdim) tangential force of side 0 at the frame's nodes, where
    # friction acts the mean of both sides' [force]
    frame_status: np.ndarray  # (m,) of its nodes: 0 open, 1 stick, 2 slip, 3 closed, no friction
    presses: bool = True  # the law lets bodies part: no force pulls
    # (gdim,) of an obstacle, prescribed or where a force brings it [length]; None with a frame
    displacement: np.ndarray | None = None
    rotation: np.ndarray | None = None  # (1,), (3,) of an obstacle, likewise [rad]
    frame_density: np.ndarray | None = None  # (m, 1 + gdim) see ``InterfaceForces``


def collect_results(
    operators: ContactOperators,
    u: np.ndarray,
    multiplier: np.ndarray,
    w: np.ndarray,
    states: Any = None,
) -> list[InterfaceResult]:
    """Results of all interfaces; everything is the same on every rank.

    Args:
        operators: of the interfaces.
        u: (n_local,) displacement of this rank.
        multiplier, w: (n,), (m,) multipliers and frame unknowns of all interfaces.
        states: per interface its ``InterfaceState``; None: all tied.
    """
    motions = [operators.motion(side, u) for side in range(len(operators.pairs))]
    gaps, results = operators.side_gaps(), []
    prescribed = operators.obstacle_motions()
    for i, (geometry, place) in enumerate(zip(operators.geometries, operators.places, strict=True)):
        m, d, gdim = geometry.directions.shape
        moved = motions[place.sides]
        v = np.einsum("md,mdi->mi", w[place.frame].reshape(m, d), geometry.directions)
        if geometry.normals_alone:
            # Without tangential unknowns the frame follows both bodies.
            v = v + _tangential_average(geometry, moved)
        state, c = states and states[i], geometry.pairs[0].base.shape[1]
        forces = multiplier[place.rows].reshape(-1, c)
        status = state.pair_status() if state else np.full(len(forces), STICK)
        presses = geometry.interface.law.opens and not (state and state.held.any())
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
            sides.append(_side_result(p, forces[own], motion, follows, gap, status[own], presses))
            first = own.stop
        if geometry.interface.law.components != "cartesian":
            held = state.held if state else np.zeros(len(forces), dtype=bool)
            sides = _between_bodies(geometry, sides, operators.scale, held)
        nodal = _at_nodes(geometry, sides)
        found = _interface_result(geometry, sides, nodal, v, state)
        results.append(replace(found, rotation=geometry.rotation(w[place.frame])))
    return results


def _at_nodes(geometry: InterfaceGeometry, sides: Sequence[SideResult]) -> tuple[SideResult, ...]:
    """The sides with values at nodes, where those of second-order bodies are control values."""
    found = []
    for p, side in zip(geometry.pairs, sides, strict=True):
        if p.control is not None:
            force = at_nodes(p, side.force)
            side = replace(
                side,
                u=p.control @ side.u,
                force=force,
                normal_force=np.einsum("ni,ni->n", force, side.normal),
                gap=p.control @ side.gap if geometry.rigid else side.gap,
                frame_gap=p.control @ side.frame_gap,
                slip=p.control @ side.slip,
                area=at_nodes(p, side.area),
            )
        found.append(side)
    return tuple(found)


def _between_bodies(
    geometry: InterfaceGeometry, sides: list[SideResult], scale: float, held: np.ndarray
) -> list[SideResult]:
    """The sides with gaps between the bodies, and open where these are apart and none of the pairs
    held (n,), which may pull.

    A node may lie on the frame, which is free there, and the other body be away: what it carries
    is rounding then, of the surfaces' stiffness ``scale`` times their motion.
    """
    gaps = [side.frame_gap for side in sides]
    force = max(np.abs(side.normal_force).max(initial=0.0) for side in sides)
    size = max(np.abs(a).max(initial=0.0) for side in sides for a in (side.u, side.frame_gap))
    nothing, law = IDLE * scale * size, geometry.interface.law
    least = max(FELT * force, nothing)
    presses = [(side.status != OPEN) & (side.normal_force > least) for side in sides]
    if law.gives or not np.concatenate(presses).all():  # where all press there are none
        both = zip(geometry.pairs, sides, strict=True)
        x = [s.x + (s.u if p.control is None else p.control @ s.u) for p, s in both]
        for k, N in enumerate(geometry.opposite):
            across = N @ x[1 - k] - x[k]
            gaps[k] = np.einsum("ni,ni->n", across, sides[k].normal)
    out, ends = [], np.cumsum([len(side.x) for side in sides])
    each = zip(sides, gaps, presses, np.split(held, ends[:-1]), strict=True)
    for side, gap, pressed, pulls in each:
        closed = (side.status != OPEN) & (pressed | (gap <= FELT * size) | pulls)
        if not law.opens:
            closed[:] = True
        idle = ~closed & (np.linalg.norm(side.force, axis=1) <= nothing)
        out.append(
            replace(
                side,
                force=np.where(idle[:, None], 0.0, side.force),
                normal_force=np.where(idle, 0.0, side.normal_force),
                gap=gap if law.gives else np.where(closed, 0.0, np.maximum(gap, 0.0)),
                slip=np.where(closed[:, None], side.slip, 0.0),
                status=np.where(closed, side.status, OPEN),
            )
        )
    return out


def _tangential_average(geometry: InterfaceGeometry, moved: Sequence[np.ndarray]) -> np.ndarray:
    """(m, gdim) mean of the tangential motions of both sides, fitted to the frame's nodes."""
    total = np.zeros((len(geometry.directions), moved[0].shape[1]))
    for p, motion in zip(geometry.pairs, moved, strict=True):
        mean = motion.mean(axis=0)
        total += 0.5 * (mean + p.fit.solve(p.N.T @ (motion - mean)))
    normal = geometry.directions[:, -1]
    return total - np.einsum("mi,mi->m", total, normal)[:, None] * normal


def _side_result(
    pairs: ContactPairs,
    multiplier: np.ndarray,
    u: np.ndarray,
    follows: np.ndarray,
    gap: np.ndarray,
    status: np.ndarray,
    presses: bool,
) -> SideResult:
    """One side's result from its multipliers (n, c), u and the motion of the point it touches
    (n, gdim), the initial gap that counts (n, gdim) and the status (n,); whether no pair pulls."""
    force = np.einsum("nc,nci->ni", multiplier, pairs.base)
    motion = u - follows
    normal_motion = np.einsum("ni,ni->n", motion, pairs.normal)
    return SideResult(
        x=pairs.X,
        u=u,
        force=force,
        normal=pairs.normal,
        normal_force=np.einsum("ni,ni->n", force, pairs.normal),
        gap=np.zeros(len(force)),
        frame_gap=-normal_motion - np.einsum("ni,ni->n", gap, pairs.normal),
        slip=motion - normal_motion[:, None] * pairs.normal,
        status=status,
        area=pairs.forces,
        facets=pairs.facets,
        density=density_at_nodes(pairs, force, presses),
    )


def _interface_result(
    geometry: InterfaceGeometry,
    sides: Sequence[SideResult],
    nodal: tuple[SideResult, ...],
    v: np.ndarray,
    state: Any,
) -> InterfaceResult:
    """Of the sides, and of these with values at nodes."""
    side, pairs, law = sides[0], geometry.pairs[0], geometry.interface.law
    presses = law.opens and not (state and state.held.any())
    obstacle, frame = geometry.interface.obstacle, geometry.frame
    if obstacle is not None:
        side = nodal[0]
        if obstacle.everywhere:  # about a mean
            shift = side.area @ side.u / side.area.sum()
        else:
            shift = np.array(obstacle.pose(v.shape[1])[0]) + v.sum(axis=0)
        density = None if side.density is None else _along(side.density, side.normal)
        own = side.normal_force, side.area, side.tangential_force, side.status
        return InterfaceResult(None, nodal, None, *own, presses, shift, frame_density=density)
    assert frame is not None
    cartesian, normal = law.components == "cartesian", geometry.normals
    total = pairs.N.T @ side.force
    if law.slips:  # what friction holds for
        total = 0.5 * (total - geometry.pairs[1].N.T @ sides[1].force)
    force, area = np.einsum("mi,mi->m", total, normal), pairs.N.T @ side.area
    friction = total - force[:, None] * normal
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


def _frame_density(
    geometry: InterfaceGeometry, sides: Sequence[SideResult], normal: np.ndarray
) -> np.ndarray | None:
    """``InterfaceResult.frame_density``, where the frame's nodes have normals (m, gdim)."""
    k = int(len(sides[1].x) < len(sides[0].x))
    density = sides[k].density
    if density is None or sides[1 - k].density is None:
        return None
    assert geometry.frame is not None
    vector = (1.0 - 2.0 * k) * (geometry.pairs[k].interpolation(geometry.frame.x) @ density)
    return _along(vector, normal)


def _along(vector: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(m, 1 + gdim) the part of vectors along normals (m, gdim), and what is left."""
    part = np.einsum("mi,mi->m", vector, normal)[:, None]
    return np.column_stack([part, vector - part * normal])
