"""Near-null spaces and solvers of the condensed matrix: PETSc's side of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.forms.direct import mumps_infog, set_up_ksp

# The unpreconditioned norm is that of the system scaled to unit diagonal.
RTOL = 1e-13
ITERATIVE = {"ksp_type": "cg", "ksp_norm_type": "unpreconditioned", "ksp_rtol": RTOL}
GAMG = {
    "pc_type": "gamg",
    "pc_gamg_agg_nsmooths": 1,
    "pc_gamg_threshold": 0.01,
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_pc_type": "jacobi",
    "mg_levels_ksp_max_it": 3,
}
DIRECT = {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"}
PATIENCE = 400  # iterations of the default options, then a factorisation takes over
WIDEST = 4096  # nodes that PETSc's GAMG allows a row to couple with; more end in an error


def solver_of(matrix: Any, prefix: str, given: dict) -> Any:
    """KSP of a symmetric positive definite matrix, set up; its name, and whether it is the default
    one, which may be given up.

    Options of PETSc's database come first, then the given ones, then those of ``ITERATIVE`` and
    ``GAMG``; a factorisation is MUMPS's, with more spare memory where it needs it.
    """
    database = PETSc.Options(prefix)

    def chosen(key: Any, default: Any) -> Any:
        return database.getString(key) if database.hasName(key) else given.get(key, default)

    pc, krylov = chosen("pc_type", "gamg"), chosen("ksp_type", "cg")
    factor = pc in ("cholesky", "lu")
    default = krylov == "cg" and pc == "gamg" and chosen("ksp_max_it", None) is None
    options = dict(ITERATIVE) if krylov == "cg" else {"ksp_rtol": ITERATIVE["ksp_rtol"]}
    options |= GAMG if pc == "gamg" else {}
    options |= {"ksp_max_it": PATIENCE} if default else {}
    options |= {"pc_factor_mat_solver_type": "mumps"} if factor else {}
    options |= given
    for spare in (50, 400, 2000):
        more = {"mat_mumps_icntl_14": spare} if factor else {}
        ksp = set_up_ksp(matrix, prefix, more | options, given)
        infog = mumps_infog(ksp) if factor else {}
        if infog.get(1, 0) not in (-8, -9):
            break
        ksp.destroy()
    if infog.get(1, 0) < 0:
        raise ContactError(
            f"MUMPS could not factorise the condensed matrix: INFOG(1) = {infog[1]}, INFOG(2) = "
            f"{infog[2]}. -10: it is singular, a body or the frame is not held; -13: out of "
            "memory, leave petsc_options to their defaults for CG + GAMG"
        )
    names = {"gamg": "GAMG", "cholesky": "Cholesky", "cg": "CG"}
    parts = [names.get(krylov, krylov)] * (krylov != "preonly") + [names.get(pc, pc)]
    return ksp, " + ".join(parts), default


def near_null_space(matrix: Any, S: Any, modes: np.ndarray) -> None:
    """Give a matrix scaled by S on both sides the near-null space S⁻¹ modes (n_local, k)."""
    values = modes / S.array_r[:, None]
    # PETSc wants them orthonormal.
    size, vectors = np.linalg.eigh(matrix.comm.tompi4py().allreduce(values.T @ values))
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
