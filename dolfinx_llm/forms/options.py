"""PETSc options that were given: which of them nothing has asked for, and which PETSc refuses."""

import ctypes
import re
from collections.abc import Collection, Iterable, Sequence
from functools import cache
from typing import Any

from petsc4py import PETSc

from dolfinx_llm.base import checks
from dolfinx_llm.base.errors import ContactError, ContactInputError

KRYLOV, PRECONDITIONERS = (
    sorted(name for name in vars(kind).values() if isinstance(name, str) and name.islower())
    for kind in (PETSc.KSP.Type, PETSc.PC.Type)
)
FACTORISED = ("lu", "cholesky", "ilu", "icc")
MULTIGRID = ("gamg", "mg", "hmg", "ml", "bddc")
# Often asked for; the names of those that a solver has read besides are not known to Python.
COMMON = (
    "ksp_type", "ksp_rtol", "ksp_atol", "ksp_max_it", "ksp_norm_type", "ksp_monitor", "ksp_view",
    "ksp_converged_reason", "ksp_gmres_restart", "pc_type", "pc_gamg_type", "pc_gamg_threshold",
    "pc_gamg_agg_nsmooths", "pc_factor_mat_solver_type", "mat_mumps_icntl_14", "mg_levels_ksp_type",
    "mat_mumps_icntl_24", "mg_levels_pc_type", "mg_levels_ksp_max_it", "mg_coarse_pc_type",
)  # fmt: skip


def check_values(options: dict[str, Any]) -> None:
    """Require values that do not depend on the solver in use: methods that are not misspelt, and
    bounds of iterations that stop some."""
    for key, names in (("ksp_type", KRYLOV), ("pc_type", PRECONDITIONERS)):
        value = options.get(key, "")
        if not isinstance(value, str):
            checks.refuse(f"petsc_options: {key}", value, "give the name of a method")
        if value not in names and (near := _nearest(value, names)):
            checks.refuse(f"petsc_options: {key}", value, f"did you mean {near!r}?")
    if "ksp_max_it" in options and not isinstance(options["ksp_max_it"], str):
        accepted = "give an integer of at least 1"
        checks.integer("petsc_options: ksp_max_it", options["ksp_max_it"], accepted, low=1)
    for key in ("ksp_rtol", "ksp_atol", "ksp_divtol"):
        if not isinstance(options.get(key, ""), str):
            checks.number(f"petsc_options: {key}", options[key], "give a number above 0", above=0.0)


class NoOption(ContactInputError):
    """An option that no solver in use asks for, or a method that does not suit it."""


@cache
def _library() -> Any:
    """PETSc's own functions: not every petsc4py has the one that is needed."""
    library = ctypes.CDLL(PETSc.__file__)
    library.PetscOptionsUsed.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    return library


def was_read(name: str) -> bool:
    """Whether PETSc has asked for an option of its database, a name with prefix, without hyphen."""
    found = ctypes.c_int(0)  # holds a bool of 4 bytes, and one of 1
    _library().PetscOptionsUsed(None, name.encode(), ctypes.byref(found))
    return bool(found.value)


def words_of(error: Exception) -> str:
    """What PETSc says of an error, without the places in its source."""
    lines = [re.sub(r"^\[\d+\] *", "", line).strip() for line in str(error).splitlines()]
    said = [line for line in lines if line and " at " not in line]
    return said[-1] if said else str(error)


def refused(error: Exception, given: dict[str, Any], doing: str) -> ContactError:
    """The error for what PETSc refuses to do: it names the options whose values PETSc speaks of, or
    all that the user gave."""
    words = words_of(error)
    if not given:
        return ContactError(f"PETSc cannot {doing}: {words}")
    named = {
        k: v for k, v in given.items() if isinstance(v, str) and v and v in str(error)
    } or given
    listed = ", ".join(f"{key}={value!r}" for key, value in named.items())
    return ContactInputError(
        f"petsc_options: PETSc cannot {doing} with {listed}: {words}. Check the values"
    )


def _nearest(wrong: str, names: Sequence[str]) -> str:
    """The name that was meant, or none: ""."""
    from difflib import get_close_matches  # for those who misspell

    return "".join(get_close_matches(wrong, names, n=1))


def check_read(ksp: PETSc.KSP, prefix: str, given: Iterable[str], known: Collection[str]) -> None:
    """Require that a solver that has been set up has asked for all options given to it, names
    without prefix; other names are proposed of those that are common or ``known``. Options of
    methods that are not in use here (of GAMG where a matrix is factorised) may stay."""
    wrong = [k for k in given if not was_read(prefix + k) and not _of_another_method(k, ksp)]
    if not wrong:
        return
    near = _nearest(wrong[0], [*COMMON, *known])
    hint = f"; did you mean {near!r}?" if near else ""
    pc = ksp.getPC().getType()
    raise NoOption(
        f"petsc_options: {', '.join(map(repr, wrong))} is no option that this solver (ksp_type "
        f"{ksp.getType()!r}, pc_type {pc!r}) asks for{hint}. See its options by "
        f"PETSC_OPTIONS=-help; leave out what other solvers are for"
    )


def _of_another_method(key: str, ksp: PETSc.KSP) -> bool:
    """Whether an option is for a Krylov method or preconditioner that is not in use."""
    pc = ksp.getPC().getType()
    if key.startswith("mat_mumps_"):
        return pc not in FACTORISED or ksp.getPC().getFactorSolverType() != "mumps"
    if key.startswith("mg_"):
        return pc not in MULTIGRID
    if key.startswith("pc_factor_"):
        return pc not in FACTORISED
    for part, names, used in (("ksp_", KRYLOV, ksp.getType()), ("pc_", PRECONDITIONERS, pc)):
        match = [name for name in names if key.startswith(f"{part}{name}_")]
        if match and used not in match:
            return True
    return False
