"""Newton's system: bodies, follower loads, and interfaces with unknowns of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.parallel import gather_rows
from dolfinx_llm.finite.terms import ContactTerms
from dolfinx_llm.forms.direct import DirectSolver
from dolfinx_llm.operators.numbering import BodyDofs, Numbering
from dolfinx_llm.operators.petsc import create_aij, is_symmetric, join_blocks, same_entries


@dataclass(frozen=True, eq=False)
class Part:
    """A sparse matrix between some unknowns, known to every rank."""

    matrix: csr_matrix
    rows: np.ndarray  # number of each row
    cols: np.ndarray  # number of each column


ONCE = {"ksp_max_it": 1}  # Newton's next iteration is the refinement
GROWN = 10  # entries that are stored over those that are there, from which they are forgotten


@dataclass(eq=False)
class NewtonSystem:
    """Newton's system for changes of u and of the interfaces' own unknowns q.

        [K + sum of K_i   top] [du]   [-r   ]
        [left             own] [dq] = [-rest]

    Contact that may part makes it unsymmetric: averaged normals and designed rows have forces that
    are no gradient. Blocks of ties are symmetric. Entries that contact has once had stay stored, as
    zeros: while nodes slide within their facets the factorisation's analysis serves again.
    """

    dofs: BodyDofs
    numbers: Sequence[np.ndarray]  # per interface (width,) dofs of its coordinates
    own: Numbering  # of all interfaces' own unknowns, one after the other
    sizes: Sequence[int]  # per interface
    stored: dict[str, csr_matrix] = field(default_factory=dict)  # entries of contact
    solver: DirectSolver | None = None  # of the last iteration

    def solve(
        self,
        K: PETSc.Mat,
        terms: Sequence[ContactTerms],
        followers: Sequence[Part],
        r: np.ndarray,
        options: tuple[str, dict | None],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Changes of this rank's u and of all q; collective. K is used up.

        Args:
            K: of the bodies, without conditions.
            terms: of the interfaces.
            followers: minus the derivatives of follower loads.
            r: (n_local,) residual; at prescribed dofs minus their change.
            options: prefix, and PETSc options.

        Raises:
            ContactError: MUMPS could not factorise.
        """
        sizes = self.dofs.sizes
        first, n = self.dofs.first, sizes[0]
        bodies = [Part(t.K, at, at) for t, at in zip(terms, self.numbers, strict=True)]
        local = self._rows("bodies", [*bodies, *followers], first, n, sizes[1], self.dofs.fixed)
        added = create_aij(self.dofs.comm, sizes, sizes, local)
        K.axpy(1.0, added, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        added.destroy()
        fixed = np.flatnonzero(self.dofs.fixed)
        diagonal = mean_diagonal(K)  # for the rows of prescribed dofs
        K.zeroRows((first + fixed).astype(PETSc.IntType), diag=diagonal)
        b = -r
        b[fixed] *= diagonal
        if not terms:
            return self._solved([[K]], [b], options)[0], np.zeros(0)
        blocks = self._blocks(terms, sizes)
        rest = np.concatenate([t.rest for t in terms])[self.own.mine]
        parts = self._solved([[K, blocks[0]], blocks[1:]], [b, -rest], options)
        return parts[0], gather_rows(self.dofs.comm, parts[1])[self.own.number]

    def _blocks(self, terms: Sequence[ContactTerms], sizes: tuple[int, int]) -> list[PETSc.Mat]:
        """Blocks top, left and own."""
        ends = np.cumsum([0, *self.sizes])
        places = [self.own.number[a:b] for a, b in zip(ends[:-1], ends[1:], strict=True)]
        both = list(zip(terms, self.numbers, places, strict=True))
        comm, (n, total), first = self.dofs.comm, sizes, self.dofs.first
        mine, count = self.own.sizes
        start = sum(self.own.owner < self.own.rank)
        fixed = self.dofs.fixed
        tops = [Part(t.top, u, q) for t, u, q in both]
        top = self._rows("top", tops, first, n, count, fixed)
        lefts = [Part(t.left, q, u) for t, u, q in both]
        left = self._rows("left", lefts, start, mine, total)
        own = [Part(t.own, q, q) for t, _, q in both]
        zero = csr_matrix((np.zeros(count), (np.arange(count), np.arange(count))), (count, count))
        own.append(Part(zero, np.arange(count), np.arange(count)))  # a stored diagonal
        return [
            create_aij(comm, sizes, self.own.sizes, top),
            create_aij(comm, self.own.sizes, sizes, left),
            create_aij(
                comm, self.own.sizes, self.own.sizes, self._rows("own", own, start, mine, count)
            ),
        ]

    def _rows(
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

    def _solved(
        self,
        blocks: Sequence[Sequence[PETSc.Mat]],
        b: Sequence[np.ndarray],
        options: tuple[str, dict | None],
    ) -> list[np.ndarray]:
        matrix, places = join_blocks(blocks)
        for M in (M for row in blocks for M in row):
            M.destroy()
        rhs = np.zeros(matrix.getLocalSize()[0])
        for place, part in zip(places, b, strict=True):
            rhs[place] = part
        self._factorise(matrix, options)
        assert self.solver is not None
        x = self.solver.solve(rhs)
        return [x[place] for place in places]

    def _factorise(self, matrix: PETSc.Mat, options: tuple[str, dict | None]) -> None:
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
        self.solver = DirectSolver(matrix, options[0], ONCE | (options[1] or {}), own=True)

    def destroy(self) -> None:
        """Free the factorisation; collective. The next solve factorises anew."""
        old, self.solver = self.solver, None
        if old is not None:
            old.destroy()


def mean_diagonal(K: PETSc.Mat) -> float:
    """Mean size of K's diagonal entries [force / length]; collective."""
    diagonal = K.getDiagonal()
    mean = diagonal.norm(PETSc.NormType.NORM_1) / diagonal.size
    diagonal.destroy()
    return float(mean)
