"""What an interface is built of: its surfaces and what is prescribed there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from mpi4py import MPI

from dolfinx_llm.base import compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.log import warn_of
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.design.rises import ROUND
from dolfinx_llm.geometry.cells import unit_normals
from dolfinx_llm.geometry.neighbours import neighbours
from dolfinx_llm.geometry.spaces import is_scalar
from dolfinx_llm.geometry.surface import Surface, check_sides, extract_surface
from dolfinx_llm.interface.choices import Interface
from dolfinx_llm.laws.frictionless import FreeSlip

STRAIGHT_FACETS = 1e-9  # of a surface's diameter: nodes of straight edges lie off the middle
BENT = 1e-6  # difference of unit normals of a surface that is curved


@dataclass(frozen=True, eq=False)
class Site:
    """What an interface is built of; the same on every rank."""

    interface: Interface  # the user's choices
    whole: tuple[Surface, ...]  # the surfaces as tagged: two, one against a rigid obstacle
    spaces: tuple[int, ...]  # index of the function space of each
    held: tuple[Array, ...] | None  # per side (n, components) prescribed dofs of its nodes
    comm: MPI.Comm
    shared: tuple[Array, ...] = ()  # per side (n,) nodes that other interfaces have, too
    scalar: bool = False  # a temperature or the like goes across, no displacement
    carrier: int | None = None  # side that the frame moves with; None: with both alike
    prescribed: int | None = None  # side that supports move as a whole, on which the frame lies


def find_site(
    interface: Interface, spaces: Sequence[Any], fixed: Sequence[Array] | None = None
) -> Site:
    """The surfaces of an interface and what is prescribed there, gathered on every rank; arguments
    as of ``build_interface``."""
    check_field(interface, scalar := is_scalar(spaces[0]))
    tagged = interface.tagged_sides()
    owners = tuple(space_of(tags, spaces) for tags, _ in tagged)
    whole = tuple(
        extract_surface(spaces[i], tags, tag) for i, (tags, tag) in zip(owners, tagged, strict=True)
    )
    name, thickness = f"interface {interface.name}", interface.thickness
    with collective(spaces[0].mesh.comm):  # a function of the user's
        whole = tuple(side.with_depth(thickness, name) for side in whole)
    if interface.shift is not None:
        whole = whole[0], brought(whole[1], interface.shift)
    if len(whole) == 2:
        check_sides(whole[0], whole[1], same_mesh=owners[0] == owners[1])
    held = None
    if fixed is not None:
        held = tuple(_held(side, spaces[i], fixed[i]) for side, i in zip(whole, owners))
    return Site(interface, whole, owners, held, spaces[0].mesh.comm, scalar=scalar)


def brought(side: Surface, shift: Array) -> Surface:
    """A side where it meets the other one, by a shift (gdim,) from where it is drawn.

    Raises:
        ContactInputError: the shift is of another dimension.
    """
    if len(shift) != side.x.shape[1]:
        raise ContactInputError(
            f"shift={shift.tolist()}: the bodies lie in {side.x.shape[1]}D, give as many numbers"
        )
    return replace(side, x=side.x + shift, drawn=side.x)


def check_field(interface: Interface, scalar: bool) -> None:
    """Require a law for what the bodies' function spaces are of: a scalar field, or displacements.

    Raises:
        ContactInputError: another law, or an obstacle, which has no field.
    """
    law, name = interface.law, interface.name
    if not scalar and law.scalar:
        raise ContactInputError(
            f"interface {name}: the law {law} is for scalar function spaces, as of a temperature; "
            "displacements take Tied(), Frictionless(), Coulomb(mu) or a law of your own"
        )
    if not scalar:
        return
    if not (law.scalar or law.ties) or law.closes_gap or law.given_gap:
        raise ContactInputError(
            f"interface {name}: the law {law} is for displacements; a scalar function space takes "
            "Tied(), without a gap, where the field is continuous, or Conductance(h)"
        )
    if interface.obstacle is not None:
        raise ContactInputError(
            f"interface {name}: a rigid obstacle has no temperature. For exchange with something "
            "of a given u_0 add h * (u - u_0) * v * ds(tag) to the forms"
        )


def check_order(interface: Interface, sides: Sequence[Surface]) -> None:
    """Require, of second-order bodies, ties, laws that let them part, or those of a scalar field.

    Raises:
        ContactInputError: what is not there for them is asked for.
    """
    missing, law = "", interface.law
    if all(side.element.order == 1 for side in sides):
        return
    if not law.scalar and (law.gives or not (law.ties or law.opens)):
        missing = f"the law {law}"
    elif interface.design == "positions":
        missing = "design='positions' (use 'weights' or 'auto')"
    if missing:
        raise ContactInputError(
            f"interface {interface.name}: {missing} need(s) first-order bodies; second-order ones "
            "can be tied, and part and slide. Use ('Lagrange', 1, ...) here, or "
            "NonlinearContactProblem, of F = ufl.action(a, u) - L, which takes laws of your own"
        )


def with_law(site: Site, curved: bool) -> Site:
    """The same, with the form of its law for curved surfaces of bodies of second order.

    Raises:
        ContactInputError: the frame of bodies that may part is not of the least order there.
    """
    interface, law = site.interface, site.interface.law
    orders = [side.element.order for side in site.whole]
    if not (curved and law.opens and 2 in orders):
        return site
    least, frame = min(orders), interface.frame
    if frame is not None and frame.element.order != least:
        raise ContactInputError(
            f"interface {interface.name}: the frame is of order {frame.element.order}, the bodies "
            f"of {orders}, along contact that turns around a body (by more than 0.05 rad to either "
            f"side). Give a frame of order {least}, or none"
        )
    if law.components != "normal":
        return site
    free = FreeSlip(follows=site.prescribed is None)
    return replace(site, interface=replace(interface, law=free))


def say_straight(interface: Interface, sides: Sequence[Surface], notes: list[str]) -> None:
    """Warn of second-order bodies whose curved surfaces have straight facets."""
    for side in sides:
        off = np.abs(side.straightened(side.x) - side.x).max()
        if side.elements is None or off > STRAIGHT_FACETS * side.diameter:
            continue
        normal, (i, j) = unit_normals(side.x, side.facets), neighbours(side.facets)
        angle = np.linalg.norm(normal[i] - normal[j], axis=1)
        if ((angle > BENT) & (angle < ROUND[1])).any():  # edges of a body are no curve
            text = (
                f"the facets of {side.name} are straight and the surface is curved: pressures of "
                "second-order bodies feel its edges. Give the mesh second order as well "
                "(gmsh.model.mesh.setOrder(2))"
            )
            warn_of(interface.name, text, notes)


def places(whole: Surface, part: Surface) -> Array:
    """(n,) numbers of the nodes of a surface that a part of it has."""
    if part is whole:
        return np.arange(len(whole.x))
    return np.flatnonzero(np.isin(whole.dofs, part.dofs))


def space_of(tags: Any, spaces: Sequence[Any]) -> int:
    """Index of the function space whose mesh the tags mark; the first, if there is none."""
    own = [i for i, V in enumerate(spaces) if compat.tags_belong_to(tags, V.mesh)]
    return own[0] if own else 0


def _held(side: Surface, V: Any, fixed: Array) -> Array:
    """(n, components) whether a Dirichlet condition prescribes a node's dof, on all ranks."""
    mine = side.owner == V.mesh.comm.rank
    start = V.dofmap.index_map.local_range[0]
    held = np.zeros((len(side.x), V.dofmap.index_map_bs), dtype=np.int64)
    nodes = V.dofmap.index_map.size_local
    held[mine] = fixed[: nodes * held.shape[1]].reshape(nodes, held.shape[1])[
        side.dofs[mine] - start
    ]
    return V.mesh.comm.allreduce(held) > 0
