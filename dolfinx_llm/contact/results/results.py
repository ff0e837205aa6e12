"""What a solve gives per interface, the same on every rank."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import copied
from dolfinx_llm.base.sparse import diagonal, pushed
from dolfinx_llm.contact.equations.state import InterfaceState
from dolfinx_llm.contact.results.carried_frame import (
    at_carried_frame,
    halved_slips,
    with_tool_forces,
)
from dolfinx_llm.contact.results.sides import (
    FELT,
    SideResult,
    between_bodies,
    known_slips,
    less,
    nodal_sides,
    read_together,
    side_result,
)
from dolfinx_llm.design.stencils import adjacency
from dolfinx_llm.geometry.cells import facet_vectors
from dolfinx_llm.geometry.frame import Frame, displaced
from dolfinx_llm.geometry.thickness import thickness_at
from dolfinx_llm.interface.control import nodal_values
from dolfinx_llm.interface.density import along_normals
from dolfinx_llm.interface.forces import InterfaceForces, per_area
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.interface.join import Certificate
from dolfinx_llm.laws.rows import CLOSED, OPEN, STICK
from dolfinx_llm.operators.both_sides import along_supports
from dolfinx_llm.operators.system import ContactOperators

THIN = 1e-6  # of a surface's extent: what is as thin has no slopes across it
CANCELLED = 0.5  # of the area about a frame node what rows leave, below which its quotient is noise
SPARSE = 0.2  # of the cells about a frame node: where it is less an edge is near, and
SPIKE = 2.0  # of the largest pressure told next to it, beyond which its force is that edge's


@dataclass(frozen=True, eq=False)
class InterfaceResult(InterfaceForces):
    """Result of one interface; against a rigid obstacle the side's nodes take the frame's place.

    The force at frame node J is sum_p N_pJ F_p over the nodes p of side 0, with F_p what these
    exert on the frame; side 1 exerts the opposite, which is the frame's equilibrium. Its component
    along the normal of J, out of side 0, is ``frame_force``, the rest ``frame_friction``; where
    friction acts the former of the F_p along the pairs' own normals, the latter of what is left of
    them. Coulomb's law holds for these two.

    With friction along curved surfaces the law holds at the nodes of the finer side instead, and
    the frame moves with the coarser one. Forces at the frame's nodes are then those of the finer
    side's, shared by the positive entries of their rows, each turned into the tangent plane there;
    and so are areas.
    """

    frame: Frame | None  # with its displacement v, (m, gdim), of the law, see ``deformed`` [length]
    sides: tuple[SideResult, ...]  # two, in the interface's order; one against an obstacle
    certificate: Certificate | None  # of the frame; None against an obstacle
    frame_force: Array  # (m,) normal force at the frame's nodes [force]
    frame_area: Array  # (m,) tributary area of the frame's nodes, the mean of L_bᵀ of both
    # sides' [area]
    frame_friction: Array  # (m, gdim) tangential force of side 0 at the frame's nodes, where
    # friction acts the mean of both sides' [force]
    frame_status: Array  # (m,) of its nodes: 0 open, 1 stick, 2 slip, 3 closed, no friction
    # (m, 1 + gdim) pressure and tangential traction of side 0 there [force / area]
    frame_density: Array
    presses: bool = True  # the law lets bodies part: no force pulls
    # (gdim,) of an obstacle, prescribed or where a force brings it [length]; None with a frame
    displacement: Array | None = None
    rotation: Array | None = None  # (1,), (3,) of an obstacle, likewise [rad]
    firm: bool = False  # bodies cannot part, and all of the frame moves with both


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
        opens, may_pull = geometry.interface.law.opens, _may_pull(geometry, state)
        presses = opens and not may_pull.any()
        sides, first = [], 0
        pairs = along_supports(geometry.pairs, operators.free[place.rows], state.at_supports)
        for p, motion, gap in zip(pairs, moved, gaps[place.sides], strict=True):
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
        sides = read_together(geometry, sides)
        if geometry.interface.law.components != "cartesian":
            sides = between_bodies(geometry, sides, operators.scale, may_pull)
        nodal, shares = with_tool_forces(geometry, sides, nodal_sides(geometry, sides))
        if geometry.site.carrier is not None:
            nodal = halved_slips(geometry, nodal)
        if geometry.interface.law.slips:
            nodal = known_slips(geometry, nodal, operators.idle[place.rows])
        sides = less(sides, pairs, state.at_supports * multiplier[place.rows])
        found = _interface_result(geometry, sides, nodal, v, state, shares)
        rotation = geometry.rotation(w[place.frame])
        results.append(replace(found, rotation=rotation, presses=presses, firm=not opens))
    return copied(operators.comm, results)  # their arrays are the user's


def _may_pull(geometry: InterfaceGeometry, state: InterfaceState) -> Array:
    """(n,) pairs that do, but for those of a prescribed side, where the other's forces arrive."""
    return state.held & ~geometry.prescribed


def _tangential_average(geometry: InterfaceGeometry, moved: Sequence[Array]) -> Array:
    """(m, gdim) mean of the tangential motions of both sides, fitted to the frame's nodes; those
    that hardly any pair reaches follow the motion's affine part, as of bodies that turn or expand.
    """
    assert geometry.frame is not None
    x, total = geometry.frame.x, np.zeros((len(geometry.directions), moved[0].shape[1]))
    for p, motion in zip(geometry.pairs, moved, strict=True):
        met = p.N @ x
        centre, mean = met.mean(axis=0), motion.mean(axis=0)
        slopes = np.linalg.lstsq(met - centre, motion - mean, rcond=THIN)[0]
        affine = mean + (x - centre) @ slopes
        total += 0.5 * (affine + p.fit.solve(p.N.T @ (motion - p.N @ affine)))
    normal = geometry.directions[:, -1]
    return total - np.einsum("mi,mi->m", total, normal)[:, None] * normal


def _interface_result(
    geometry: InterfaceGeometry,
    sides: Sequence[SideResult],
    nodal: tuple[SideResult, ...],
    v: Array,
    state: InterfaceState,
    shares: csr_matrix | None,
) -> InterfaceResult:
    """Of the sides, and of these with values at nodes; (m, n) ``shares`` of a prescribed side."""
    side, pairs, law = sides[0], geometry.pairs[0], geometry.interface.law
    obstacle, frame = geometry.interface.obstacle, geometry.frame
    if obstacle is not None:
        side = nodal[0]
        if obstacle.everywhere:  # about a mean
            shift = side.area @ side.u / side.area.sum()
        else:
            shift = np.array(obstacle.pose(v.shape[1])[0]) + v.sum(axis=0)
        acts = per_area(side.force, side.area) if side.density is None else side.density
        own = side.normal_force, side.area, side.tangential_force, side.status
        acts = along_normals(acts, side.normal)
        return InterfaceResult(None, nodal, None, *own, acts, displacement=shift)
    assert frame is not None
    if geometry.law_side is not None:
        own = at_carried_frame(geometry, sides, state, shares)
        density = _frame_density(geometry, sides)
        if density is None:
            density = per_area(np.column_stack([own[0], own[2]]), own[1])
        frame = displaced(frame, nodal_values(geometry, v))
        return InterfaceResult(frame, nodal, geometry.certificate, *own, density)
    cartesian, normal = law.components == "cartesian", geometry.normals
    force, friction = _at_frame(geometry, sides, normal, geometry.law_shapes)
    area = geometry.law_nodes[1]
    if geometry.normals_alone:
        force = pairs.N.T @ (side.normal_force / np.linalg.norm(pairs.N @ normal, axis=1))
    if shares is not None and (k := geometry.site.prescribed) is not None:
        force = along_normals((1.0, -1.0)[k] * nodal[k].force, normal)[:, 0]
    weights = [N.maximum(0.0) for N in geometry.law_shapes]
    about = np.mean([pushed(W, p.forces) for W, p in zip(weights, geometry.pairs)], axis=0)
    # At the rim of what is covered corrected rows have entries of both signs, and may leave a node
    # next to nothing of either force or area. What acts there is the mean of the pairs about it.
    thin = area < CANCELLED * about
    near, drag = force, friction
    if thin.any():
        near, drag = _at_frame(geometry, sides, normal, weights)
    status = np.full(len(force), STICK)
    if not cartesian:
        pressed = np.where(thin, near, force) > FELT * np.abs(force).max(initial=0.0)
        if law.gives or law.slips:
            pressed = pressed | state.own.holds | (not law.opens)
        status = np.where(pressed, CLOSED, OPEN)
        if law.slips:
            known = pressed & (state.own.status != OPEN)
            status = np.where(known, state.own.status, status)
            friction = state.share_out(friction, force)
            if not law.gives:
                drag = _in_proportion(near, drag, force, friction)
        elif law.components == "normal":
            friction, drag = np.zeros((2, *friction.shape))
    density = _frame_density(geometry, sides)
    if density is None:
        acts, mean = np.column_stack([force, friction]), np.column_stack([near, drag])
        acts, over = np.where(thin[:, None], mean, acts), np.where(thin, about, area)
        density = per_area(acts, over)
        if not law.gives:  # whose force is that of the area, however little of it there is
            thickness = thickness_at(geometry.interface.thickness, frame.x)
            told = about > SPARSE * _covering(frame, thickness)
            if not told.all():
                joined, wild = _overshot(frame, told, density)
                density[wild] = per_area(joined @ acts, joined @ over)[wild]
    frame, own = displaced(frame, nodal_values(geometry, v)), (force, area, friction, status)
    return InterfaceResult(frame, nodal, geometry.certificate, *own, density)


def _at_frame(
    geometry: InterfaceGeometry,
    sides: Sequence[SideResult],
    normal: Array,
    shapes: Sequence[csr_matrix],
) -> tuple[Array, Array]:
    """Force along the normals (m, gdim) of the frame's nodes (m,) and the rest (m, gdim), the mean
    of both sides', by weights (n, m) of the nodes of each."""
    law = geometry.interface.law

    def total(forces: list[Array]) -> Array:
        return 0.5 * (pushed(shapes[0], forces[0]) - pushed(shapes[1], forces[1]))

    press = drag = total([s.force for s in sides])
    if law.slips and not law.gives:
        drag = total([s.tangential_force for s in sides])
        press = press - drag
    return along_normals(press, normal)[:, 0], along_normals(drag, normal)[:, 1:]


def _covering(frame: Frame, thickness: Array | None) -> Array:
    """(m,) area of a frame's cells about its nodes, of bodies in the plane with their thickness
    (m,); None: 1 [area]."""
    whole = np.linalg.norm(facet_vectors(frame.x, frame.corners, thickness), axis=2)
    return np.bincount(frame.corners.ravel(), whole.ravel(), len(frame.x))


def _overshot(frame: Frame, told: Array, density: Array) -> tuple[csr_matrix, Array]:
    """Which of a frame's nodes share cells (m, m), and (m,) nodes about which little is covered and
    that say far more than all others there: an edge is next to them, whose force is no pressure.

    Args:
        told: (m,) nodes about which enough is covered.
        density: (m, k) what they say [force / area].
    """
    joined = adjacency(frame.corners, len(told))
    size = np.linalg.norm(density, axis=1)
    most = (joined @ diagonal(told * size)).max(axis=1).toarray().ravel()
    return joined, ~told & (most > 0.0) & (size > SPIKE * most)


def _in_proportion(near: Array, drag: Array, force: Array, friction: Array) -> Array:
    """(m, gdim) friction that goes with the normal force (m,) about a frame node as the node's own
    (m, gdim) does with its (m,), and is no larger than what drags there (m, gdim)."""
    own = near[:, None] * per_area(friction, force)
    size, most = (np.linalg.norm(a, axis=1) for a in (own, drag))
    return own * np.minimum(1.0, most / np.where(size > 0.0, size, 1.0))[:, None]


def _frame_density(geometry: InterfaceGeometry, sides: Sequence[SideResult]) -> Array | None:
    """``InterfaceResult.frame_density`` between second-order bodies: of the side with fewer nodes,
    the mean of both where they have as many; on a prescribed side, whose nodes may be many more,
    the other's; None: neither."""
    assert geometry.frame is not None
    on = geometry.site.prescribed
    if on is not None:
        side, at_frame = sides[1 - on], geometry.pairs[1 - on].interpolation(geometry.frame.x)
        acts = at_frame @ per_area((1.0, -1.0)[1 - on] * side.force, side.area)
        return along_normals(acts, geometry.normals)
    found, least = [], min(len(side.x) for side in sides)
    for sign, p, side in zip((1.0, -1.0), geometry.pairs, sides, strict=True):
        if side.density is None:
            return None
        if len(side.x) == least:
            found.append(sign * (p.interpolation(geometry.frame.x) @ side.density))
    return along_normals(np.mean(found, axis=0), geometry.normals)
