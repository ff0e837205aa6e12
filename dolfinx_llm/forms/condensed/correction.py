"""What corrects a multigrid where it is another step's."""

from typing import Any

import numpy as np
from petsc4py import PETSc

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.forms.direct import set_up_ksp
from dolfinx_llm.operators.petsc import join_blocks, times

LU = {
    "ksp_type": "preonly",
    "pc_type": "lu",
    "mat_mumps_icntl_24": 1,
    "pc_factor_mat_solver_type": "mumps",
}


class Correction:
    """A factorisation of a step's own matrix on some places and on the bodies' dofs next to them:
    what law and bodies say of these at once, neither the multigrid nor the places alone tell.

    Args:
        form: the step's places.
        at: (k,) this rank's, local numbers.
        test, corner: T_S of the matrix's rows, and its last block.
    """

    def __init__(self, form: Transformation, at: Array, test: Any, corner: Any) -> None:
        self._at, n = at, len(form.fixed)
        above, left = form.split.beside(form.T, test)
        comm, first = corner.comm, form.tail.first
        indptr, columns, _ = above.getValuesCSR()
        every = np.concatenate(form.comm.allgather(at + first))
        row = np.repeat(np.arange(n), np.diff(indptr))
        self._near = np.unique(row[np.isin(columns, every)])

        def places(numbers: Array) -> Any:
            return PETSc.IS().createGeneral(numbers.astype(PETSc.IntType), comm)

        near, chosen = places(self._near + form.split.first), places(at + first)
        body, tail = (places(np.arange(*M.getOwnershipRangeColumn())) for M in (left, corner))
        parts = [
            [form.split.inside_rows(self._near), above.createSubMatrix(near, tail)],
            [left.createSubMatrix(chosen, body), corner.createSubMatrix(chosen, tail)],
        ]
        self._rows, _ = join_blocks(parts)
        begin = self._rows.getOwnershipRangeColumn()[0]
        rows = places(np.arange(*self._rows.getOwnershipRange()))
        columns = places(np.concatenate([self._near, at + n]) + begin)
        matrix = self._rows.createSubMatrix(rows, columns)
        self._factor = set_up_ksp(matrix, "llm_changed_", LU)
        self._b, self._c = matrix.createVecs()
        for item in (
            near, chosen, body, tail, above, left, *parts[0], *parts[1], rows, columns, matrix
        ):  # fmt: skip
            item.destroy()

    def add(self, residual: tuple[Array, Array], found: tuple[Array, Array]) -> None:
        """Add to what was found for a residual, of this rank's bodies and of the other places, what
        solves there for the rest."""
        (body, tail), (inside, outside) = residual, found
        left = np.concatenate([body[self._near], tail[self._at]])
        self._c.array_w[:] = left - times(self._rows, np.concatenate(found))
        self._factor.solve(self._c, self._b)
        inside[self._near] += self._b.array_r[: len(self._near)]
        outside[self._at] += self._b.array_r[len(self._near) :]

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        for item in (self._factor, self._rows, self._b, self._c):
            item.destroy()
