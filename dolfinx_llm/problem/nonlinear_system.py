"""Equations at finite deformation, posed on bodies as they are drawn, and how they are solved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.log import log
from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.finite.linear.system import NewtonSystem
from dolfinx_llm.finite.load_step import Bodies, Equations, NewtonState, Placed
from dolfinx_llm.finite.pressure import FreeSurfacePressure
from dolfinx_llm.interface.choices import Interface
from dolfinx_llm.operators.numbering import BodyDofs, Numbering
from dolfinx_llm.problem.nonlinear_loads import followers_of
from dolfinx_llm.problem.nonlinear_parts import check_contacts, contact_of, led_otherwise

Options = tuple[str, dict[str, Any] | None]  # prefix, and PETSc options

# Unknowns from which on GMRES + GAMG solves Newton's systems faster than a factorisation.
FROM_UNKNOWNS = {2: 500_000, 3: 20_000}


def posed(
    bodies: Bodies,
    u: Array,
    interfaces: Sequence[Interface],
    loads: Sequence[FreeSurfacePressure],
    solver: str,
    options: Options,
    times: StageTimes,
) -> tuple[Equations, str, str]:
    """What load steps are solved of, for positions as they are now; how Newton's systems are
    solved, and why; collective.

    Args:
        bodies: without their contact.
        u: (n_local,) where this rank's dofs stand at first.
        interfaces, loads, solver, options: as the user asks.
        times: to which seconds are added.

    Raises:
        ContactInputError, ContactError: interfaces that cannot be made.
    """
    dofs = bodies.dofs
    with times.timed("interfaces"):
        contacts = _shared([contact_of(interface, dofs) for interface in interfaces])
        check_contacts(interfaces, contacts, dofs, u)
        followers = followers_of(loads, dofs, contacts)
    system, method, why = _numbered(contacts, dofs, solver, options)
    surfaces = [s for c in contacts for s in c.what.sides.surfaces]
    size = max([s.facet_size for s in surfaces] or [1.0])
    return Equations(bodies, contacts, followers, system, size, times), method, why


def _shared(contacts: Sequence[Placed]) -> list[Placed]:
    """The same, which know the nodes that carry frames of others."""
    frames = [c.what.sides.split(c.known)[1][:, 0] for c in contacts]
    others = [[np.zeros(0), *frames[:i], *frames[i + 1 :]] for i in range(len(contacts))]
    of = zip(contacts, others, strict=True)
    return [replace(c, shared=np.isin(c.moving, np.concatenate(other))) for c, other in of]


def hold(
    equations: Equations,
    state: NewtonState,
    interfaces: Sequence[Interface],
    loads: Sequence[FreeSurfacePressure],
    solver: str,
    options: Options,
) -> NewtonState:
    """Solve for what conditions leave free now; other arguments as of ``posed``; collective.

    Interfaces of which another surface is to carry the frame now are made anew. What they bore the
    next step finds again, from positions as they are in the state, which pairs that stick keep.

    Returns:
        The state, of interfaces as they are now.
    """
    log.info("other dofs are prescribed than at the last solve")
    equations.system.destroy()
    dofs, before = equations.bodies.dofs, equations.interfaces
    contacts = [
        contact_of(interface, dofs)
        if led_otherwise(interface, placed, dofs)
        else placed.under(dofs)
        for interface, placed in zip(interfaces, before, strict=True)
    ]
    kept = [now.what is then.what for now, then in zip(contacts, before, strict=True)]
    if all(kept):
        followers = [placed.under(dofs) for placed in equations.followers]
    else:
        contacts = _shared(contacts)
        followers = followers_of(loads, dofs, contacts)
        own = zip(kept, state.own, contacts, strict=True)
        state = replace(
            state,
            own=tuple(q if stays else np.zeros(c.what.size) for stays, q, c in own),
            status=tuple(s if stays else None for stays, s in zip(kept, state.status)),
            kept=tuple(k if stays else None for stays, k in zip(kept, state.kept)),
        )
    equations.system, *_ = _numbered(contacts, dofs, solver, options)
    equations.interfaces, equations.followers = contacts, followers
    return state


def counted(equations: Equations) -> dict[str, int]:
    """Global number of unknowns of the bodies and of the interfaces."""
    system = equations.system
    return {"u": system.dofs.sizes[1], "interfaces": sum(system.sizes)}


def _numbered(
    contacts: Sequence[Placed],
    dofs: BodyDofs,
    solver: str,
    options: Options,
) -> tuple[NewtonSystem, str, str]:
    """The unknowns of bodies and interfaces; how Newton's systems are solved, and why.

    Args:
        contacts: the interfaces.
        dofs: of the bodies.
        solver, options: as the user asks.
    """
    owners = [np.empty(0, dtype=np.int64), *(c.what.owner for c in contacts)]
    own = Numbering(np.concatenate(owners), dofs.comm.rank)
    limit, why = FROM_UNKNOWNS[dofs.gdim], "as asked"
    if dofs.mixed:
        if solver == "condensed":
            raise ContactInputError(
                "solver='condensed' needs a positive definite tangent, which that of a mixed "
                "function space is not in general: use solver='saddle'"
            )
        solver, why = "saddle", "chosen: the function space is mixed"
    elif solver == "auto":
        large = dofs.sizes[1] + own.sizes[1] >= limit
        solver = "condensed" if large else "saddle"
        why = "chosen: " + (
            f"from {limit} unknowns on GMRES + GAMG is quicker"
            if large
            else f"fewer than {limit} unknowns, where factorising is quickest"
        )
    system = NewtonSystem(
        dofs,
        [c.numbers for c in contacts],
        own,
        [c.what.size for c in contacts],
        options=(options[0], options[1] or {}),
        sides=[c.what.sides for c in contacts],
        made=[c.made for c in contacts],
        iterates=solver == "condensed",
    )
    return system, solver, why
