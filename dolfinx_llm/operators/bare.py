"""Displacements without any stiffness: of bodies that the forms leave out."""

import numpy as np
from petsc4py import PETSc

from dolfinx_llm.base import checks
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.operators.numbering import BodyDofs
from dolfinx_llm.operators.petsc import diagonal_of, local_csr


def check_stiffness(K: PETSc.Mat, dofs: BodyDofs, form: str) -> None:
    """Require that no row of a free displacement is zero; collective.

    Args:
        K: of all bodies.
        dofs: their numbers.
        form: what K comes of, for the message.

    Raises:
        ContactInputError: rows are zero; how many, and where.
    """
    free = ~dofs.fixed[dofs.of_nodes]
    bare = free & (diagonal_of(K)[dofs.of_nodes] == 0.0)
    if bare.any():  # in a mixed space rows without a diagonal may couple with another block
        rows = local_csr(K)[dofs.of_nodes[bare]]
        bare[bare] = np.asarray(abs(rows).sum(axis=1)).ravel() == 0.0
    x = dofs.points[np.unique(np.flatnonzero(bare) // dofs.components)]
    ends = [] if not len(x) else [x.min(axis=0), x.max(axis=0)]
    found = dofs.comm.allgather((int(bare.sum()), int(free.sum()), ends))
    count, every = (sum(part[i] for part in found) for i in (0, 1))
    if not count:
        return
    box = np.array([end for part in found for end in part[2]])
    low, high = (checks.place(of(box, axis=0)) for of in (np.min, np.max))
    kind = "displacements" if dofs.components > 1 else "unknowns"
    raise ContactInputError(
        f"{count} of {every} free {kind} have no stiffness, at nodes from {low} to {high}: "
        f"the form {form} gives these none. Does a dx(...) leave a body out, or is a coefficient 0 "
        "there? Add its form, or prescribe what is to have none"
    )
