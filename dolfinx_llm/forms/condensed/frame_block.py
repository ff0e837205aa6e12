"""Frame unknowns that hardly any row sees, solved for exactly before and after multigrid."""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy.sparse import coo_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import collective, gather_rows
from dolfinx_llm.base.sparse import symmetric_factors
from dolfinx_llm.forms.condensed.gmres import Shell
from dolfinx_llm.forms.condensed.reduced import ReducedMatrix
from dolfinx_llm.operators.petsc import local_csr, times


class FrameBlock:
    """The preconditioner F + (1 - F A) G (1 - A F), with multigrid's G and F, the inverse of A's
    block of the frames' unknowns. What small entries of rows alone hold, in the rim of contact that
    has been lifted off, costs hardly any energy, and G hundreds of iterations.

    Args:
        ksp: whose own preconditioner is G.
        reduced: A.
    """

    def __init__(self, ksp: Any, reduced: ReducedMatrix) -> None:
        self._inner, self._matrix, self._places = ksp.getPC(), reduced.matrix, reduced.hardly_held
        self._factorise(reduced.block(self._places))
        outer = PETSc.PC().create(comm=ksp.comm)
        outer.setOperators(self._matrix)
        outer.setType("python")
        outer.setPythonContext(Shell(self._times))
        ksp.setPC(outer)
        outer.destroy()
        ksp.setUp()

    def leave(self, ksp: Any) -> None:
        """Give a solver its own preconditioner back; collective."""
        outer = ksp.getPC()
        ksp.setPC(self._inner)
        for item in (outer, self._inner):
            item.destroy()

    def _factorise(self, block: Any) -> None:
        """A's block, the same on every rank; it is used up."""
        self._comm, self._mine = block.comm.tompi4py(), slice(*block.getOwnershipRange())
        own, size = local_csr(block).tocoo(), block.getSize()
        parts = own.data, own.row + self._mine.start, own.col
        data, row, col = (gather_rows(self._comm, part) for part in parts)
        with collective(self._comm):
            self._factors = symmetric_factors(coo_matrix((data, (row, col)), size))
        block.destroy()

    def _times(self, x: Array) -> Array:
        """This rank's part of the product with x."""
        y = self._by_factors(x)
        y += self._by_multigrid(x - times(self._matrix, y))
        return y + self._by_factors(x - times(self._matrix, y))

    def _by_factors(self, x: Array) -> Array:
        """F x."""
        y = np.zeros(len(x))
        y[self._places] = self._factors.solve(gather_rows(self._comm, x[self._places]))[self._mine]
        return y

    def _by_multigrid(self, x: Array) -> Array:
        """G x."""
        given, found = self._matrix.createVecs()
        given.array_w[:] = x
        self._inner.apply(given, found)
        y = found.array_r.copy()
        for item in (given, found):
            item.destroy()
        return y
