"""Multigrid of bodies that slide past each other, from that of bodies that stick.

Its aggregates reach across the surface where bodies meet. Each is parted, into what it moves of
the one side and of the other; what both share goes with one of them. Sums of the two are the old
aggregates, so that nothing is lost, and no motions are added to the others: the new hierarchy
costs its matrices alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix, identity, kron

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.forms.direct import set_up_ksp
from dolfinx_llm.operators.petsc import create_aij, local_csr, times

# Parts of few places may depend on each other.
OPTIONS = {
    "pc_type": "mg",
    "mg_coarse_pc_type": "redundant",
    "mg_coarse_redundant_pc_type": "svd",
}
EMPTY = 1e-10  # of an aggregate's motions


def parted(
    new: tuple[Any, Any],
    old: tuple[list[Any], Any],
    sides: list[Any],
    prefix: str,
    options: dict[str, Any],
) -> Any:
    """KSP of a matrix with the aggregates of another's GAMG, parted.

    Args:
        new: the matrix, and the scaling of its places.
        old: interpolations of the other, from the coarsest, used up, and the same.
        sides: of ``side_motions``; used up.
        prefix, options: of PETSc.
    """
    (matrix, scaling), (coarse, other) = new, old
    inverse = scaling.copy()
    inverse.reciprocal()
    for M in sides:
        M.diagonalScale(inverse, other)
    inverse.destroy()
    levels, kept = [matrix], np.zeros(0, dtype=np.int64)
    between: list[Any] = []
    for P in reversed(coarse):
        local = kron(local_csr(P), identity(2), "csr")[kept] if between else _turns(P, sides)
        Q, kept = _without_empty(P, local)
        P.destroy()
        between.append(Q)
        levels.append(_galerkin(levels[-1], Q))

    def prepare(pc: Any) -> None:
        pc.setType("mg")
        pc.setMGLevels(len(levels))
        for level, Q in enumerate(reversed(between), 1):
            pc.setMGInterpolation(level, Q)
        for level, A in enumerate(reversed(levels)):
            pc.getMGSmoother(level).setOperators(A)

    try:
        return set_up_ksp(matrix, prefix, options | OPTIONS, prepare=prepare)
    finally:
        for item in (*between, *levels[1:]):
            item.destroy()


def side_motions(form: Transformation, frame: csr_matrix, sides: tuple[Array, Array]) -> list[Any]:
    """Per side the motions of all places that are on it, by those of another step's places.

    Args:
        form: the places, of the other step as well.
        frame: (m, m) unknowns of the frames by the other's.
        sides: 1 or -1 at this rank's dofs (n_local,) and the frames' unknowns (m,).
    """
    tail, comm, n = form.tail, form.comm, len(form.fixed)
    first = np.array(comm.allgather((tail.first, form.split.first)))
    local, every = form.split.sizes
    rank = np.searchsorted(first[:, 0], tail.columns, side="right") - 1
    ends = np.append(first[1:, 1], every)
    columns = tail.columns + ends[rank]  # of all places: of each rank bodies, then tail
    there, start = tail.left >= 0, form.split.first + tail.first
    own = np.concatenate([np.arange(n), n + tail.left[there]])
    of_own = np.concatenate([sides[0], sides[0][form.split.surface[there]]])
    of_frame, found = frame[tail.mine_used].tocoo(), []
    for side in (1.0, -1.0):
        at, on = own[of_own == side], sides[1][tail.mine_used[of_frame.row]] == side
        row = np.concatenate([at, n + tail.seats[of_frame.row[on]]])
        col = np.concatenate([at + start, columns[of_frame.col[on]]])
        value = np.concatenate([np.ones(len(at)), of_frame.data[on]])
        sizes = local + tail.sizes[0], every + tail.sizes[1]
        M = csr_matrix((value, (row, col)), shape=sizes)
        found.append(create_aij(comm, sizes, sizes, M))
    return found


def _galerkin(A: Any, P: Any) -> Any:
    """Pᵀ A P; on one rank in half the time of PETSc's own product of the three, which on several
    is the quicker one."""
    if A.comm.size > 1:
        return A.ptap(P)
    product, turned = A.matMult(P), P.transpose(PETSc.Mat())
    found = turned.matMult(product)
    product.destroy()
    turned.destroy()
    return found


def _turns(P: Any, sides: list[Any]) -> csr_matrix:
    """This rank's rows of what either side makes of P, columns in turn."""
    parts = []
    for side, M in enumerate(sides):
        product = M.matMult(P)
        own = local_csr(product)
        shape = own.shape[0], 2 * own.shape[1]
        parts.append(csr_matrix((own.data, 2 * own.indices + side, own.indptr), shape))
        product.destroy()
        M.destroy()
    return parts[0] + parts[1]


def _without_empty(P: Any, local: csr_matrix) -> tuple[Any, Array]:
    """The matrix of which these are this rank's rows, with the columns of P twice, but for those
    that are empty; which of this rank's columns stay."""
    comm = P.comm.tompi4py()
    rows, columns = local.shape[0], 2 * P.getSizes()[1][0]
    sizes = columns, local.shape[1]
    every = create_aij(P.comm, (rows, PETSc.DETERMINE), sizes, local)
    some = np.random.default_rng(2001 + comm.rank).uniform(1.0, 2.0, rows)
    kept = np.flatnonzero(np.abs(times(every, some, transposed=True)) > EMPTY)
    first = comm.exscan(len(kept)) or 0
    there = csr_matrix(
        (np.ones(len(kept)), (kept, first + np.arange(len(kept)))),
        shape=(columns, comm.allreduce(len(kept))),
    )
    chosen = create_aij(P.comm, sizes, (len(kept), there.shape[1]), there)
    found = every.matMult(chosen)
    every.destroy()
    chosen.destroy()
    return found, kept
