"""Near-null spaces and solvers of the condensed matrix: PETSc's side of it.

A preconditioner or a factorisation is kept for other matrices as long as it serves.
"""

import logging
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.log import log
from dolfinx_llm.base.parallel import chosen
from dolfinx_llm.forms.condensed.frame_block import FrameBlock
from dolfinx_llm.forms.condensed.reduced import ReducedMatrix
from dolfinx_llm.forms.direct import factorised, set_up_ksp
from dolfinx_llm.forms.options import FACTORISED

# The unpreconditioned norm is that of the system scaled to unit diagonal.
RTOL = 1e-13
ITERATIVE = {"ksp_type": "cg", "ksp_norm_type": "unpreconditioned", "ksp_rtol": RTOL}
GAMG = {
    "pc_type": "gamg",
    "pc_gamg_agg_nsmooths": 1,
    "pc_gamg_threshold": 0.01,
    "pc_gamg_coarse_eq_limit": 200,  # by 50 modes may be dependent there, smoothers find no scale
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_pc_type": "jacobi",
    "mg_levels_ksp_max_it": 3,
}
DIRECT = {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"}
PATIENCE = 400  # iterations of the default options, then a factorisation takes over
WIDEST = 4096  # nodes that PETSc's GAMG allows a row to couple with; more end in an error
WORN = 1.5  # times the iterations of a new preconditioner, from which on one is renewed
DIGITS = 13.0  # by which a solve makes the residual smaller, about
COST = 3.0  # iterations, about, for a row that the preconditioner knows otherwise


def solver_of(matrix: Any, prefix: str, given: dict[str, Any]) -> Any:
    """KSP of a symmetric positive definite matrix, set up; its name, and whether it is the default
    one, which may be given up.

    Options of PETSc's database come first, then the given ones, then those of ``ITERATIVE`` and
    ``GAMG``; a factorisation is MUMPS's, with more spare memory where it needs it.
    """
    pc, krylov = (option(prefix, given, *of) for of in (("pc_type", "gamg"), ("ksp_type", "cg")))
    factor = pc in ("cholesky", "lu")
    default = krylov == "cg" and pc == "gamg"
    default = default and option(prefix, given, "ksp_max_it", None) is None
    options = dict(ITERATIVE) if krylov == "cg" else {"ksp_rtol": ITERATIVE["ksp_rtol"]}
    options |= GAMG if pc == "gamg" else {}
    options |= {"ksp_max_it": PATIENCE} if default else {}
    options |= {"pc_factor_mat_solver_type": "mumps"} if factor else {}
    options |= given
    if factor:
        ksp = factorised(
            matrix, prefix, options, given, 50, "the condensed matrix",
            "-10: it is singular, a body or the frame is not held; -13: out of memory, leave "
            "petsc_options to their defaults for CG + GAMG",
        )  # fmt: skip
    else:
        ksp = set_up_ksp(matrix, prefix, options, given)
    names = {"gamg": "GAMG", "cholesky": "Cholesky", "cg": "CG"}
    parts = [names.get(krylov, krylov)] * (krylov != "preonly") + [names.get(pc, pc)]
    return ksp, " + ".join(parts), default


def option(prefix: str, given: dict[str, Any], key: str, default: Any) -> Any:
    """An option of PETSc's database, else a given one, else the default."""
    database = PETSc.Options(prefix)
    return database.getString(key) if database.hasName(key) else given.get(key, default)


def near_null_space(matrix: Any, S: Any, modes: Array) -> None:
    """Give a matrix scaled by S on both sides the near-null space S⁻¹ modes (n_local, k)."""
    values = modes / S.array_r[:, None]
    # PETSc wants them orthonormal; ranks that round otherwise would find other bases.
    comm = matrix.comm.tompi4py()
    products = comm.allreduce(values.T @ values)
    size, vectors = chosen(comm, lambda: np.linalg.eigh(products))
    kept = size > 1e-12 * size[-1]
    if not kept.any():  # supports and obstacles hold every dof
        return
    values = values @ (vectors[:, kept] / np.sqrt(size[kept]))
    found = []
    for column in values.T:
        vector = S.duplicate()
        vector.array_w[:] = column
        found.append(vector)
    space = PETSc.NullSpace().create(vectors=found, comm=matrix.comm)
    matrix.setNearNullSpace(space)
    for item in (space, *found):
        item.destroy()


class KeptSolver:
    """CG with GAMG, or a factorisation, of one matrix and then of others that differ in few rows.

    Attributes:
        ksp: PETSc's solver; None before ``set_up``, and where it is given up.
        method: in words.
        set_ups: how often it was set up.
        took: iterations of the last solve.
    """

    def __init__(
        self, comm: MPI.Comm, prefix: str, options: dict[str, Any], notes: list[str]
    ) -> None:
        self._comm, self._prefix, self._options, self._notes = comm, prefix, options, notes
        self.ksp: Any = None
        self.method, self.set_ups, self.took = "", 0, 0
        self._kept = False  # whether the preconditioner is another matrix's
        self._serves = False  # whether it may be kept for the next
        self._outdated = 0  # rows that it knows otherwise
        self._usual = 0.0  # iterations per digit of a new one
        self._block: FrameBlock | None = None  # around multigrid

    def set_up(self, reduced: ReducedMatrix) -> None:
        """Make it for a matrix, which knows its near-null space."""
        self._reduced = reduced
        self._make(self._options)
        self._surround()

    def _make(self, given: dict[str, Any]) -> None:
        self.ksp, self.method, self._own = solver_of(self._reduced.matrix, self._prefix, given)
        self.set_ups += 1

    def _surround(self) -> None:
        """Solve for the frames' unknowns beside multigrid, by default options."""
        if self._reduced.hardly_held is not None and self._own and not self.direct:
            self._block = FrameBlock(self.ksp, self._reduced)

    def keeps(self, same: bool, changed: int) -> bool:
        """Whether it may be kept for another matrix, of the ``same`` size as the last, or not, and
        with ``changed`` rows that differ; else it is given up."""
        self._outdated += changed
        spare = (WORN - 1.0) * self._usual * DIGITS  # iterations
        kept = same and self._serves and COST * self._outdated <= spare
        if not kept:
            self.discard()
        return kept

    def keep(self, reduced: ReducedMatrix) -> None:
        """Keep it for another matrix."""
        self._bare()
        self._reduced = reduced
        self.ksp.setOperators(reduced.matrix, self.ksp.getOperators()[1])
        self.ksp.getPC().setReusePreconditioner(True)
        self._kept = True
        self._surround()

    def _bare(self) -> None:
        """Go back to multigrid alone."""
        if self._block is not None:
            self._block.leave(self.ksp)
        self._block = None

    def discard(self) -> None:
        """Give it up."""
        self._bare()
        if self.ksp is not None:
            self.ksp.destroy()
        self.ksp, self._kept, self._serves, self._outdated = None, False, False, 0

    @property
    def uses_modes(self) -> bool:
        """Whether a near-null space makes it better."""
        return option(self._prefix, self._options, "pc_type", "gamg") not in FACTORISED

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
            self._bare()
            self.ksp.destroy()
            self._make(self._options)
            self._own = False
            self.ksp.solve(b, x)

    def factorise(self, why: str) -> None:
        """From the next set-up on factorise instead, which is said once for all ranks."""
        self._options = DIRECT
        self._notes.append(f"{why}: Cholesky by MUMPS instead")
        log.log(logging.WARNING if self._comm.rank == 0 else logging.DEBUG, self._notes[-1])
