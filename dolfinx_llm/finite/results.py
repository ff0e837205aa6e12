"""What a nonlinear solve gives per interface, in the current configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal
from dolfinx_llm.finite.densities import densities
from dolfinx_llm.finite.frame.divided_sides import AtNodes, DividedSides
from dolfinx_llm.finite.frame.self_sides import SelfSides
from dolfinx_llm.finite.frame_side import (
    gap_of_frame,
    mover_at_frame,
    shapes_on_frame,
    status_of_frame,
    with_tool_forces,
)
from dolfinx_llm.finite.obstacles.obstacle_contact import ObstacleContact, ObstaclePlace
from dolfinx_llm.finite.pairs.terms import ContactTerms, MovingContact
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.pairs import control_matrices
from dolfinx_llm.interface.density import along_normals
from dolfinx_llm.interface.forces import InterfaceForces, per_area
from dolfinx_llm.laws.rows import OPEN

TENSILE = 1e-6  # of the largest normal force: less is rounding


@dataclass(frozen=True, eq=False)
class MovingSideResult:
    """One side of an interface; n nodes of its surface, sorted by position as drawn.

    ``slip`` is the whole relative motion along the surface in the last load step, in however many
    increments, with friction or without: where a node is against where the point is now that it
    faced at the start, or touched first. Of nodes that carry the frame see ``frame_slip``.
    """

    X: Array  # (n, gdim) as drawn [length]
    x: Array  # (n, gdim) now [length]
    force: Array  # (n, gdim) forces that the body exerts on the frame [force]
    normal: Array  # (n, gdim) frame normal, out of this side; 0 where it has no place
    normal_force: Array  # (n,) positive in compression [force]
    # (n,) to the other body along the normal, 0 where closed; inf where nothing lies opposite
    # within the size of a facet [length]
    gap: Array
    # (n,) to the frame along the normal: 0 of the side that carries it [length]
    frame_gap: Array
    slip: Array  # (n, gdim) on the other body in the last load step, 0 where open [length]
    status: Array  # (n,) 0 open, 1 stick, 2 slip, 3 closed without friction
    area: Array  # (n,) tributary area of what both surfaces cover [area]
    pressing: Array  # (n,) normal_force, of second order of its control values: see ``SideResult``
    facets: Array  # (m, k) first-order facets of the surface, between all of its nodes
    density: Array | None = None  # (n, gdim) of the forces on what both surfaces cover, see
    # ``density_at_nodes``; None at first order, where it is force per area [force / area]

    @property
    def drawn(self) -> Array:
        """(n, gdim) X [length]."""
        return self.X

    @property
    def u(self) -> Array:
        """(n, gdim) displacements [length]."""
        return self.x - self.X

    @property
    def tangential_force(self) -> Array:
        """(n, gdim) part of ``force`` across the normal now [force]."""
        along = np.einsum("ni,ni->n", self.force, self.normal)
        return self.force - along[:, None] * self.normal


@dataclass(frozen=True, eq=False)
class MovingInterfaceResult(InterfaceForces):
    """Result of one interface, in the current configuration.

    The frame's nodes are those of the coarser surface, or if that alone has sharp edges of the
    other one; ``frame.v`` is their displacement since the drawing. Forces are those of side 0.
    Against a rigid obstacle the side's nodes take the frame's place.
    """

    frame: Frame | None  # its nodes now; its normal points out of side 0; None: rigid obstacle
    sides: tuple[MovingSideResult, ...]  # in the interface's order; one against an obstacle
    frame_force: Array  # (m,) normal force at the frame's nodes [force]
    frame_area: Array  # (m,) tributary area of what both surfaces cover [area]
    frame_friction: Array  # (m, gdim) tangential force of side 0 there [force]
    # (m,) 0 open, 1 stick, 2 slip, 3 closed without friction; open where its shape function is
    # below 0.01 at all pairs in contact, though what is covered there has a pressure
    frame_status: Array
    correction: float  # largest change of a row by the design
    frame_pressure: Array  # (m,) mean pressure of the pairs about each node [force / area]
    frame_traction: Array  # (m, gdim) the same of the tangential force of side 0
    # (gdim,) of an obstacle, prescribed or where a force brings it [length]; None with a frame
    displacement: Array | None = None
    rotation: Array | None = None  # (1,), (3,) rotation vector of an obstacle, likewise [rad]
    firm = True  # the frame is one of the surfaces

    @property
    def pressure(self) -> Array:
        """(m,) contact pressure at the frame's nodes [force / area].

        That of the pairs about a node, force over covered area, weighted by the positive entries
        of their rows. ``frame_force`` over ``frame_area`` is the same where pressure is constant,
        but at the rim of contact, where little of a node's surroundings is covered, it says
        nothing. Pressures times ``frame_area`` do not add up to the force, which ``frame_force``
        and ``resultant`` tell. Between second-order bodies it is that of
        ``MovingSideResult.density`` of the frame's surface.
        """
        return self.frame_pressure

    @property
    def traction(self) -> Array:
        return self.frame_traction

    @property
    def frame_drawn(self) -> Array:
        assert self.frame is not None
        return self.frame.x - self.frame.v

    def moved(self, scale: float) -> Array:
        if self.frame is None:
            return super().moved(scale)
        return self.frame_drawn + scale * (self.frame.x - self.frame_drawn)


def moving_results(
    contact: MovingContact, z: Array, terms: ContactTerms, slip: Array, slip_there: Array
) -> MovingInterfaceResult:
    """The result of one interface; the same on every rank.

    Args:
        contact: the interface.
        z: all its coordinates [length].
        terms: in this configuration.
        slip: (n, gdim) of the pairs in the load step [length].
        slip_there: (m, gdim) of the frame's nodes.
    """
    if isinstance(contact, ObstacleContact):
        return _against_obstacle(contact, z, terms, slip)
    sides, place, status = contact.sides, terms.place, terms.status
    if place.overhang is not None:
        status = place.overhang.at_nodes(status)
    active = status != OPEN
    places = sides.in_order(*sides.split(z))
    y = sides.split(z)[1]
    shapes = shapes_on_frame(sides, z, contact.located(place))
    if sides.prescribed:
        opposite = mover_at_frame(sides, z)
        terms = with_tool_forces(sides, terms, shapes)
    forces = sides.in_order(*sides.split(-terms.force))
    outward = sides.outward(z)
    normals = sides.in_order(-place.normal, outward)
    shapes = diagonal(active) @ shapes
    at_frame = status_of_frame(shapes, status)
    loaded = at_frame != OPEN
    own_slip = np.where(active[:, None], sides.nodal @ slip, 0.0)
    slips = sides.in_order(own_slip, slip_there)
    shut, frame_gap = active & (not contact.overlaps), gap_of_frame(sides, z, place.pairs)
    if not contact.overlaps:
        frame_gap = np.where(loaded, 0.0, np.maximum(frame_gap, 0.0))
    own_gap = _at_nodes(sides, np.where(shut, 0.0, place.gap))
    gaps = sides.in_order(own_gap, frame_gap)
    to_frame = sides.in_order(_at_nodes(sides, place.gap), np.zeros(len(y)))
    own_area = (sides.control[0].T @ place.areas[0], place.areas[1])
    statuses, areas = sides.in_order(status, at_frame), sides.in_order(*own_area)
    borne = sides.nodal.T @ forces[sides.moving]
    pressing = np.einsum("ni,ni->n", borne, normals[sides.moving])
    weights = diagonal(shapes.getnnz(axis=0) > 0) @ place.N.maximum(0.0).T
    about = per_area(weights @ borne, weights @ place.areas[0])
    mean = sides.in_order(per_area(borne, place.areas[0]), -about)
    presses = _presses(contact, terms)
    density = densities(sides.surfaces, places, areas, forces, normals, mean, presses)
    if sides.prescribed:
        own = density[sides.moving]
        if own is not None and density[sides.frame] is not None:
            density[sides.frame] = -(opposite @ own)
    of = list(map(
        AtNodes, sides.surfaces, places, forces, normals, gaps, to_frame, slips, statuses, areas,
        density,
    ))  # fmt: skip
    first, second = map(_side, of)
    sign = 1.0 if sides.frame == 0 else -1.0
    total, normal = sign * forces[sides.frame], sign * outward
    force = np.einsum("mi,mi->m", total, normal)
    friction = total - force[:, None] * normal
    if terms.friction is not None:
        friction = -sign * sides.split(terms.friction)[1]
        force = np.einsum("mi,mi->m", total - friction, normal)
    cells, moving = sides.carrier.skin, (first, second)[sides.moving]
    tangential = borne - pressing[:, None] * moving.normal
    traction = -sign * per_area(weights @ tangential, weights @ place.areas[0])
    pressed = per_area(weights @ pressing[:, None], weights @ place.areas[0])[:, 0]
    own_pressed = per_area(moving.normal_force[:, None], place.areas[0])[:, 0]
    of_moving, of_frame = density[sides.moving], density[sides.frame]
    if of_moving is not None and of_frame is not None:
        own_pressed = along_normals(of_moving, moving.normal)[:, 0]
        both = along_normals(of_frame, outward)
        pressed, traction = both[:, 0], sign * both[:, 1:]
    if sides.prescribed:
        acts = per_area(forces[sides.moving], areas[sides.moving])
        acts = along_normals(acts if of_moving is None else of_moving, moving.normal)
        pressed, traction = opposite @ acts[:, 0], -sign * (opposite @ acts[:, 1:])
    if isinstance(sides, DividedSides):
        of[sides.moving] = sides.of_whole(of[sides.moving])
    drawn, origin = sides.carrier.x, sides.carrier.origin
    if isinstance(sides, SelfSides):  # both are the frame's surface
        pressed[active] = own_pressed[active]
        at_frame = np.where(active, status, at_frame)
    return MovingInterfaceResult(
        frame=Frame(y + origin, cells if sides.frame == 0 else cells[:, ::-1], v=y - drawn),
        sides=(_side(of[0]), _side(of[1])),
        frame_force=force,
        frame_area=place.areas[1],
        frame_friction=friction,
        frame_status=at_frame,
        correction=terms.delta,
        frame_pressure=pressed,
        frame_traction=traction,
    )


def _against_obstacle(
    contact: ObstacleContact, z: Array, terms: ContactTerms, slip: Array
) -> MovingInterfaceResult:
    """The result of a body on a rigid obstacle."""
    surface, place, status = contact.sides.surfaces[0], terms.place, terms.status
    assert isinstance(place, ObstaclePlace)
    x, force = (contact.sides.split(values)[0] for values in (z, -terms.force))
    C, E = contact.sides.control, contact.sides.nodal
    shut, area = (status != OPEN) & (not contact.overlaps), place.areas[0]
    gap = _at_nodes(contact.sides, np.where(shut, 0.0, place.gap))
    nodal, normal, borne = C.T @ area, -place.normal, E.T @ force
    mean, presses = per_area(borne, area), _presses(contact, terms)
    (density,) = densities([surface], [x], [nodal], [force], [normal], [mean], presses)
    gaps, slip = (gap, _at_nodes(contact.sides, place.gap)), (status != OPEN)[:, None] * (E @ slip)
    told = AtNodes(surface, x, force, normal, *gaps, slip, status, nodal, density)
    side = _side(told)
    along = along_normals(mean if density is None else density, normal)
    return MovingInterfaceResult(
        frame=None,
        sides=(side,),
        frame_force=side.normal_force,
        frame_area=side.area,
        frame_friction=force - side.normal_force[:, None] * side.normal,
        frame_status=status,
        correction=0.0,
        frame_pressure=along[:, 0],
        frame_traction=along[:, 1:],
        displacement=place.pose.shift,
        rotation=place.pose.turn,
    )


def _presses(contact: MovingContact, terms: ContactTerms) -> bool:
    """Whether bodies may part and no pair pulls. What the law says of pairs acts at the nodes along
    normals of their own, which may turn from one to the next."""
    if not contact.parts:
        return False
    force = -terms.force if terms.friction is None else terms.friction - terms.force
    at_nodes = np.einsum("ni,ni->n", contact.sides.split(force)[0], -terms.place.normal)
    pairs = contact.sides.nodal.T @ at_nodes
    return bool(pairs.min(initial=0.0) >= -TENSILE * np.abs(pairs).max(initial=0.0))


def _side(told: AtNodes) -> MovingSideResult:
    """The result of a surface."""
    surface, x, force, normal, gap, frame_gap, slip, status, area, density = told
    pressed = np.einsum("ni,ni->n", force, normal)
    pressing, facets = control_matrices(surface)[0].T @ pressed, surface.skin
    own = pressed, gap, frame_gap, slip, status, area, pressing, facets, density
    drawn, now = surface.x + surface.origin, x + surface.origin
    return MovingSideResult(drawn, now, force, normal, *own)


def _at_nodes(sides: Any, gap: Array) -> Array:
    """(n,) gaps at nodes, of those of control values; inf where one of these is."""
    there = np.isfinite(gap)
    return np.where(
        abs(sides.nodal) @ ~there > 0.0, np.inf, sides.nodal @ np.where(there, gap, 0.0)
    )
