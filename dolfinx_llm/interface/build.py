"""All that follows from an interface's geometry: surfaces, common area, frame, design, pairs."""

import logging
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.log import log, warn_of
from dolfinx_llm.base.parallel import chosen
from dolfinx_llm.base.timing import Clock
from dolfinx_llm.design.rises import rises
from dolfinx_llm.geometry.loads import NodalLoads, loads_in_contact
from dolfinx_llm.geometry.overlap_flat import common_area, local_bases
from dolfinx_llm.geometry.pairs import ContactPairs, locate_pairs
from dolfinx_llm.geometry.pieces import Piece, separated
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.against import (
    against_obstacle,
    check_tied_to_mean,
    loaded,
    under_force,
)
from dolfinx_llm.interface.carrier import (
    at_own_nodes,
    check_carried,
    residual_of,
    say_carrier,
    with_carrier,
    with_other_carrier,
)
from dolfinx_llm.interface.choices import Interface
from dolfinx_llm.interface.control import in_control_values, with_control
from dolfinx_llm.interface.frames import choose_frame, common_order, move_nodes
from dolfinx_llm.interface.geometry import InterfaceGeometry, describe
from dolfinx_llm.interface.join import Part, joined, whole_piece
from dolfinx_llm.interface.nearer import balanced_parts
from dolfinx_llm.interface.rows import balanced, bent_pairs, designed, say_left
from dolfinx_llm.interface.shared import check_pairs, shared_by, shared_nodes
from dolfinx_llm.interface.site import (
    Site,
    check_order,
    find_site,
    places,
    say_straight,
    with_law,
)
from dolfinx_llm.interface.supports import in_supports_planes, kept_nodes, straight
from dolfinx_llm.interface.touching import check_flat, find_pieces


def build_interface(
    interface: Interface, spaces: Sequence[Any], fixed: Sequence[Array] | None = None
) -> InterfaceGeometry:
    """Surfaces, common area, frame, design and pairs of an interface. Collective. What follows
    from the surfaces is found on rank 0 and told: rounding must not choose otherwise elsewhere.
    Per space (n_owned dofs,) which are fixed."""
    clock = Clock()
    site = find_site(interface, spaces, fixed)
    clock.stop("surfaces")
    return build(site, clock)


def build_interfaces(
    interfaces: Sequence[Interface], spaces: Sequence[Any], fixed: Sequence[Array]
) -> list[InterfaceGeometry]:
    """All interfaces of a problem; as of ``build_interface``. Ties whose rows are corrected are
    built again where other interfaces have some of their nodes, which then keep theirs."""
    found = [build_interface(interface, spaces, fixed) for interface in interfaces]
    check_pairs(found)
    for i, shared in enumerate(shared_nodes(found)):
        ties, certificate = found[i].interface.law.ties, found[i].certificate
        corrected = certificate is not None and certificate.largest_correction > 0.0
        if ties and corrected and any(nodes.any() for nodes in shared):
            found[i] = build(replace(found[i].site, shared=shared))
    return with_control(found)


def build(site: Site, clock: Clock | None = None) -> InterfaceGeometry:
    """Common area, frame, design and pairs of surfaces where they are now."""
    clock = clock or Clock()
    interface, whole = site.interface, site.whole
    notes: list[str] = []
    check_order(interface, whole)
    say_straight(interface, whole, notes)
    if interface.obstacle is not None:
        return build_against(site, notes, clock)
    find = partial(_find_parts, site, notes, clock)
    found = chosen(site.comm, find, given=interface.thickness)
    parts, rims, of_pieces, notes, clock = found
    curved = any(part.piece.plane is None for part in parts)
    site = with_law(replace(site, **of_pieces), curved)
    return assembled(site, parts, rims, notes, clock)


def _find_parts(site: Site, notes: list[str], clock: Clock) -> tuple[Any, ...]:
    """What is built of the pieces that touch, per side (n,) nodes at a rim that is too steep and
    those that several pieces or other interfaces have, which side carries the frame, ``notes`` and
    ``clock``."""
    interface, whole = site.interface, site.whole
    pieces, rims = find_pieces(whole, interface.law.opens, interface.name, notes)
    if len(pieces) > 1 and interface.frame is not None:
        pieces = [whole_piece(pieces)]
    clock.stop("facing facets")
    site, parts, said = balanced_parts(site, pieces, partial(_build_parts, site, clock))
    notes += say_carrier(site) + said
    for part in parts:
        if part.piece.plane is None and site.prescribed is None:
            say_left(interface, part, notes)
    of_pieces = {name: getattr(site, name) for name in ("shared", "carrier", "prescribed")}
    return parts, rims, of_pieces, notes, clock


def _build_parts(
    site: Site, clock: Clock, pieces: Sequence[Piece]
) -> tuple[Site, list[Part], list[str]]:
    """The site with what follows from pieces that touch, and ``_build_pieces``."""
    site = with_law(with_carrier(site, pieces), any(piece.plane is None for piece in pieces))
    if site.interface.frame is None:
        pieces = [part for piece in pieces for part in separated(piece, site.whole)]
        site = replace(site, shared=shared_by(pieces, site))
    parts, said = _build_pieces(site, pieces, clock)
    if (other := with_other_carrier(site, parts)) is not None:
        with suppress(ContactError):  # a frame there may not do
            again = _build_pieces(other, pieces, clock)
            if residual_of(again[0]) < residual_of(parts):
                site, (parts, said) = other, again
    check_carried(site, parts)
    return site, parts, said


def _build_pieces(
    site: Site, pieces: Sequence[Piece], clock: Clock
) -> tuple[list[Part], list[str]]:
    """What is built of all pieces, and what is to be said of that."""
    parts, notes = list[Part](), list[str]()
    for piece in pieces:  # one frame has cells of one kind
        corners = parts[0].frame.element.corners if parts else None
        parts.append(build_piece(site, piece, notes, clock, corners))
    return parts, notes


def build_against(site: Site, notes: list[str], clock: Clock) -> InterfaceGeometry:
    """A body against a rigid obstacle."""
    obstacle, name = site.interface.obstacle, site.interface.name
    assert obstacle is not None

    def found() -> tuple[Any, ...]:
        return *against_obstacle(obstacle, site.whole[0], name, notes), notes

    pairs, rim, notes = chosen(site.comm, found, given=site.interface.thickness)
    clock.stop("surfaces")
    return assembled(site, (), [rim], notes, clock, pairs)


def assembled(
    site: Site,
    parts: Sequence[Part],
    whole_rims: Sequence[Array],
    notes: Sequence[str],
    clock: Clock,
    alone: ContactPairs | None = None,
) -> InterfaceGeometry:
    """The geometry of an interface from what was built of its pieces, or of pairs ``alone`` against
    an obstacle, with the base vectors and frame directions that the law needs; per side (n,) nodes
    at a rim that is too steep."""
    interface, law, gdim = site.interface, site.interface.law, site.whole[0].x.shape[1]
    pairs: Sequence[ContactPairs] = () if alone is None else (alone,)
    frame, base, certificate = None, np.empty((0, gdim, gdim)), None
    if alone is None:
        pairs, frame, base, certificate = joined(site.whole, parts)
    notes = [*notes]
    if not law.ties:
        drawn, held = [p.normal for p in pairs], frame is None or site.prescribed is not None
        pairs = [in_control_values(p, frame, held) for p in pairs]
        if held:
            pairs = in_supports_planes(site, pairs, drawn)
        for side in site.whole:
            _say_straight(side, interface.name, notes)
    rims = [
        rim[places(side, p.surface)][p.nodes]
        for rim, side, p in zip(whole_rims, site.whole, pairs, strict=True)
    ]
    if site.scalar:
        pairs, base = [scalar_pairs(p) for p in pairs], np.ones((len(base), 1, 1))
    elif law.components != "cartesian":
        first = gdim - 1 if law.components == "normal" else 0
        signs = (1.0, -1.0)
        pairs = [
            replace(p, base=(sign * local_bases(sign * p.normal))[:, first:])
            for p, sign in zip(pairs, signs)
        ]
        base = base[:, first:]
    else:
        base = np.broadcast_to(np.eye(gdim), base.shape)
    given: tuple[bool, ...] = ()
    swings = None
    if interface.obstacle is not None:
        given = loaded(interface.obstacle, gdim)
        check_tied_to_mean(interface.name, interface.obstacle, law)
        own, base, swings = under_force(interface.obstacle, pairs[0], site.comm)
        if any(given[gdim:]) and not law.ties:
            raise ContactInputError(
                f"interface {interface.name}: moment={interface.obstacle.moment!r} is of the rigid "
                "end of a body, law=Tied(); an obstacle that bodies part from turns as prescribed"
            )
        pairs = [own]
    geometry = InterfaceGeometry(
        interface, tuple(p.surface for p in pairs), site.spaces, tuple(pairs), frame, base,
        float(pairs[0].forces.sum()), certificate, tuple(rims), tuple(notes), clock.times,
        site, tuple(parts), given, swings,
    )  # fmt: skip
    if log.isEnabledFor(logging.INFO):
        stages = ", ".join(f"{stage} {seconds:.3g} s" for stage, seconds in clock.times.items())
        log.info("%s\n    %s", "\n".join(describe(geometry)).strip(), stages)
    return geometry


def _say_straight(side: Surface, name: str, notes: list[str]) -> None:
    """Say how far nodes of straight facets lie below a curved surface, which gaps take for real."""
    below = float(rises(side).max(initial=0.0))
    if below > 0.0:
        text = (
            f"{side.name} is drawn curved, by straight facets: nodes of second order between "
            f"corners lie up to {below:.3g} below the surface that these are on, and gaps and "
            "pressures are those of such facets. Make the mesh one of second order, as by gmsh's "
            "setOrder(2)"
        )
        warn_of(name, text, notes)


def scalar_pairs(pairs: ContactPairs) -> ContactPairs:
    """Pairs of a scalar field, which has one component: multipliers are what flows out of side 0,
    into side 1."""
    sign = pairs.base[:, :1, :1]
    return replace(pairs, base=sign, normal=sign[:, 0], gap=np.zeros((len(sign), 1)))


def build_piece(
    site: Site,
    piece: Piece,
    notes: list[str],
    clock: Clock,
    corners: int | None,
) -> Part:
    """Common area, frame, design and pairs of one piece of two surfaces. A predicted frame has
    cells of so many corners, or those of the coarser side."""
    interface, law, plane = site.interface, site.interface.law, piece.plane
    sides = piece.parts(site.whole)
    # Where a curved tool is prescribed supports bear what does not balance.
    designs = site.prescribed is None or all(straight(side) for side in sides)
    area: Any = None
    order = common_order(site, sides)
    if plane is None:  # curved: vector areas, smooth rows, balance in least squares
        if interface.design == "positions":
            raise ContactInputError("design='positions' needs flat sides; use 'weights' or 'auto'")
        loads, vectors = loads_in_contact(sides, law.opens, order)
    else:
        if not law.opens:
            check_flat(sides, plane, "Tied() is for surfaces that touch")
        area = common_area(sides[0], sides[1], plane)
        passes = min(order, *(side.element.order for side in sides))  # a tool's is its own
        loads = [NodalLoads.over(side, plane, area, passes) for side in sides]
    clock.stop("patch forces")
    touched = [load.touched for load in loads]
    frame, note, reach = choose_frame(site, sides, touched, plane, area, corners)
    notes.append(note)
    clock.stop("frame")
    if interface.design == "positions" and frame.gdim == 3:
        frame = move_nodes(frame, sides, [load.forces for load in loads])
        notes.append("design: frame nodes moved (positions)")
        clock.stop("design")
    pairs = locate_pairs(sides, loads, frame, reach, plane)
    if site.prescribed is not None:
        pairs[site.prescribed] = at_own_nodes(pairs[site.prescribed], frame)
    clock.stop("location")
    if plane is None and order > 1:
        pairs, certificate, normals = bent_pairs(
            interface, frame, pairs, vectors, notes, kept_nodes(site, pairs), designs
        )
        base = local_bases(normals)
    elif plane is None:
        pairs, certificate, normals = balanced(interface, frame, pairs, vectors, notes, designs)
        base = local_bases(normals)
    else:
        keep = kept_nodes(site, pairs)
        pairs, certificate = designed(interface, frame, plane, pairs, notes, keep, designs)
        base = np.broadcast_to(plane.base, (len(frame.x), *plane.base.shape))
    clock.stop("design")
    if plane is None:
        pairs = in_supports_planes(site, pairs)
    return Part(piece, tuple(pairs), frame, base, certificate)
