"""Displacements without any stiffness, of bodies that forms leave out, or with a negative one."""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.operators.numbering import BodyDofs
from dolfinx_llm.operators.petsc import diagonal_of, local_csr

GIVES_WAY = 0.1  # of the free displacements, that cannot all be about to give way


def check_stiffness(K: PETSc.Mat, dofs: BodyDofs, form: str, at_rest: bool = True) -> None:
    """Require that no row of a free displacement is zero, and no diagonal entry negative;
    collective.

    Args:
        K: of all bodies.
        dofs: their numbers.
        form: what K comes of, for the message.
        at_rest: bodies are as drawn on this rank; some of deformed ones may be about to give way.

    Raises:
        ContactInputError: rows are zero, or entries negative; how many, and where.
    """
    free, diagonal = ~dofs.fixed[dofs.of_nodes], diagonal_of(K)[dofs.of_nodes]
    bare = free & (diagonal == 0.0)
    if bare.any():  # in a mixed space rows without a diagonal may couple with another block
        rows = local_csr(K)[dofs.of_nodes[bare]]
        bare[bare] = np.asarray(abs(rows).sum(axis=1)).ravel() == 0.0
    kind = "displacements" if dofs.components > 1 else "unknowns"
    if where := _where(bare, free, dofs):
        raise ContactInputError(
            f"{where[0]} free {kind} have no stiffness, at nodes from {where[1]}: "
            f"the form {form} gives these none. Does a dx(...) leave a body out, or is a "
            "coefficient 0 there? Add its form, or prescribe what is to have none"
        )
    negative = free & (diagonal < 0.0)
    many, every = dofs.comm.allreduce(np.array([negative.sum(), free.sum()]))
    if where := _where(negative & (at_rest | bool(many > GIVES_WAY * every)), free, dofs):
        raise ContactInputError(
            f"{where[0]} free {kind} have a negative stiffness, at nodes from {where[1]}: the form "
            f"{form} gives it. Check the signs of coefficients (E > 0, -1 < nu < 0.5), and of the "
            "form, which is that of internal forces less loads"
        )


def _where(found: Array, free: Array, dofs: BodyDofs) -> tuple[str, str] | None:
    """How many of the free displacements are found, of all ranks, and from where to where; None:
    no one; collective."""
    if not dofs.comm.allreduce(bool(found.any()), op=MPI.LOR):
        return None
    x = dofs.points[np.unique(np.flatnonzero(found) // dofs.components)]
    ends = [] if not len(x) else [x.min(axis=0), x.max(axis=0)]
    told = dofs.comm.allgather((int(found.sum()), int(free.sum()), ends))
    count, every = (sum(part[i] for part in told) for i in (0, 1))
    box = np.array([end for part in told for end in part[2]])
    low, high = (checks.place(of(box, axis=0)) for of in (np.min, np.max))
    return f"{count} of {every}", f"{low} to {high}"
