"""Interfaces and follower loads at finite deformation, made of the user's choices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import chosen, collective, copied
from dolfinx_llm.finite.frame.design import Design
from dolfinx_llm.finite.frame.divided_sides import DividedSides, where_sharp
from dolfinx_llm.finite.frame.self_sides import SelfSides
from dolfinx_llm.finite.frame.sides import Sides
from dolfinx_llm.finite.load_step import NewtonState, Placed
from dolfinx_llm.finite.newton import NewtonSteps
from dolfinx_llm.finite.obstacles.mean_obstacle import MovingMean
from dolfinx_llm.finite.obstacles.obstacle_contact import ObstacleContact, ObstacleFriction, OneSide
from dolfinx_llm.finite.obstacles.pressed_obstacle import Pressed, PressedFriction
from dolfinx_llm.finite.obstacles.tied_obstacle import TiedObstacle
from dolfinx_llm.finite.own_laws.law_contact import LawOnFrame, LawOnObstacle, LawOnPressed
from dolfinx_llm.finite.pairs.friction_contact import FrictionContact
from dolfinx_llm.finite.pairs.normal_contact import NormalContact
from dolfinx_llm.finite.pairs.terms import MovingContact
from dolfinx_llm.finite.pairs.tied_contact import TiedContact
from dolfinx_llm.finite.results import MovingInterfaceResult, moving_results
from dolfinx_llm.finite.start_checks import check_start
from dolfinx_llm.geometry.surface import Surface, extract_surface
from dolfinx_llm.interface.against import check_tied_to_mean, checked_clearance, loaded
from dolfinx_llm.interface.choices import Interface, SelfContact
from dolfinx_llm.interface.obstacles import MeanDisplacement
from dolfinx_llm.interface.shared import check_once
from dolfinx_llm.interface.site import Site, find_site, space_of
from dolfinx_llm.interface.supports import prescribed_side
from dolfinx_llm.interface.tool_forces import check_beside
from dolfinx_llm.laws.answers import kept_by
from dolfinx_llm.laws.coulomb import Coulomb
from dolfinx_llm.laws.frictionless import Frictionless
from dolfinx_llm.laws.law import Law
from dolfinx_llm.laws.rows import LawNodes
from dolfinx_llm.laws.tied import Tied
from dolfinx_llm.operators.numbering import BodyDofs
from dolfinx_llm.problem.law_nodes import nodes_of

BUILT_IN = (Tied, Frictionless, Coulomb)
AGAINST: dict[tuple[bool, bool], type[ObstacleContact]] = {  # with friction; under a force
    (False, False): ObstacleContact,
    (True, False): ObstacleFriction,
    (False, True): Pressed,
    (True, True): PressedFriction,
}
FAR_OFF = 1e3  # of their size, from which on surfaces lie far from the origin


def contact_of(interface: Interface, dofs: BodyDofs) -> Placed:
    """An interface with its law, on its surfaces as drawn; collective.

    Args:
        interface: the user's choices.
        dofs: of the bodies.

    Raises:
        ContactInputError: choices that are not there at finite deformation.
    """
    if interface.frame is not None:
        raise ContactInputError(
            "at finite deformation the frame's nodes are those of the coarser surface: leave "
            "frame=None"
        )
    if isinstance(interface.law, Coulomb) and interface.law.method != "newton":
        raise ContactInputError(
            f"law={checks.shown(interface.law)}: at finite deformation choose method='newton'"
        )
    if isinstance(interface.law, Coulomb) and interface.law.dynamic is not None:
        raise ContactInputError(
            f"law={checks.shown(interface.law)}: a dynamic coefficient is for small deformation: "
            "the moving frame keeps no state of its nodes from step to step. Leave dynamic=None"
        )
    if interface.shift is not None:
        raise ContactInputError("shift: periodic bodies are for small deformation")
    tie = interface.law
    if isinstance(tie, Tied) and (hasattr(tie.gap, "value") or tie.given_gap):
        raise ContactInputError(
            f"law={tie}: a given gap is for small deformation, move supports instead"
        )
    if interface.obstacle is not None:
        return _against(interface, dofs)
    if isinstance(interface, SelfContact):
        return _on_itself(interface, dofs)
    if interface.design == "positions":
        raise ContactInputError(
            'design="positions": the frame moves with the bodies, choose "auto", "weights" or None'
        )
    site, frame = _led(interface, dofs)
    site = replace(site, whole=near(site.whole))
    may = frame is None and interface.law.opens and not _is_asked(interface.law)
    sharp = chosen(dofs.comm, partial(where_sharp, site.whole)) if may else None
    divided = sharp and DividedSides.with_parts(site.whole, *sharp)
    return _on_frame(interface, divided or Sides.of(site.whole, frame), site, dofs)


def led_otherwise(interface: Interface, placed: Placed, dofs: BodyDofs) -> bool:
    """Whether supports lead a side as a whole that they did not lead where contact was placed, or
    none any more: another surface is to carry the frame; collective."""
    if interface.obstacle is not None or isinstance(interface, SelfContact):
        return False
    return _led(interface, dofs)[1] != placed.led


def _led(interface: Interface, dofs: BodyDofs) -> tuple[Site, int | None]:
    """Two surfaces, and which of them supports move as a whole; collective."""
    site = find_site(interface, dofs.spaces, dofs.fixed_by_space())
    return site, chosen(dofs.comm, partial(prescribed_side, site, site.whole))


def _is_asked(law: Law) -> bool:
    """Whether a law is one's own that is asked for forces, and not for its flags alone."""
    flags = law.components == "normal" and law.closes_gap and not law.gives
    return type(law) not in BUILT_IN and not flags


def _on_frame(interface: Interface, sides: Sides, site: Site, dofs: BodyDofs) -> Placed:
    """Two surfaces of which one carries the frame; as of ``contact_of``."""
    frame = sides.carrier
    designs = interface.design is not None and not sides.prescribed  # see ``supports``
    design = Design.of(frame.x, frame.cells, designs)
    drawn = np.concatenate([s.x.ravel() for s in site.whole])
    contact: MovingContact
    law, reads = interface.law, None
    with collective(dofs.comm):
        nodes = nodes_of(interface, sides, site, drawn, dofs)
        if _is_asked(law):
            contact = LawOnFrame.under(law, nodes, sides, design, drawn)
            reads = partial(kept_by, law, "begin_step", contact.nodes)
        elif isinstance(law, Tied):
            contact = TiedContact.of(sides, drawn, design, law.close_gap)
        elif law.slips:
            reads = partial(_read, law, nodes, sides)
            contact = FrictionContact(sides, design, *_bounds(reads))
        else:
            contact = NormalContact(sides, design)
    made = sides.made if isinstance(sides, DividedSides) else None
    return placed_at(contact, site.whole, site.spaces, dofs, reads, made)


def _read(law: Law, nodes: LawNodes, sides: Sides) -> dict[str, Array]:
    """What the law tells of nodes, at all of the pairs."""
    given = kept_by(law, "begin_step", nodes)
    if not isinstance(sides, DividedSides):
        return given
    return {name: np.maximum(sides.shares @ values, 0.0) for name, values in given.items()}


def _bounds(reads: Callable[[], dict[str, Array]]) -> list[Array]:
    """Coefficients of friction and cohesion [force / area] at nodes of unit area."""
    given = reads()
    return [given["mu"], given["cohesive"]]


def _on_itself(interface: SelfContact, dofs: BodyDofs) -> Placed:
    """A surface that meets itself; as of ``contact_of``."""
    [(tags, tag)] = interface.tagged_sides()
    space = space_of(tags, dofs.spaces)
    surface = extract_surface(dofs.spaces[space], tags, tag)
    with collective(dofs.comm):
        surface = surface.with_depth(interface.thickness, f"interface {interface.name}")
    [surface] = near([surface])
    sides = SelfSides.of_one(surface)
    site = Site(interface, sides.surfaces, (space, space), None, dofs.comm)
    return _on_frame(interface, sides, site, dofs)


def _against(interface: Interface, dofs: BodyDofs) -> Placed:
    """An interface with a rigid obstacle; as of ``contact_of``."""
    law, obstacle = interface.law, interface.obstacle
    assert obstacle is not None
    own = _is_asked(law)
    if obstacle.moment is not None and not isinstance(law, Tied):
        raise ContactInputError(
            f"law={checks.shown(law)}, moment={obstacle.moment!r}: a moment is of the rigid end "
            "of a body, law=Tied(); an obstacle that bodies part from turns as prescribed"
        )
    site = find_site(interface, dofs.spaces)
    surface = site.whole[0]
    check_tied_to_mean(interface.name, obstacle, law)
    if isinstance(obstacle, MeanDisplacement):
        return placed_at(MovingMean.over(surface, obstacle), site.whole, site.spaces, dofs)
    with collective(dofs.comm):
        checked_clearance(obstacle, surface.x)
    if isinstance(law, Tied):
        tie = partial(TiedObstacle.between, surface, obstacle, interface.name, law.close_gap)
        return placed_at(tie(), site.whole, site.spaces, dofs, tie)
    nodes = nodes_of(interface, OneSide((surface,)), site, surface.x.ravel(), dofs)
    pressed = any(loaded(obstacle, surface.x.shape[1]))
    if own:
        of_law = LawOnPressed if pressed else LawOnObstacle
        with collective(dofs.comm):
            told = of_law.under(law, nodes, surface, obstacle)
        again = partial(kept_by, law, "begin_step", told.nodes)
        return placed_at(told, site.whole, site.spaces, dofs, again)
    reads = partial(kept_by, law, "begin_step", nodes) if law.slips else None
    with collective(dofs.comm):
        friction = _bounds(reads) if reads else []
    contact = AGAINST[law.slips, pressed].of(surface, obstacle, *friction)
    return placed_at(contact, site.whole, site.spaces, dofs, reads)


def check_contacts(
    interfaces: Sequence[Interface], contacts: Sequence[Placed], dofs: BodyDofs, u: Array
) -> None:
    """Require that nothing is given twice, see ``check_once``, and a start that can be meant, see
    ``check_start``, at this rank's u (n_local,); collective."""
    facets = []
    for interface, placed in zip(interfaces, contacts, strict=True):
        sides = placed.what.sides
        surfaces = sides.as_they_are if isinstance(sides, DividedSides) else sides.surfaces
        ends = np.cumsum([surface.x.size for surface in surfaces])
        parts = [part.reshape(-1, s.x.shape[1])[:, 0][s.facets]
                 for part, s in zip(np.split(placed.numbers, ends), surfaces)]  # fmt: skip
        facets.append(parts[:1] if isinstance(interface, SelfContact) else parts)
    check_once(interfaces, facets)
    for interface, placed in zip(interfaces, contacts, strict=True):
        z = placed.at(dofs, u)
        chosen(dofs.comm, partial(check_start, interface, placed, z))


def pose_of(placed: Placed, moved: bool = True) -> Array:
    """What places an interface's rigid obstacle: as it is now, or as drawn; empty without one."""
    if not isinstance(placed.what, ObstacleContact):
        return np.zeros(0)
    pose, gdim = placed.what.pose(), placed.what.sides.gdim
    return pose if moved else np.where(np.arange(len(pose)) < gdim, pose, 0.0)


def anatomy(interface: Interface, placed: Placed) -> str:
    """For ``print``: which side of an interface carries the frame."""
    sides = placed.what.sides
    moving, where = sides.mover, "no frame"
    if sides.frame is not None:
        frame = sides.carrier
        where = f"frame on {frame.name}, {len(frame.x)} nodes"
    nodes = f"{len(moving.x)} nodes of {moving.name}"
    if isinstance(sides, DividedSides):
        own = len(sides.whole.x)
        nodes = f"{own} nodes of {moving.name}, and {len(moving.x) - own} points in between,"
    return f"  interface {interface.name}, {interface.law}: {where}; {nodes} on it"


def results_of(
    newton: NewtonSteps, interfaces: Sequence[Interface], state: NewtonState
) -> list[MovingInterfaceResult]:
    """Results of the interfaces at a state that has just been found, the same on every rank;
    collective.

    Raises:
        ContactError: what presses lies beside a tool that supports move as a whole.
    """
    placed, dofs = newton.equations.interfaces, newton.equations.bodies.dofs
    of = zip(placed, newton.terms, newton.slips, strict=True)
    results = [moving_results(p.what, p.at(dofs, state.u), terms, *slip) for p, terms, slip in of]
    results = copied(dofs.comm, results)  # their arrays are the user's
    for interface, p, result in zip(interfaces, placed, results, strict=True):
        sides = p.what.sides
        if result.frame is not None and sides.prescribed:
            names, forces = [s.name for s in sides.surfaces], [s.pressing for s in result.sides]
            check_beside(interface.name, names, forces, sides.frame)
    return results


def near(surfaces: Sequence[Surface]) -> tuple[Surface, ...]:
    """Surfaces as drawn; those that lie far from the origin about their middle: rounding of places
    is then that of their size."""
    x = np.concatenate([s.x for s in surfaces])
    low, high = x.min(axis=0), x.max(axis=0)
    if np.abs(x).max() <= FAR_OFF * (high - low).max():
        return tuple(surfaces)
    return tuple(s.about(0.5 * (low + high)) for s in surfaces)


def placed_at(
    what: Any,
    surfaces: Sequence[Surface],
    spaces: Sequence[int],
    dofs: BodyDofs,
    reads: Callable[[], Any] | None = None,
    made: csr_matrix | None = None,
) -> Placed:
    """Where the coordinates of some surfaces stand, what makes them, and what the law reads."""
    numbers = [dofs.of(i, s).ravel() for i, s in zip(spaces, surfaces, strict=True)]
    at = np.concatenate(numbers)
    drawn = np.concatenate([s.x.ravel() for s in surfaces])
    drawn = drawn if made is None else made @ drawn
    return Placed(what, at, drawn, np.ones(len(drawn), dtype=bool), reads, made).under(dofs)
