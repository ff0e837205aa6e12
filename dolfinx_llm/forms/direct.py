"""Matrices factorised by MUMPS, with refinement and spare memory."""

from collections.abc import Callable
from typing import Any

import numpy as np
from petsc4py import PETSc

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.forms.options import PRECONDITIONERS, check_read, refused
from dolfinx_llm.operators.petsc import is_symmetric

COLUMNS = 64  # right-hand sides solved at once

# Richardson on top of the factorisation is iterative refinement on any number of ranks: MUMPS's
# own works on one rank only. ICNTL(24): null pivots.
SADDLE_OPTIONS = {
    "ksp_type": "richardson",
    "ksp_max_it": 2,
    "ksp_norm_type": "none",
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_24": 1,
    "mat_mumps_icntl_12": 2,  # ordering of symmetric indefinite matrices by pairs of unknowns
}


# Where another Krylov method is asked for: the same, but that it stops by itself.
KRYLOV_OPTIONS = {"ksp_max_it": 30, "ksp_rtol": 1e-12}


class DirectSolver:
    """A matrix factorised by MUMPS; solves are refined, or stop ``once`` it has served. With
    ``own`` the matrix goes with the solver.

    Raises:
        ContactInputError: options with names that are not known, or values that PETSc refuses.
        ContactError: MUMPS could not factorise.
    """

    def __init__(
        self,
        matrix: Any,
        prefix: str,
        options: dict[str, Any] | None = None,
        own: bool = False,
        once: bool = False,
    ) -> None:
        self.matrix, self._own = matrix, own
        self._usual = SADDLE_OPTIONS | ({"ksp_max_it": 1} if once else {})
        self.symmetric = is_symmetric(matrix)
        self.solution, self.rhs = matrix.createVecs()
        self._given = prefix, options or {}
        self.ksp = self._factorise(*self._given)

    def _factorise(self, prefix: str, options: dict[str, Any]) -> Any:
        """Set up and factorise."""
        if self.symmetric:
            self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        options = self._options = self._fitting(options)
        usual: dict[str, Any] = dict(self._usual)
        if options.get("ksp_type", "richardson") not in ("richardson", "preonly"):
            del usual["ksp_norm_type"]
            usual |= KRYLOV_OPTIONS
        usual["pc_type"] = "cholesky" if self.symmetric else "lu"
        return factorised(
            self.matrix, prefix, usual | options, options, 80, "the system",
            "-9: raise petsc_options mat_mumps_icntl_14; -10: the matrix is singular, a body or "
            "the frame is not held; -13: out of memory",
        )  # fmt: skip

    def _fitting(self, options: dict[str, Any]) -> dict[str, Any]:
        """The options given, of which a factorisation is required; Cholesky's needs symmetry."""
        pc = options.get("pc_type", "lu")
        if pc in PRECONDITIONERS and pc not in ("lu", "cholesky"):
            raise ContactInputError(
                f"petsc_options: pc_type={pc!r}: this form of the system is factorised, give 'lu' "
                "or 'cholesky' or leave it out; solver='condensed' iterates"
            )
        return options | {"pc_type": "lu"} if pc == "cholesky" and not self.symmetric else options

    def refactorise(self) -> None:
        """Factorise anew where entries of the matrix have changed, but not which there are."""
        self.ksp.setOperators(self.matrix)
        factor = self.ksp.getPC().getFactorMatrix()
        try:
            self.ksp.setUp()
        except PETSc.Error as error:
            raise refused(error, self._options, "set up the solver") from None
        if self.ksp.getPC().getFactorSolverType() == "mumps" and factor.getMumpsInfog(1) < 0:
            self.ksp.destroy()
            self.ksp = self._factorise(*self._given)

    def solve(self, b: Array) -> Array:
        """This rank's part of the solution for its part of a load."""
        self.rhs.array_w[:] = b
        try:
            self.ksp.solve(self.rhs, self.solution)
        except PETSc.Error as error:
            raise refused(error, self._options, "solve") from None
        return self.solution.array_r.copy()

    def once(self, b: Array) -> Array:
        """``solve`` without refinement, where that is what the options ask for."""
        if self.ksp.getType() not in ("richardson", "preonly"):
            return self.solve(b)
        self.rhs.array_w[:] = b
        self.ksp.getPC().apply(self.rhs, self.solution)
        return self.solution.array_r.copy()

    def left(self, b: Array, x: Array) -> Array:
        """This rank's part of what x leaves of a load b."""
        self.solution.array_w[:] = x
        self.matrix.mult(self.solution, self.rhs)
        return b - self.rhs.array_r

    def solve_many(self, b: Array) -> Array:
        """The same for several loads, the columns of b (n_local, k), without refinement."""
        comm, k = self.matrix.comm, b.shape[1]
        sizes = (self.matrix.getSizes()[0], (PETSc.DECIDE, k))
        loads = PETSc.Mat().createDense(sizes, array=np.asfortranarray(b), comm=comm)
        loads.assemble()
        found = loads.duplicate()
        found.assemble()
        self.ksp.getPC().getFactorMatrix().matSolve(loads, found)
        x = found.getDenseArray().copy()
        loads.destroy()
        found.destroy()
        return x

    def destroy(self) -> None:
        for item in (self.ksp, self.solution, self.rhs, *([self.matrix] * self._own)):
            item.destroy()


def set_up_ksp(
    matrix: Any,
    prefix: str,
    chosen: dict[str, Any],
    given: dict[str, Any] | None = None,
    prepare: Callable[[Any], None] | None = None,
) -> Any:
    """A KSP with the chosen options, which do not stay in PETSc's global database; those that the
    user gave must all be known. ``prepare`` tells its preconditioner what no option says.

    Raises:
        ContactInputError: options with names that are not known, or values that PETSc refuses.
        ContactError: PETSc cannot set up the solver.
    """
    given = given or {}
    ksp = PETSc.KSP().create(matrix.comm)
    ksp.setOperators(matrix)
    ksp.setOptionsPrefix(prefix)
    database = PETSc.Options()
    added = [prefix + key for key in chosen if not database.hasName(prefix + key)]
    for key in added:
        database[key] = chosen[key[len(prefix) :]]
    try:
        if prepare is not None:
            prepare(ksp.getPC())
        ksp.setFromOptions()
        ksp.setUp()
        ours = [key for key in given if prefix + key in added]
        check_read(ksp, prefix, ours, chosen.keys() - given.keys())
    except PETSc.Error as error:
        ksp.destroy()
        raise refused(error, given, "set up the solver") from None
    finally:
        for key in added:
            database.delValue(key)
    return ksp


def factorised(
    matrix: Any,
    prefix: str,
    options: dict[str, Any],
    given: dict[str, Any],
    spare: int,
    what: str,
    advice: str,
) -> Any:
    """A KSP that factorises; MUMPS gets more spare memory where delayed pivots outgrow it. What the
    matrix is and what its INFOG(1) advises are for the message where it cannot."""
    error = 0
    for percent in (spare, 400, 2000):
        ksp = set_up_ksp(matrix, prefix, {"mat_mumps_icntl_14": percent} | options, given)
        if ksp.getPC().getFactorSolverType() != "mumps":
            return ksp
        error, detail = map(ksp.getPC().getFactorMatrix().getMumpsInfog, (1, 2))
        if error not in (-8, -9):
            break
        ksp.destroy()
    if error < 0:
        raise ContactError(
            f"MUMPS could not factorise {what}: INFOG(1) = {error}, INFOG(2) = {detail}. {advice}"
        )
    return ksp
