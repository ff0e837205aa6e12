"""Frame unknowns that hardly any row sees, solved for exactly before and after multigrid."""

from __future__ import annotations

from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import csc_matrix, csr_matrix
from scipy.sparse.linalg import splu

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.forms.condensed.transformation import Transformation

SEEN_FAINTLY = 0.1  # entries of rows below which they hold a frame unknown too softly for multigrid


def hardly_held(form: Transformation) -> Array | None:
    """(k,) places of this rank's frame unknowns among its own, where small entries of rows alone
    see one that a proximal term holds; elsewhere None, on all ranks. Collective."""
    if form.proximal is None:
        return None
    moved = form.L @ form.frame.Z
    seen = np.zeros(moved.shape[1])
    np.maximum.at(seen, moved.indices, abs(moved.data))
    form.comm.Allreduce(MPI.IN_PLACE, seen, op=MPI.MAX)
    some = ((seen > 0.0) & (seen < SEEN_FAINTLY)).any()
    return len(form.fixed) + form.tail.seats if some else None


class FrameBlock:
    """The preconditioner F + (1 - F A) G (1 - A F), with multigrid's G and F, the inverse of A's
    block of the frames' unknowns. What small entries of rows alone hold, in the rim of contact that
    has been lifted off, costs hardly any energy, and G hundreds of iterations.

    Args:
        ksp: whose own preconditioner is G.
        places: (k,) of this rank's frame unknowns among its own.
    """

    def __init__(self, ksp: Any, matrix: Any, places: Array) -> None:
        self._inner = ksp.getPC()
        self._factorise(matrix, places)
        outer = PETSc.PC().create(comm=ksp.comm)
        outer.setOperators(matrix)
        outer.setType("python")
        outer.setPythonContext(self)
        ksp.setPC(outer)
        outer.destroy()
        ksp.setUp()

    def leave(self, ksp: Any) -> None:
        """Give a solver its own preconditioner back; collective."""
        outer = ksp.getPC()
        ksp.setPC(self._inner)
        for item in (outer, self._inner):
            item.destroy()

    def _factorise(self, matrix: Any, places: Array) -> None:
        self._matrix, self._places, comm = matrix, places, matrix.comm.tompi4py()
        numbers = (matrix.getOwnershipRange()[0] + places).astype(PETSc.IntType)
        rows = PETSc.IS().createGeneral(numbers, comm=matrix.comm)
        block = matrix.createSubMatrix(rows, rows)
        first, column, value = block.getValuesCSR()
        parts = comm.allgather((np.diff(first), column, value))
        counts, columns, values = (np.concatenate(part) for part in zip(*parts, strict=True))
        start = np.concatenate([[0], np.cumsum(counts)])
        whole = csr_matrix((values, columns, start), shape=(len(counts),) * 2)
        self._solve = splu(csc_matrix(whole)).solve if len(counts) else lambda b: b
        before = sum(len(part[0]) for part in parts[: comm.rank])
        self._mine, self._comm = slice(before, before + len(places)), comm
        for item in (rows, block):
            item.destroy()

    def apply(self, _: Any, x: Any, y: Any) -> None:
        """y = M x."""
        left, found = x.duplicate(), x.duplicate()
        y.set(0.0)
        self._add(x.array_r, y)
        self._matrix.mult(y, left)
        left.aypx(-1.0, x)
        self._inner.apply(left, found)
        y.axpy(1.0, found)
        self._matrix.mult(y, left)
        left.aypx(-1.0, x)
        self._add(left.array_r, y)
        for item in (left, found):
            item.destroy()

    def _add(self, x: Array, y: Any) -> None:
        """F x, to y."""
        whole = np.concatenate(self._comm.allgather(x[self._places]))
        y.array_w[self._places] += self._solve(whole)[self._mine]
