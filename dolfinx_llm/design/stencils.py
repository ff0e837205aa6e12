"""What rows of L_b may be corrected on: weighted nodes around each row, and what it must keep.

Each row p has weights w_pJ on the frame nodes around its own, which vary continuously with its
place: on an edge or a node of the frame they do not depend on which of the adjacent cells is named
first. With the row's constraints C (sum delta = 0, linear fields stay), corrections that keep them
are delta_p = P_p mu, P = √W (I - Q Qᵀ)² √W, Q an orthonormal base of √W C. Ragged arrays in the
pattern of a CSR matrix, so that all rows are treated at once, whatever their number of nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.loads import squares

ZERO = 1e-13  # shape functions below this are rounding: the node lies on an edge
NONE_LEFT = 1e-11  # of the largest singular value: no other direction than rounding's
DEPENDENT = 1e-20  # part of a function's square that is left of it, below which it is none
FADE = 1e-4  # of the largest singular value: where constraints fade that hardly differ from others


@dataclass(frozen=True, eq=False)
class RowStencils:
    """Stencils of n rows, z entries in all, with c constraints each."""

    indptr: Array  # (n + 1,)
    nodes: Array  # (z,) frame nodes
    root: Array  # (z,) square roots of the weights
    Q: Array  # (z, c) orthogonal columns per row, of length 1; less where a constraint fades

    @property
    def shape(self) -> tuple[int, int]:
        """(n, c)"""
        return len(self.indptr) - 1, self.Q.shape[1]

    def project(self, mu: Array) -> Array:
        """(z,) P_p mu of values (z,) at the entries, without what the constraints see.

        Done twice: P takes away nearly all of a large smooth mu, and the rounding that the first
        time leaves would break the constraints.
        """
        value = self.root * mu
        for _ in range(2):
            for q in self.Q.T:
                value = value - q * spread(sums(q * value, self.indptr), self.indptr)
        return self.root * value

    def matrix(self, values: Array, m: int) -> csr_matrix:
        """(n, m) matrix of values (z,) at the entries."""
        return csr_matrix((values, self.nodes, self.indptr), (self.shape[0], m))


def sums(values: Array, indptr: Array) -> Array:
    """Sums of entries per row; no row is empty."""
    return np.add.reduceat(values, indptr[:-1])


def spread(values: Array, indptr: Array) -> Array:
    """Values of rows at their entries."""
    return values.repeat(indptr[1:] - indptr[:-1], axis=0)


def adjacency(cells: Array, m: int) -> csr_matrix:
    """(m, m) matrix of ones where two nodes belong to one cell, with the diagonal."""
    n, k = cells.shape
    of = csr_matrix((np.ones(n * k), cells.ravel(), np.arange(0, n * k + 1, k)), shape=(n, m))
    A = (of.T @ of).T  # symmetric, and as CSR at hand
    A.data[:] = 1.0
    return A


def inner_part(N: csr_matrix) -> csr_matrix:
    """N without what is negative (it is continued beyond the outline) or rounding, sums 1."""
    inside = N.copy()
    inside.data[inside.data < ZERO] = 0.0
    inside.eliminate_zeros()
    inside.data /= spread(sums(inside.data, inside.indptr), inside.indptr)
    return inside


def row_weights(N: csr_matrix, around: csr_matrix) -> csr_matrix:
    """(n, m) weights of the frame nodes in each row's stencil: those around the row's own nodes.

    Args:
        N: interpolation.
        around: (m, m) how much each node belongs to the surroundings of each.
    """
    return (inner_part(N) @ around).tocsr()


@dataclass(frozen=True, eq=False)
class FlatStencils:
    """Stencils on flat frames, and the least corrections that reproduce their polynomials."""

    rows: RowStencils
    missing: Array  # (z,) corrections of the entries, 0 where rows reproduce them already


def flat_stencils(W: csr_matrix, s: Array, N: csr_matrix, degree: int) -> FlatStencils:
    """Stencils of weights W whose corrections keep polynomials of the plane.

    Args:
        s: (m, d) frame nodes in coordinates of the plane [length].
        N: (n, m) the rows, which reproduce linear fields.
        degree: of the polynomials, 1 or 2.
    """
    total = sums(W.data, W.indptr)
    mean = np.column_stack([sums(W.data * c, W.indptr) / total for c in s[W.indices].T])
    functions = monomials(s[W.indices] - spread(mean, W.indptr), degree)
    if degree > 1:
        return polynomial_stencils(W, functions, _deficits(N, s, mean))
    return polynomial_stencils(W, functions)


def polynomial_stencils(
    W: csr_matrix, functions: Sequence[Array], wanted: Sequence[Array] | None = None
) -> FlatStencils:
    """Stencils of weights W whose corrections keep the rows' sums of functions.

    Args:
        functions: each (z,) at the entries of W; the first is 1.
        wanted: of each (n,) what the rows' sums lack; None: nothing.
    """
    root, n = np.sqrt(W.data), len(W.indptr) - 1
    columns: list[Array] = []
    targets: list[Array] = []
    for value, target in zip(functions, wanted or [np.zeros(n)] * len(functions), strict=True):
        q = root * value
        size = sums(q * q, W.indptr)
        for _ in range(2):  # again, against rounding
            for other, known in zip(columns, targets, strict=True):
                part = sums(other * q, W.indptr)
                q, target = q - other * spread(part, W.indptr), target - part * known
        norm = sums(q * q, W.indptr)
        # What does not differ from the functions before, for want of nodes, is no constraint.
        norm = np.sqrt(np.where(norm > DEPENDENT * size, norm, np.inf))
        columns.append(q / spread(norm, W.indptr))
        targets.append(target / norm)
    missing = np.zeros(len(root))
    if wanted is not None:
        missing = root * sum(q * spread(t, W.indptr) for q, t in zip(columns, targets))
    return FlatStencils(RowStencils(W.indptr, W.indices, root, np.column_stack(columns)), missing)


def monomials(x: Array, degree: int) -> list[Array]:
    """1, the coordinates (n, d) and, at degree 2, their products, each (n,)."""
    out = [np.ones(len(x)), *x.T]
    return out + squares(x) if degree > 1 else out


def _deficits(N: csr_matrix, s: Array, mean: Array) -> list[Array]:
    """By how much rows (n, m) miss the polynomials of degree 2 about a point (n, d) each."""
    own = monomials(N @ s - mean, 2)
    at_nodes = monomials(s[N.indices] - spread(mean, N.indptr), 2)
    linear = s.shape[1] + 1  # which they reproduce
    return [
        np.zeros(len(mean)) if i < linear else f - sums(N.data * g, N.indptr)
        for i, (f, g) in enumerate(zip(own, at_nodes, strict=True))
    ]


@dataclass(frozen=True, eq=False)
class CurvedStencils:
    """Stencils on curved frames, and the least corrections that change what their rows sum up."""

    rows: RowStencils
    C: Array  # (z, c) functions of the nodes less their means, over h, along V
    V: Array  # (n, c, c) in which the C W C of each row is diagonal
    inverse: Array  # (n, c) of these, filtered
    h: Array  # (n,) size of the functions [length]

    def moved(self, step: Array) -> Array:
        """(z,) least corrections that change the rows' sums of functions by (n, c) [length]."""
        indptr, weight = self.rows.indptr, self.rows.root**2
        delta, total = np.zeros(len(weight)), sums(weight, indptr)
        left = np.einsum("nik,ni->nk", self.V, step / self.h[:, None])
        for _ in range(2):  # again, against rounding
            more = np.einsum("zk,zk->z", self.C, spread(self.inverse * left, indptr))
            more = weight * (more - spread(sums(weight * more, indptr) / total, indptr))
            delta = delta + more
            left = left - np.column_stack([sums(more * c, indptr) for c in self.C.T])
        return delta


def curved_stencils(W: csr_matrix, functions: Array, fade: float) -> CurvedStencils:
    """Stencils of weights W whose corrections keep the rows' sums and those of functions.

    Where the surface is nearly flat, or a stencil has few nodes, a constraint hardly differs from
    the others: with S the singular values of √W C it is kept by 1 - (q / (S² + q))⁴, q the square
    of ``fade`` times the largest, which fades instead of cutting.

    Args:
        functions: (z, c) at the entries of W, as the nodes' places, from each row's own on: then
            linear fields of space are kept [length].
    """
    indptr, root = W.indptr, np.sqrt(W.data)
    total, c = sums(W.data, indptr), functions.shape[1]
    parts = [f - spread(sums(W.data * f, indptr) / total, indptr) for f in functions.T]
    gram = np.empty((len(total), c, c))
    for i in range(c):
        for j in range(i + 1):
            gram[:, i, j] = gram[:, j, i] = sums(W.data * parts[i] * parts[j], indptr)
    trace = np.einsum("nii->n", gram)
    h = np.sqrt(np.maximum(trace / total, 1e-300))
    square, V = np.linalg.eigh(gram / (h * h)[:, None, None])
    C = np.einsum(
        "zi,zik->zk", np.column_stack(parts) / spread(h, indptr)[:, None], spread(V, indptr)
    )
    # Summed up anew: of a small one rounding is a large part. Along straight edges, and across
    # flat ones, nodes differ by rounding alone.
    square = np.column_stack([sums(W.data * column**2, indptr) for column in C.T])
    none = square <= NONE_LEFT**2 * square[:, -1:]
    C, square = np.where(spread(none, indptr), 0.0, C), np.where(none, 0.0, square)
    q = np.maximum(fade**2 * square[:, -1:], 1e-300)
    t = q / (square + q)
    # Applied twice in ``project``: 1 - t² each time.
    Q = root[:, None] * C * spread(np.sqrt((1.0 + t) / (square + q)), indptr)
    Q = np.column_stack([root / np.sqrt(spread(total, indptr)), Q])
    inverse = np.where(none, 0.0, (1.0 + t) * (1.0 + t * t) / (square + q))
    return CurvedStencils(RowStencils(indptr, W.indices, root, Q), C, V, inverse, h)
