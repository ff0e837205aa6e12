"""Newton's system: bodies, follower loads, and interfaces with unknowns of their own."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.log import log
from dolfinx_llm.base.parallel import gather_rows
from dolfinx_llm.finite.condensed import CondensedSystem, tolerance
from dolfinx_llm.finite.coupling import Coupling
from dolfinx_llm.finite.soft_modes import soft_modes
from dolfinx_llm.finite.terms import ContactTerms
from dolfinx_llm.forms.direct import DirectSolver
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.numbering import BodyDofs, Numbering
from dolfinx_llm.operators.petsc import (
    create_aij,
    diagonal_of,
    is_symmetric,
    join_blocks,
    same_entries,
    times,
)


@dataclass(frozen=True, eq=False)
class Part:
    """A sparse matrix between some unknowns, known to every rank."""

    matrix: csr_matrix
    rows: np.ndarray  # number of each row
    cols: np.ndarray  # number of each column


ONCE = {"ksp_max_it": 1}  # Newton's next iteration is the refinement
IN_VAIN = 3  # failures of GMRES in a row, after which it is not tried any more
GROWN = 10  # entries that are stored over those that are there, from which they are forgotten


@dataclass(eq=False)
class Parts:
    """Where unknowns stand, and matrices between them of what every rank knows of interfaces."""

    dofs: BodyDofs
    numbers: Sequence[np.ndarray]  # per interface (width,) dofs of its coordinates
    own: Numbering  # of all interfaces' own unknowns, one after the other
    sizes: Sequence[int]  # per interface
    stored: dict[str, csr_matrix] = field(default_factory=dict)  # entries of contact

    def add(
        self, K: PETSc.Mat, name: str, parts: Sequence[Part], without: np.ndarray | None = None
    ) -> None:
        """Add parts to K, but for rows (n_local,); arguments as of ``rows``."""
        sizes = self.dofs.sizes
        local = self.rows(name, parts, self.dofs.first, *sizes, without)
        added = create_aij(self.dofs.comm, sizes, sizes, local)
        K.axpy(1.0, added, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        added.destroy()

    def blocks(self, terms: Sequence[ContactTerms], sizes: tuple[int, int]) -> list[PETSc.Mat]:
        """Blocks top, left and own."""
        ends = np.cumsum([0, *self.sizes])
        places = [self.own.number[a:b] for a, b in zip(ends[:-1], ends[1:], strict=True)]
        both = list(zip(terms, self.numbers, places, strict=True))
        comm, (n, total), first = self.dofs.comm, sizes, self.dofs.first
        mine, count = self.own.sizes
        start = sum(self.own.owner < self.own.rank)
        fixed = self.dofs.fixed
        tops = [Part(t.top, u, q) for t, u, q in both]
        top = self.rows("top", tops, first, n, count, fixed)
        lefts = [Part(t.left, q, u) for t, u, q in both]
        left = self.rows("left", lefts, start, mine, total)
        own = [Part(t.own, q, q) for t, _, q in both]
        zero = csr_matrix((np.zeros(count), (np.arange(count), np.arange(count))), (count, count))
        own.append(Part(zero, np.arange(count), np.arange(count)))  # a stored diagonal
        return [
            create_aij(comm, sizes, self.own.sizes, top),
            create_aij(comm, self.own.sizes, sizes, left),
            create_aij(
                comm, self.own.sizes, self.own.sizes, self.rows("own", own, start, mine, count)
            ),
        ]

    def rows(
        self,
        name: str,
        parts: Sequence[Part],
        first: int,
        n: int,
        width: int,
        without: np.ndarray | None = None,
    ) -> csr_matrix:
        """(n, width) this rank's rows of the sum of some parts, but for those (n,) left out, with
        the entries that a block of this name has had before."""
        rows, cols, values = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0)]
        for part in parts:
            found = part.matrix.tocoo()
            row = part.rows[found.row] - first
            keep = (row >= 0) & (row < n)
            if without is not None:
                keep[keep] = ~without[row[keep]]
            rows.append(row[keep])
            cols.append(part.cols[found.col[keep]])
            values.append(found.data[keep])
        count = sum(map(len, rows))
        if name in self.stored and self.stored[name].nnz < GROWN * count:
            before = self.stored[name].tocoo()
            rows.append(before.row)
            cols.append(before.col)
            values.append(0.0 * before.data)
        index = np.concatenate(rows), np.concatenate(cols)
        found = csr_matrix((np.concatenate(values), index), (n, width))
        self.stored[name] = found
        return found


@dataclass(eq=False)
class NewtonSystem(Parts):
    """Newton's system for changes of u and of the interfaces' own unknowns q.

        [K + sum of K_i   top] [du]   [-r   ]
        [left             own] [dq] = [-rest]

    Contact that may part makes it unsymmetric: averaged normals and designed rows have forces that
    are no gradient. Blocks of ties are symmetric. Entries that contact has once had stay stored, as
    zeros: while nodes slide within their facets the factorisation's analysis serves again.

    It is factorised, or solved by GMRES (see ``condensed``); where that fails, factorised as well.
    """

    options: tuple[str, dict] = ("", {})  # prefix, and PETSc options
    sides: Sequence[Any] = ()  # surfaces of each interface
    iterates: bool = False  # whether GMRES is to solve it
    iterations: int = 0  # of GMRES, since they were asked for
    failures: int = 0  # of GMRES in a row
    solver: DirectSolver | None = None  # of the last iteration

    @cached_property
    def _bodies(self) -> Bodies:
        return Bodies(self.dofs.spaces)

    def solve(
        self,
        K: PETSc.Mat,
        terms: Sequence[ContactTerms],
        followers: Sequence[Part],
        r: np.ndarray,
        u: np.ndarray,
        error: float,
        exact: bool,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Changes of this rank's u and of all q; collective. K is used up.

        Args:
            K: of the bodies, without conditions.
            terms: of the interfaces.
            followers: minus the derivatives of follower loads.
            r: (n_local,) residual; at prescribed dofs minus their change.
            u: (n_local,) where they are made.
            error: Newton's residual there, relative.
            exact: whether GMRES is to go as far as it can.

        Raises:
            ContactInputError: options that PETSc does not know, or refuses.
            ContactError: MUMPS could not factorise.
        """
        if self.iterates:
            return self._iterate(K, terms, followers, r, u, error, exact)
        bodies = [Part(t.K, at, at) for t, at in zip(terms, self.numbers, strict=True)]
        self.add(K, "bodies", [*bodies, *followers], self.dofs.fixed)
        fixed = np.flatnonzero(self.dofs.fixed)
        diagonal = mean_diagonal(K)  # for the rows of prescribed dofs
        K.zeroRows((self.dofs.first + fixed).astype(PETSc.IntType), diag=diagonal)
        b = -r
        b[fixed] *= diagonal
        return self._factorised(K, terms, b, [t.rest for t in terms])

    def _iterate(
        self,
        K: PETSc.Mat,
        terms: Sequence[ContactTerms],
        followers: Sequence[Part],
        r: np.ndarray,
        u: np.ndarray,
        error: float,
        exact: bool,
    ) -> tuple[np.ndarray, np.ndarray]:
        """The same by GMRES, else by MUMPS; K becomes the preconditioner's."""
        dofs, d = self.dofs, mean_diagonal(K)
        places = [*self.numbers, *(f.rows for f in followers)]
        loads = [f.matrix for f in followers]
        coupling = Coupling(dofs, terms, self.sides, places, loads, d)
        pairs = [Part(C, n, n) for C, n in zip(coupling.stiffness, self.numbers, strict=True)]
        self.add(K, "pairs", pairs)
        moved = np.where(dofs.fixed, -r, 0.0)
        pushed, left = coupling.prescribed(moved)
        forces = np.where(dofs.fixed, 0.0, -r - times(K, moved) - pushed)
        rest = np.concatenate([np.zeros(0), *(t.rest for t in terms)])
        s = -coupling.scaling @ rest - left
        fixed = dofs.first + np.flatnonzero(dofs.fixed)
        K.zeroRowsColumns(fixed.astype(PETSc.IntType), diag=d)
        K.setBlockSize(dofs.gdim)
        system = CondensedSystem(dofs, self.own, K, coupling)
        modes = soft_modes(dofs, u, self._bodies, terms, self.sides, self.numbers)
        found = system.solve(forces, s, modes, tolerance(error, exact), self.options)
        self.iterations += system.iterations
        self.failures = self.failures + 1 if found is None else 0
        if found is None:
            self.iterates = self.failures < IN_VAIN
            log.log(
                logging.WARNING if dofs.comm.rank == 0 else logging.DEBUG,
                f"GMRES + GAMG gave no answer ({system.ended}): Newton's system is factorised by "
                "MUMPS instead" + ("" if self.iterates else ", from now on"),
            )
            every = np.concatenate(places)
            self.add(K, "others", [Part(coupling.K, every, every)])
            rests = np.split(-s / coupling.scaling.diagonal(), np.cumsum(self.sizes)[:-1])
            found = self._factorised(K, terms, forces, rests)
        else:
            K.destroy()
        return found[0] + moved, found[1]

    def _factorised(
        self, K: PETSc.Mat, terms: Sequence[ContactTerms], b: np.ndarray, rest: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """The solution by MUMPS for forces b (n_local,) and what the own equations leave."""
        if not terms:
            return self._solved([[K]], [b])[0], np.zeros(0)
        c = mean_diagonal(K, np.concatenate(self.numbers))  # or MUMPS takes pivots for none
        top, left, own = self.blocks(terms, self.dofs.sizes)
        top.scale(c)
        left.scale(c)
        own.scale(c * c)
        rests = c * np.concatenate(rest)[self.own.mine]
        du, dq = self._solved([[K, top], [left, own]], [b, -rests])
        return du, gather_rows(self.dofs.comm, c * dq)[self.own.number]

    def _solved(
        self, blocks: Sequence[Sequence[PETSc.Mat]], b: Sequence[np.ndarray]
    ) -> list[np.ndarray]:
        matrix, places = join_blocks(blocks)
        for M in (M for row in blocks for M in row):
            M.destroy()
        rhs = np.zeros(matrix.getLocalSize()[0])
        for place, part in zip(places, b, strict=True):
            rhs[place] = part
        self._factorise(matrix)
        assert self.solver is not None
        x = self.solver.solve(rhs)
        return [x[place] for place in places]

    def _factorise(self, matrix: PETSc.Mat) -> None:
        """Factorise; the analysis of the last factorisation serves where it can."""
        old, self.solver = self.solver, None
        if old is not None:
            alike = is_symmetric(matrix) == old.symmetric and same_entries(matrix, old.matrix)
            if alike:
                matrix.copy(old.matrix, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
                matrix.destroy()
                try:
                    old.refactorise()
                except ContactError:
                    old.destroy()
                    raise
                self.solver = old
                return
            old.destroy()
        chosen = {} if self.failures else self.options[1]  # they were GMRES's
        self.solver = DirectSolver(matrix, self.options[0], ONCE | chosen, own=True)

    def taken(self) -> int:
        """Iterations of GMRES since this was asked last."""
        taken, self.iterations = self.iterations, 0
        return taken

    def destroy(self) -> None:
        """Free the factorisation; collective. The next solve factorises anew."""
        old, self.solver = self.solver, None
        if old is not None:
            old.destroy()


def mean_diagonal(K: PETSc.Mat, at: np.ndarray | None = None) -> float:
    """Mean size of K's diagonal entries, or of those of some rows (k,), the same on every rank
    [force / length]; collective."""
    own, (first, end) = np.abs(diagonal_of(K)), K.getOwnershipRange()
    if at is not None:
        own = own[at[(at >= first) & (at < end)] - first]
    total, count = K.comm.tompi4py().allreduce(np.array([own.sum(), len(own)]))
    return float(total / count)
