"""What must cancel at the nodes of a flat frame: forces of unit pressure (28), and moments.

At second order pressures that are linear along the surface pass as well if the moments of both
sides' forces about each frame node cancel. Multipliers by which rows are corrected have
equations of their own, and what these cannot see.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.sparse import diagonal, symmetric_factors
from dolfinx_llm.design.stencils import RowStencils, monomials, spread
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.loads import NodalLoads, squares

SHIFT = 1e-13  # of the largest diagonal entry, on all of it
SQUARES = (0, 0), (1, 0), (1, 1)  # products of coordinates along the surface
SIGNS = -1.0, 1.0  # of the corrections on both sides

Parts = Sequence[tuple[Array, Array]]  # unknowns (n,) and functions (n, f) of each


def patch_residual(N: Sequence[csr_matrix], forces: Sequence[Array]) -> Array:
    """Residual (28) at the frame's nodes over the largest force.

    Args:
        N: pair of (n_i, m) sparse matrices, the scalar L_b of each side.
        forces: pair of (n_i,) forces of unit pressure [area].

    Returns:
        (m,) residual; the frame passes where its largest value is at most 1e-13.
    """
    loads, s = [NodalLoads.of_forces(f) for f in forces], np.zeros((N[0].shape[1], 0))
    return FrameLoads(s, loads, [], 1.0, max(f.max() for f in forces)).residual(N)[:, 0]


@dataclass(frozen=True, eq=False)
class FrameLoads:
    """The forces and moments at the frame's nodes that must cancel."""

    s: Array  # (m, d) frame nodes in coordinates of the plane [length]
    loads: Sequence[NodalLoads]  # of both sides
    places: Sequence[Array]  # (n_i, d) where their nodes are [length]
    size: float  # of the frame's cells [length]
    scale: float  # largest force [area]
    tangents: Array | None = None  # (m, gdim - 1, gdim) at the nodes of a curved frame, where
    # s and places are positions in space

    @classmethod
    def of(
        cls, frame: Frame, s: Array, N: Sequence[csr_matrix], loads: Sequence[NodalLoads]
    ) -> FrameLoads:
        scale = max(float(np.abs(load.forces).max()) for load in loads)
        # Rows reproduce linear fields: so they tell where they are.
        return cls(s, loads, [M @ s for M in N], float(frame.cell_size.mean()), scale)

    @property
    def count(self) -> int:
        """Of equations at a frame node: 1, with moments gdim, with those of degree 2 three more."""
        d = self.loads[0].moments.shape[1]
        return 1 + d + 3 * self.square if self.tangents is None else d

    @property
    def square(self) -> bool:
        """Whether pressures of degree 2 are to pass."""
        return self.tangents is None and all(load.second is not None for load in self.loads)

    def at(self, side: int, indptr: Array, nodes: Array) -> Array:
        """(z, count) what the rows' loads are at entries: force, and moments about the node, of
        degree 2 as well."""
        load = self.loads[side]
        force = spread(load.forces, indptr)[:, None]
        if self.count == 1:
            return force / self.scale
        arm = spread(self.places[side], indptr) - self.s[nodes]
        first = spread(load.moments, indptr)
        moment = (first + arm * force) / self.size
        if self.tangents is not None:
            moment = np.einsum("zai,zi->za", self.tangents[nodes], moment)
        found = [force, moment]
        if self.square:
            crossed = [arm[:, i] * first[:, j] + arm[:, j] * first[:, i] for i, j in SQUARES]
            square = spread(np.asarray(load.second), indptr) + np.stack(crossed, 1)
            square += np.stack(squares(arm), 1) * force
            found.append(square / self.size**2)
        return np.column_stack(found) / self.scale

    def residual(self, N: Sequence[csr_matrix]) -> Array:
        """(m, 1) residual (28) at the frame's nodes over the largest force; (m, count) where loads
        have moments: force, and moments about the node over the frame's mean cell size."""
        return self.summed([(M.indptr, M.indices, M.data) for M in N])

    def summed(self, N: Sequence[tuple[Array, Array, Array]]) -> Array:
        """The same of rows as of CSR."""
        # Nᵀ f without the transpose: SciPy takes longer to make that than the product of small
        # frames.
        total, m = np.zeros((len(self.s), self.count)), len(self.s)
        for side, ((indptr, nodes, data), sign) in enumerate(zip(N, (1.0, -1.0), strict=True)):
            at = self.at(side, indptr, nodes)
            for a in range(self.count):
                total[:, a] += sign * np.bincount(nodes, data * at[:, a], m)
        return total


@dataclass(frozen=True, eq=False)
class Corrections:
    """How rows change under multipliers mu (m, c): delta_p = -+ P_p sum_a (c_pa mu_a) / w_p."""

    stencils: Sequence[RowStencils]  # of both sides
    at: Sequence[Array]  # (z_i, c) c_p at their entries, zero in rows that stay
    areas: Sequence[Array]  # (n_i,) w_p
    m: int  # frame nodes

    @classmethod
    def of(
        cls, loading: FrameLoads, stencils: Sequence[RowStencils], free: Sequence[Array]
    ) -> Corrections:
        """Of rows of which those with 1 in free (n_i,) may change, those with 0 stay."""
        at = [
            loading.at(i, st.indptr, st.nodes) * spread(k, st.indptr)[:, None]
            for i, (st, k) in enumerate(zip(stencils, free, strict=True))
        ]
        return cls(stencils, at, [a.shares / loading.scale for a in loading.loads], len(loading.s))

    @cached_property
    def equations(self) -> csr_matrix:
        """(m c, m c) sum_p c_p P_p c_pᵀ / w_p, by which mu changes the residual."""
        m, c = self.m, self.at[0].shape[1]
        alone, blocks = np.zeros((m, c, c)), []
        for st, load, area in zip(self.stencils, self.at, self.areas, strict=True):
            weight = spread(1.0 / area, st.indptr) * st.root**2
            for i in range(c):
                for j in range(c):
                    alone[:, i, j] += np.bincount(st.nodes, weight * load[:, i] * load[:, j], m)
            root = (spread(1.0 / np.sqrt(area), st.indptr) * st.root)[:, None] * load
            blocks.append(st.Q[:, :, None] * root[:, None])
        # Both sides at once, and by blocks, which are multiplied in a fifth of the time.
        first, then = (st.indptr for st in self.stencils)
        starts = np.append(first, first[-1] + then[1:])
        entries = np.concatenate(blocks), np.concatenate([st.nodes for st in self.stencils]), starts
        B = bsr_matrix(entries, ((len(starts) - 1) * blocks[0].shape[1], m * c))
        own = bsr_matrix((alone, np.arange(m), np.arange(m + 1)), (m * c, m * c))
        return (own - B.T @ B).tocsr()

    def under(self, mu: Array) -> list[Array]:
        """(z_i,) changes at the stencils' entries of both sides."""
        step = []
        for st, at, area, sign in zip(self.stencils, self.at, self.areas, SIGNS, strict=True):
            value = np.einsum("za,za->z", at, mu[st.nodes]) / spread(area, st.indptr)
            step.append(sign * st.project(value))
        return step


def factor(A: Any) -> Any:
    """Factors of the equations.

    Raises:
        ContactError: they are singular: rows that may be corrected are missing.
    """
    try:
        return symmetric_factors(A, pivots=True)
    except RuntimeError as error:  # SuperLU's "exactly singular"
        raise ContactError(
            "design by weights: the rows that may be corrected cannot balance the frame "
            f"(SuperLU: {error}). Give a coarser frame, or frame=None for a predicted one"
        ) from None


def compatible(A: csr_matrix, s: Array, loading: FrameLoads) -> Parts:
    """Orthonormal functions that A cannot see, on each connected part of the frame: what holds of
    forces and moments whatever the rows are. With forces alone these are the affine functions.

    With moments sum_J r_J pi(s_J) = 0 for each pressure 1 and s, of degree 2 where these pass, and
    each polynomial pi of degree 2, the moments about one point made of those about the nodes.

    Returns:
        List of (unknowns, functions (n, f)) per part.
    """
    c, d = loading.count, s.shape[1]
    seen = A.copy()
    seen.data[np.abs(seen.data) <= 1e-14 * max(A.diagonal().max(), 1e-300)] = 0.0
    seen.eliminate_zeros()
    part = connected_components(seen, directed=False)[1][::c]
    order = np.argsort(part, kind="stable")
    parts = []
    for nodes in np.split(order, np.flatnonzero(np.diff(part[order])) + 1):
        x = s[nodes] - s[nodes].mean(axis=0)
        pi = np.column_stack(monomials(x, 1 if c == 1 else 2))
        local = pi[:, None]
        if c > 1:
            local = np.zeros((len(nodes), c, c, pi.shape[1]))
            local[:, 0, 0] = pi
            for a in range(d):
                local[:, 0, 1 + a], local[:, 1 + a, 1 + a] = x[:, a, None] * pi, loading.size * pi
            for k, (i, j) in enumerate(SQUARES, 1 + d) if loading.square else ():
                local[:, 0, k] = (x[:, i] * x[:, j])[:, None] * pi
                local[:, 1 + i, k] += loading.size * x[:, j, None] * pi
                local[:, 1 + j, k] += loading.size * x[:, i, None] * pi
                local[:, k, k] = loading.size**2 * pi
            local = local.reshape(len(nodes) * c, -1)
            local /= np.linalg.norm(local, axis=0) + 1e-300
        local = local.reshape(len(nodes) * c, -1)
        U, size, _ = np.linalg.svd(local / np.linalg.norm(local), full_matrices=False)
        unknowns = (nodes[:, None] * c + np.arange(c)).ravel()
        parts.append((unknowns, U[:, size > 1e-10]))
    return parts


def without_compatible(r: Array, parts: Parts) -> Array:
    """r less its compatible parts: they are rounding (both sides carry the same force with the same
    centroid), and no correction of the rows can remove them."""
    r = r.copy()
    for unknowns, U in parts:
        r[unknowns] -= U @ (U.T @ r[unknowns])
    return r


def pins(A: csr_matrix, parts: Parts) -> csr_matrix:
    """Diagonal that fixes the compatible functions on each part, where they are held best.

    The right-hand side is free of them, so pinning changes no equation. SHIFT is for what else A
    cannot see, as where rows that are kept leave strips of stencils; refinement makes up for it.
    """
    held = A.diagonal()
    largest = held.max()
    if not largest > 0.0:  # no row may be corrected
        return diagonal(np.ones(len(held)))
    pins = np.where(held <= 1e-14 * largest, largest, SHIFT * largest)
    for nodes, U in parts:
        rest = U.copy()
        for _ in range(U.shape[1]):
            size = np.einsum("ni,ni->n", rest, rest)
            best = int(size.argmax())
            pins[nodes[best]] = largest
            rest = rest - np.outer(rest @ rest[best], rest[best]) / size[best]
    return diagonal(pins)
