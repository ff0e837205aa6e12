"""A preconditioner or a factorisation that is kept for other matrices as long as it serves."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_llm.forms.condensed.krylov import DIRECT, solver_of

log = logging.getLogger("dolfinx_llm")

WORN = 1.5  # times the iterations of a new preconditioner, from which on one is renewed
DIGITS = 13.0  # by which a solve makes the residual smaller, about
COST = 3.0  # iterations, about, for a row that the preconditioner knows otherwise


class KeptSolver:
    """CG with GAMG, or a factorisation, of one matrix and then of others that differ in few rows.

    Attributes:
        ksp: PETSc's solver; None before ``set_up``, and where it is given up.
        method: in words.
        set_ups: how often it was set up.
        took: iterations of the last solve.
    """

    def __init__(self, comm: MPI.Comm, prefix: str, options: dict, notes: list[str]) -> None:
        self._comm, self._prefix, self._options, self._notes = comm, prefix, options, notes
        self.ksp: Any = None
        self.method, self.set_ups, self.took = "", 0, 0
        self._kept = False  # whether the preconditioner is another matrix's
        self._serves = False  # whether it may be kept for the next
        self._outdated = 0  # rows that it knows otherwise
        self._usual = 0.0  # iterations per digit of a new one

    def set_up(self, matrix: Any) -> None:
        """Make it for a matrix; its near-null space is known to it."""
        self._matrix = matrix
        self._make(self._options)

    def _make(self, given: dict) -> None:
        self.ksp, self.method, self._own = solver_of(self._matrix, self._prefix, given)
        self.set_ups += 1

    def renew(self, matrix: Any, same: bool, changed: int) -> None:
        """Keep it for another matrix, of the same size as the last, or not, and with ``changed``
        rows that differ; or give it up."""
        self._outdated += changed
        spare = (WORN - 1.0) * self._usual * DIGITS  # iterations
        if same and self._serves and COST * self._outdated <= spare:
            self._matrix = matrix
            self.ksp.setOperators(matrix)
            self.ksp.getPC().setReusePreconditioner(True)
            self._kept = True
        else:
            self.discard()

    def discard(self) -> None:
        """Give it up."""
        if self.ksp is not None:
            self.ksp.destroy()
        self.ksp, self._kept, self._serves, self._outdated = None, False, False, 0

    @property
    def direct(self) -> bool:
        """Whether it factorises."""
        return self.ksp.getType() == "preonly"

    @property
    def rtol(self) -> float:
        """Relative tolerance."""
        return self.ksp.getTolerances()[0]

    @property
    def reason(self) -> int:
        """PETSc's reason of the end of the last solve."""
        return self.ksp.getConvergedReason()

    @property
    def failed(self) -> bool:
        """Whether the last solve ended without an answer."""
        return self.reason < 0

    def solve(self, b: Any, x: Any, rtol: float) -> tuple[bool, bool]:
        """One solve of A x = b to a residual of ``rtol``, or as far as a factorisation goes:
        whether x is of use, and whether a kept preconditioner was worn, and given up."""
        tolerances = _, _, _, patience = self.ksp.getTolerances()
        digits = -np.log10(rtol) if not self.direct else 0.0
        if not self.direct:
            limit = WORN * self._usual * digits if self._kept else patience
            self.ksp.setTolerances(rtol=rtol, max_it=min(patience, int(limit) + 1))
        self._once(b, x)
        reason = self.reason
        self.ksp.setTolerances(*tolerances)
        worn = self._kept and reason < 0
        if worn:
            self.discard()
        elif not self._kept and not self.direct and digits > 1.0:
            self._usual, self._serves = self.ksp.getIterationNumber() / digits, True
        return not worn or reason == PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT, worn

    def _once(self, b: Any, x: Any) -> None:
        """One solve; where the default options do not get there, a factorisation takes over."""
        self.ksp.solve(b, x)
        self.took = self.ksp.getIterationNumber()
        if self.reason < 0 and self._own and not self._kept:
            self.factorise(
                f"CG + GAMG ended without an answer after {self.took} iterations (PETSc's reason "
                f"{self.reason})"
            )
            self.ksp.destroy()
            self._make(self._options)
            self._own = False
            self.ksp.solve(b, x)

    def factorise(self, why: str) -> None:
        """From the next set-up on factorise instead, which is said once for all ranks."""
        self._options = DIRECT
        self._notes.append(f"{why}: Cholesky by MUMPS instead")
        log.log(logging.WARNING if self._comm.rank == 0 else logging.DEBUG, self._notes[-1])
