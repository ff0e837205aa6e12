"""Matrices of interfaces and follower loads between unknowns, which all ranks know, and where these
stand in Newton's system."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.finite.pairs.terms import ContactTerms
from dolfinx_llm.operators.numbering import BodyDofs, Numbering
from dolfinx_llm.operators.petsc import create_aij

GROWN = 10  # entries that are stored over those that are there, from which they are forgotten


@dataclass(frozen=True, eq=False)
class Part:
    """A sparse matrix between some unknowns, known to every rank."""

    matrix: csr_matrix
    rows: Array  # number of each row
    cols: Array  # number of each column


def entries(
    parts: Sequence[Part], first: int, n: int, without: Array | None = None
) -> tuple[Array, Array, Array]:
    """Rows, columns and values of some parts in n rows from the first one on, but for those (n,)
    left out; rows count from there."""
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
    return np.concatenate(rows), np.concatenate(cols), np.concatenate(values)


@dataclass(eq=False)
class Parts:
    """Where unknowns stand, and matrices between them of what every rank knows of interfaces."""

    dofs: BodyDofs
    numbers: Sequence[Array]  # per interface (width,) dofs of its coordinates
    own: Numbering  # of all interfaces' own unknowns, one after the other
    sizes: Sequence[int]  # per interface
    stored: dict[str, csr_matrix] = field(default_factory=dict)  # entries of contact

    def add(self, K: PETSc.Mat, parts: Sequence[Part]) -> None:
        """Add parts to K, but for rows of prescribed dofs."""
        sizes = self.dofs.sizes
        local = self.rows("bodies", parts, self.dofs.first, *sizes, self.dofs.fixed)
        added = create_aij(self.dofs.comm, sizes, sizes, local)
        K.axpy(1.0, added, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        added.destroy()

    def blocks(self, terms: Sequence[ContactTerms]) -> list[PETSc.Mat]:
        """Blocks top, left and own."""
        ends = np.cumsum([0, *self.sizes])
        places = [self.own.number[a:b] for a, b in zip(ends[:-1], ends[1:], strict=True)]
        both = list(zip(terms, self.numbers, places, strict=True))
        comm, sizes, first = self.dofs.comm, self.dofs.sizes, self.dofs.first
        (n, total), (mine, count) = sizes, self.own.sizes
        start = sum(self.own.owner < self.own.rank)
        tops = [Part(t.top, u, q) for t, u, q in both]
        top = self.rows("top", tops, first, n, count, self.dofs.fixed)
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
        without: Array | None = None,
    ) -> csr_matrix:
        """(n, width) this rank's rows of the sum of some parts, but for those (n,) left out, with
        the entries that a block of this name has had before."""
        rows, cols, values = entries(parts, first, n, without)
        count = len(rows)
        if name in self.stored and self.stored[name].nnz < GROWN * count:
            before = self.stored[name].tocoo()
            rows, cols = np.append(rows, before.row), np.append(cols, before.col)
            values = np.append(values, 0.0 * before.data)
        found = csr_matrix((values, (rows, cols)), (n, width))
        self.stored[name] = found
        return found
