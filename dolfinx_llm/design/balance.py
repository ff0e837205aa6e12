"""Balance of vector areas on curved frames, in least squares (design, 5).

On a curved interface the facets of two meshes do not have the same area, and a part of
r_J = sum_p N_pJ a_p + sum_q N_qJ a_q, the vector form of (28), remains whatever the rows are. What
can go is taken away by the smallest change of the rows that keeps places in space; without friction
by the smallest that keeps moments, of what acts along normals alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix, diags, vstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import symmetric_factors
from dolfinx_llm.design.curved import vector_residual
from dolfinx_llm.design.stencils import RowStencils, spread, sums

BALANCING = 0.25  # correction of an entry of L_b
DAMPING = 1e-4  # k, of the largest trace of a node's block
DAMPING_ITERATED = 1e-3  # the same where the equations are iterated
CORRIGIBLE = 1e-12  # trace of a node's block up to which no row there can be corrected
TRIALS, POWER = 4, 2.0  # of weighing rows with larger ones less; by which power of the excess
ROUNDS, WON = 10, 0.9  # of refinement against damping and limits; what each must leave at most
ROUNDS_ITERATED = 2  # the same where the equations are iterated: later ones win little
DIRECT_UNKNOWNS = 12000  # unknowns up to which the equations are factorised
ITERATIONS, ITERATION_ERROR = 60, 1e-2  # of conjugate gradients beyond that

_Solve = Callable[[Array], Array]


def balance(
    N: Sequence[csr_matrix],
    vectors: Sequence[Array],
    stencils: Sequence[RowStencils],
    stay: Sequence[bool] = (False, False),
    weight: Array | None = None,
) -> list[csr_matrix]:
    """Correct the rows so that the vector areas cancel at the frame's nodes, in least squares.

    Minimises sum_p |a_p| / c_p sum_J delta_pJ² / w_pJ: with n_p the direction of a_p and one
    multiplier mu_J in space per frame node, delta_p = -c_p P_p (n_p · mu) and
    (sum_p c_p |a_p| (n_p n_pᵀ) x P_p + k) mu = r. Then k mu is left of r, k in proportion to a
    weight. c_p is 1, less for rows whose corrections would be larger than BALANCING: the others
    make up for them.

    Args:
        N: pair of (n_i, m) rows.
        vectors: pair of (n_i, gdim) vector areas of the pairs out of their sides, or (n_i, 1)
            ``loads_along_normals`` [area].
        stencils: what the rows of each side may be corrected on.
        stay: whether those of a side stay.
        weight: (m,) in proportion to which the frame's nodes keep what cannot go, about an axis
            their area; None: alike.

    Returns:
        Pair of (n_i, m) CSR matrices.
    """
    r = vector_residual(N, vectors)
    weight = np.ones(len(r)) if weight is None else weight
    rows = _Rows.of(vectors, stencils, weight, stay)
    solve = rows.solver()
    mu = solve(r)
    for _ in range(TRIALS - 1):
        softer = rows.softer(mu)
        if softer is None:
            break
        rows = softer
        solve = rows.solver()
        mu = solve(r)
    best, left = list(N), r
    for k in range(
        ROUNDS_ITERATED if rows.iterated else ROUNDS
    ):  # each time the damping counts for less; ends when little is won
        mu = mu + solve(left) if k else mu
        tried = [M + D for M, D in zip(N, rows.matrices(mu), strict=True)]
        last, left = np.linalg.norm(left), vector_residual(tried, vectors)
        if not np.linalg.norm(left) < WON * last:
            break
        best = tried
    return best


@dataclass(frozen=True, eq=False)
class _Rows:
    """The rows of both sides and what each counts for."""

    stencils: Sequence[RowStencils]
    size: Sequence[Array]  # (n_i,) |a_p| over the largest
    normal: Sequence[Array]  # (n_i, gdim) n_p
    share: Sequence[Array]  # (n_i,) c_p
    weight: Array  # (m,) of the frame's nodes

    @staticmethod
    def of(
        vectors: Sequence[Array],
        stencils: Sequence[RowStencils],
        weight: Array,
        stay: Sequence[bool],
    ) -> _Rows:
        """Rows that all count for the same, but for those that stay."""
        scale = max(np.linalg.norm(a, axis=1).max() for a in vectors)
        size = [np.linalg.norm(a, axis=1) / scale for a in vectors]
        normal = [a / (scale * np.maximum(f, 1e-300))[:, None] for a, f in zip(vectors, size)]
        same = [np.full(len(f), float(not kept)) for f, kept in zip(size, stay, strict=True)]
        return _Rows(stencils, size, normal, same, weight)

    @property
    def shape(self) -> tuple[int, int]:
        """(m, gdim) of the multipliers."""
        return len(self.weight), self.normal[0].shape[1]

    @property
    def iterated(self) -> bool:
        """Whether there are too many equations to factorise them."""
        return self.shape[0] * self.shape[1] > DIRECT_UNKNOWNS

    def corrections(self, mu: Array) -> list[Array]:
        """Per side (z,) corrections at the stencils' entries of multipliers (m, gdim)."""
        return [
            -spread(c, st.indptr)
            * st.project(np.einsum("zi,zi->z", spread(n, st.indptr), mu[st.nodes]))
            for st, n, c in zip(self.stencils, self.normal, self.share, strict=True)
        ]

    def excess(self, delta: Sequence[Array]) -> list[Array]:
        """Per side (n_i,) largest correction of each row over BALANCING, 1 where it is less."""
        return [
            np.maximum(np.maximum.reduceat(np.abs(d), st.indptr[:-1]) / BALANCING, 1.0)
            for d, st in zip(delta, self.stencils, strict=True)
        ]

    def softer(self, mu: Array) -> _Rows | None:
        """Rows of which those with too large corrections count for less; None: there are none."""
        excess = self.excess(self.corrections(mu))
        if max(e.max() for e in excess) <= 1.0:
            return None
        share = [c / e**POWER for c, e in zip(self.share, excess, strict=True)]
        return replace(self, share=share)

    def matrices(self, mu: Array) -> list[csr_matrix]:
        """(n_i, m) corrections, each row's scaled to at most BALANCING: that keeps its places."""
        delta = self.corrections(mu)
        excess = self.excess(delta)
        return [
            st.matrix(d / spread(e, st.indptr), self.shape[0])
            for d, e, st in zip(delta, excess, self.stencils, strict=True)
        ]

    def solver(self) -> _Solve:
        """Solutions mu for r, both (m, gdim): by a factor or, for large frames, iterated."""
        m, gdim = self.shape
        diagonal, S, n = self.terms()
        # The trace of a node's block knows no axes.
        trace = np.einsum("mii->m", diagonal) - np.bincount(S.indices, S.data**2, m)
        largest = max(float(trace.max()), CORRIGIBLE)
        if self.iterated:
            shift, transposed = DAMPING_ITERATED * largest * self.weight, S.T.tocsr()
            shifted = diagonal + shift[:, None, None] * np.eye(gdim)

            def product(x: Array) -> Array:
                along = np.einsum("ni,ni->n", S @ x, n)
                return np.einsum("mij,mj->mi", shifted, x) - transposed @ (along[:, None] * n)

            return partial(_conjugate_gradients, product, 1.0 / (trace + shift)[:, None])
        B = bsr_matrix(
            ((S.data[:, None] * spread(n, S.indptr))[:, None, :], S.indices, S.indptr),
            (len(n), m * gdim),
        ).tocsr()
        blocks = bsr_matrix((diagonal, np.arange(m), np.arange(m + 1)), (m * gdim, m * gdim))
        A = blocks - B.T @ B + diags(DAMPING * largest * np.repeat(self.weight, gdim))
        factor = symmetric_factors(A)
        return lambda r: factor.solve(r.ravel()).reshape(m, gdim)

    def terms(self) -> tuple[Array, csr_matrix, Array]:
        """The equations' matrix sum_p c_p |a_p| (n_p n_pᵀ) x P_p: diagonal blocks (m, gdim, gdim),
        less s_k s_kᵀ x n_k n_kᵀ of the rows of S (k, m) and directions n (k, gdim)."""
        m, gdim = self.shape
        diagonal, rows, normals = np.zeros((m, gdim * gdim)), [], []
        for st, size, n, c in zip(self.stencils, self.size, self.normal, self.share, strict=True):
            # Sum of f w n nᵀ at the nodes, less the products of what the constraints see.
            f = size * c
            weights = st.matrix(spread(f, st.indptr) * st.root**2, m)
            diagonal += weights.T @ (n[:, :, None] * n[:, None, :]).reshape(len(n), gdim * gdim)
            length = spread(np.sqrt(f), st.indptr) * st.root
            for q in st.Q.T:
                # Twice applied, a column of length² l counts as l (2 - l).
                twice = spread(2.0 - sums(q * q, st.indptr), st.indptr)
                rows.append(st.matrix(length * q * np.sqrt(twice), m))
                normals.append(n)
        return diagonal.reshape(m, gdim, gdim), vstack(rows, "csr"), np.concatenate(normals)


def _conjugate_gradients(product: Callable[[Array], Array], scaling: Array, b: Array) -> Array:
    """Solution of A x = b, A positive definite, scaled; to ITERATION_ERROR of b where that comes
    within ITERATIONS: what is left shows in the residual, by which a design is judged."""
    x, r = np.zeros_like(b), b.copy()
    z = scaling * r
    p, square = z.copy(), np.vdot(r, z)
    for _ in range(ITERATIONS):
        if not np.linalg.norm(r) > ITERATION_ERROR * np.linalg.norm(b):
            break
        q = product(p)
        step = square / np.vdot(p, q)
        x, r = x + step * p, r - step * q
        z = scaling * r
        last, square = square, np.vdot(r, z)
        p = z + square / last * p
    return x
