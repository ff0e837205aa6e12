"""What goes on from one mesh of bodies to another one."""

from __future__ import annotations

from typing import Any

from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.problem.bulk import fill
from dolfinx_llm.problem.form_arguments import listed
from dolfinx_llm.problem.transfer import carry_over, found_elsewhere
from dolfinx_llm.time.stepper import TimeStepper


def transfer(old: Any, new: Any) -> None:
    """Go on from the last state of a problem on another mesh of the same bodies; collective.

    Displacements and velocities are those of the old mesh at the new nodes. Of linear problems
    contact forces go over as forces per area, slip and what laws keep between the frame's nodes, or
    the nodes on an obstacle; stick and slip are those of the nearest. The next ``solve`` starts
    there, and finds the balance of the new mesh. At finite deformation slip counts from the
    displacement and from where obstacles stand, so that the next ``solve`` finds contact and its
    forces, also of what sticks, from these. The forces at the start of a ``TimeStepper`` are found
    anew, for loads and obstacles as they are then.

    Args:
        old: ``ContactProblem`` after ``solve``, ``NonlinearContactProblem`` or ``TimeStepper``.
        new: the same on another mesh, drawn at the same places, with as many meshes and the same
            interfaces, laws and obstacles; linear problems of first order. Loads, conditions and
            obstacles are yours to set as they were, also Functions of your own.

    Raises:
        ContactInputError: problems of other kinds, laws or bodies, linear ones of second order;
            nodes of the new mesh that lie outside of the old one.
        ContactError: nothing has been solved.
    """
    steppers = isinstance(old, TimeStepper), isinstance(new, TimeStepper)
    if not any(steppers):
        carry_over(old, new)
        return
    if not all(steppers):
        raise ContactInputError("transfer: give two of a kind, one of them is no TimeStepper")
    carry_over(old.problem, new.problem)
    spaces = old.problem.spaces, new.problem.spaces
    u, v = found_elsewhere(*spaces, [listed(old.u), listed(old.v)])
    counts = new.problem.bulk.dofs.counts
    fill(listed(new.u), u, counts)
    fill(listed(new.v), 0.0 * v, counts)
    new.t = old.t
    new.start()  # friction is known, and does not follow from velocities
    fill(listed(new.v), v, counts)
