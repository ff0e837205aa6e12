"""(31) with the rows of contact laws, factorised by MUMPS; the classical system (6) as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import gather_rows
from dolfinx_llm.forms.direct import COLUMNS, DirectSolver
from dolfinx_llm.forms.exchange import MANY_ASKED, Answer, Load, WholeSteps, forecast_of
from dolfinx_llm.forms.step import LinearStep, StepResult
from dolfinx_llm.operators.numbering import Numbering
from dolfinx_llm.operators.petsc import create_aij, join_blocks, local_csr, with_springs

STALLED = 1  # steps towards a load that leave no fewer wrong signs than any before


class SaddleForm(WholeSteps):
    """The frame-augmented system (31) with the rows of a step, factorised as long as these stay.

    Args:
        *arguments: of ``WholeSteps``.
    """

    name = "saddle"
    many = MANY_ASKED
    _fewest: float = np.inf  # signs that were wrong in any step towards this load
    _swings = 0  # steps with no fewer

    def solve(self, f: Array, step: LinearStep) -> StepResult:
        """See ``WholeSteps``; where change goes round without friction, when those that press are
        the least of a convex function, a forecast says which do next."""
        if f is not self._f:
            self._fewest, self._swings = np.inf, 0
        found = super().solve(f, step)
        wrong = int(found.wrong.sum())
        self._swings += wrong >= self._fewest
        self._fewest = min(wrong, self._fewest)
        if not wrong or self._swings <= STALLED or abs(step.E - step.L.T).nnz:
            return found
        forecast = forecast_of(step, self._stiffness, found)
        pressing = forecast.pressing(found.multiplier, found.y + step.g)
        told = step.may_open & (pressing != found.active)
        return replace(found, wrong=told) if told.any() else found

    def set_up(self, step: LinearStep) -> FactorisedStep:
        """See ``WholeSteps``."""
        operators = self.operators
        numbers = operators.rows.numbering, operators.unknowns
        with self.times.timed("factorisation"):
            return FactorisedStep(
                self.K, operators.B, step, numbers, operators.scale, self.prefix, self.options
            )

    def describe(self) -> str:
        """See ``StepForm``."""
        return "saddle, (31) factorised by MUMPS"


class FactorisedStep:
    """The matrix of one step in u, λ / c and w, symmetric without friction, factorised.

    λ is scaled by a stiffness c, so that units vanish.

    Args:
        K: stiffness of the bodies, identity rows and columns at prescribed dofs.
        B: (31); for (6) Qᵀ.
        step: rows of interfaces and frames.
        numbers: of the multipliers, and of the frame and slip unknowns.
        scale: c [force / length].
        prefix: of the PETSc options.
        options: PETSc options on top of ``SADDLE_OPTIONS``.
    """

    columns = COLUMNS

    def __init__(
        self,
        K: PETSc.Mat,
        B: PETSc.Mat,
        step: LinearStep,
        numbers: tuple[Numbering, Numbering],
        scale: float,
        prefix: str,
        options: dict[str, Any] | None = None,
    ) -> None:
        self._comm: MPI.Comm = K.comm.tompi4py()
        self._numbers, self._scale, self._active = numbers, scale, step.active
        held = K
        if len(step.anchor):
            held = with_springs(K, step.pins, np.full(K.getLocalSize()[0], step.spring))
        B, B_t, own = _blocks(B, step, numbers, scale)
        self._matrix, (body, rest) = join_blocks([[held, B], [B_t, own]])
        rows = np.split(rest, [len(numbers[0].mine)])
        self._places = body, *rows
        for M in (B, B_t, own, *([] if held is K else [held])):
            M.destroy()
        self._solver = DirectSolver(self._matrix, prefix, options, own=True)

    def ask(
        self, f: Array, g: Array, rhs: Array, about: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """This rank's u, and all of λ and w, for other loads; see ``LinearStep``.

        Raises:
            ContactError: PETSc cannot solve.
        """
        return self._parts(self._solver.solve(self._load(f, g, rhs)))

    def ask_many(self, loads: Sequence[Load]) -> list[Answer]:
        """The same for each of several loads, without refinement."""
        columns = np.column_stack([self._load(*load) for load in loads])
        parts = self._parts(self._solver.solve_many(columns))
        return list(zip(*(part.T for part in parts), strict=True))

    def _load(self, f: Array, g: Array, rhs: Array) -> Array:
        """This rank's right-hand side."""
        (rows, frames), places = self._numbers, self._places
        b = np.zeros(self._matrix.getLocalSize()[0])
        b[places[0]] = f
        b[places[1]] = np.where(self._active, -self._scale * g, 0.0)[rows.mine]
        b[places[2]] = -rhs[frames.mine]
        return b

    def _parts(self, x: Array) -> tuple[Array, Array, Array]:
        """u of this rank, λ and w of all, of this rank's solutions, columns."""
        (rows, frames), (body, forces, own) = self._numbers, self._places
        multiplier = gather_rows(self._comm, self._scale * x[forces])[rows.number]
        return x[body], multiplier, gather_rows(self._comm, x[own])[frames.number]

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self._solver.destroy()


def _blocks(
    B: PETSc.Mat, step: LinearStep, numbers: Sequence[Numbering], c: float
) -> tuple[PETSc.Mat, PETSc.Mat, PETSc.Mat]:
    """B, Bᵀ and the rest of the system, in which λ / c and w of each rank stand together.

    PETSc hands MUMPS the upper triangle from each row's stored diagonal on: on several ranks rows
    without one lose entries. All of the diagonal is stored.
    """
    comm, (rows, frames) = B.comm.tompi4py(), numbers
    n, m = rows.sizes[1], frames.sizes[1]
    both = Numbering(np.concatenate([rows.owner, frames.owner]), rows.rank)
    on = c * step.active
    factor, place = np.empty(n), np.empty(n, dtype=np.int64)
    factor[rows.number], place[rows.number] = on, both.number[:n]
    own = local_csr(B)
    shape = own.shape[0], n + m
    own = csr_matrix((own.data * factor[own.indices], place[own.indices], own.indptr), shape)
    B = create_aij(comm, B.getSizes()[0], both.sizes, own)
    B_t = B.copy()
    B_t.transpose()

    L, E, D, every = step.L.tocoo(), step.E.tocoo(), step.D.tocoo(), np.arange(n + m)
    idle = np.where(step.active, -(c**2) * step.compliance, c)
    value = -on[L.row] * L.data, -E.data * on[E.col], -D.data, idle, np.zeros(m)
    row = np.concatenate([L.row, n + E.row, n + D.row, every])
    col = np.concatenate([n + L.col, E.col, n + D.col, every])
    mine = both.owner[row] == both.rank
    first = both.number[both.mine].min(initial=n + m)
    index = both.number[row[mine]] - first, both.number[col[mine]]
    local = csr_matrix((np.concatenate(value)[mine], index), both.sizes)
    return B, B_t, create_aij(comm, both.sizes, both.sizes, local)
