"""Whether bodies can have come to where an increment ends: by the way that they went in it, with
slips along that way, and without cells inside out."""

from __future__ import annotations

from typing import Any

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.finite.failures import StepFailed, failing
from dolfinx_llm.finite.load_step import Equations, NewtonState
from dolfinx_llm.finite.obstacles.obstacle_contact import ObstacleContact
from dolfinx_llm.finite.pairs.slides import Slides
from dolfinx_llm.finite.pairs.terms import ContactTerms, Held, MovingContact, Place
from dolfinx_llm.finite.passage import check_held, check_obstacle, check_passage, left_over_edge

OFF_WAY = 0.3  # of a facet: what slip may lie off the way of nodes that meet


def check_way(
    equations: Equations, run: Any, before: list[Place], start: NewtonState
) -> list[Array]:
    """Require an equilibrium that the bodies can have come to; per interface (n,) which nodes have
    left what they pressed on over its edge. Collective.

    Args:
        equations: what is solved.
        run: an ``Increment`` at its end.
        before: how pairs stood at its start.
        start: the state there.

    Raises:
        StepFailed: cells are inside out, or bodies have passed each other.
        ContactError: supports hold both sides in each other; smaller increments do as well.
    """
    count, first = equations.bodies.inside_out(run.u)
    if count:
        raise StepFailed(f"elements turn inside out: {count}, the first drawn at {first}")
    of, left = zip(start.own, start.poses, run.own, run.poses, strict=True), []
    each = zip(equations.interfaces, before, run.terms, run.held, of, strict=True)
    for placed, place, t, held, (q, pose, own, posed) in each:
        z = placed.at(run.dofs, start.u) if isinstance(placed.what, ObstacleContact) else None
        with failing(), collective(run.dofs.comm):
            if z is None:
                check_passage(placed.what, place, t.place)
            else:
                check_obstacle(placed.what, ((z, q, pose), (t.place.z, own, posed)), t.place)
        check_slips(placed.what, held, t)
        if run.end == 1.0:  # on the way there obstacles go along arcs, supports along chords
            with collective(run.dofs.comm):
                check_held(placed.what, t)
        left.append(left_over_edge(place, q, t.place))
    return left


def check_slips(contact: MovingContact, held: Held, now: ContactTerms) -> None:
    """Require that nodes which meet in an increment and slip do so along their way in it.

    Args:
        contact: an interface.
        held: what was chosen for the increment.
        now: at its end.

    Raises:
        StepFailed: they count from where an iterate has met, far from that; the same on every rank.
    """
    if not isinstance(contact, Slides):
        return
    off, size = contact.off_way(now.place, held, now.status), contact.sides.mover.facet_size
    if off.max(initial=0.0) > OFF_WAY * size:
        worst = int(off.argmax())
        x = contact.sides.split(now.place.z)[0][worst] + contact.sides.mover.origin
        raise StepFailed(
            f"nodes of {contact.sides.mover.name} meet in an increment and slip, at "
            f"{checks.place(x)} {off[worst]:.3g} off the way that they go in it"
        )
