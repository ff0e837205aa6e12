"""Rows between second-order bodies that are tied along curved surfaces.

The frame's cells are second-order facets as they are drawn. Each row has a chart of its own, the
tangent plane at its node, in which it reproduces polynomials of degree 2; each frame node one in
which forces f_p = ∫ N_p dA and moments ∫ N_p (x - Y_J) dA of both sides cancel, so that tractions
that are linear along the surface pass. Charts of neighbours differ by terms of third order, and so
do the areas that two meshes have of one surface: what no correction removes without large ones
stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix, identity

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.design.residual import Corrections, FrameLoads, factor
from dolfinx_llm.design.stencils import (
    FlatStencils,
    adjacency,
    monomials,
    polynomial_stencils,
    spread,
    sums,
)
from dolfinx_llm.design.weights import NARROW, row_stencil_weights, widths_of
from dolfinx_llm.geometry.cells import CORNERS, facet_normals, unit
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.overlap_flat import local_bases
from dolfinx_llm.geometry.pairs import ContactPairs

# Of the largest entry, what large multipliers are held with: less only where it leaves WORTH of the
# rest. Around closed surfaces corrections grow that lower nothing, and places are lost.
DAMPINGS = (1e-3, 1e-6, 1e-8)
WORTH = 0.5
DOES = 1e-3  # of the largest force, with which narrow stencils do: wide ones cost accuracy
REFINED = 4  # solves, each for what the last one left
GAINS = 0.9  # what solves and wider stencils must leave at most: below, rounding chooses


def bent_normals(frame: Frame) -> Array:
    """(m, gdim) unit normals of second-order cells, at each node the mean of those around."""
    element = frame.element
    xi = element.linear @ CORNERS[element.corners]
    normals = np.zeros_like(frame.x)
    np.add.at(normals, frame.cells, facet_normals(frame.x, frame.cells, element.shape(xi)[1]))
    return unit(normals)


def from_smooth(frame: Frame, pairs: ContactPairs, normals: Array) -> ContactPairs:
    """The same pairs with gaps from the smooth surface through the frame's nodes, not from where
    rows have it, y = Σ N_J Y_J: that lies off by half of what the tangent planes there tell, Σ N_J
    (Y_J - y)·n_J, on spheres and cylinders exactly.

    Args:
        normals: (m, gdim) at the frame's nodes, of which the pairs' normals are the means.
    """
    at, mean = pairs.N @ frame.x, pairs.N @ normals
    told = pairs.N @ np.einsum("ji,ji->j", frame.x, normals) - np.einsum("ni,ni->n", at, mean)
    return replace(pairs, gap=pairs.gap - 0.5 * told[:, None] * unit(mean))


def bent_rows(
    frame: Frame,
    pairs: Sequence[ContactPairs],
    normals: Array,
    keep: Sequence[Array] | None,
) -> list[csr_matrix]:
    """Per side (n_i, m) rows with the smallest corrections.

    Where rows would need large ones all the same, those of nodes far beyond the frame's outline,
    as of facets that are covered in part, go on linearly: polynomials of degree 2 want far more
    there than forces at such nodes are worth.

    Args:
        frame: m nodes, of second order.
        pairs: of both sides, with loads of second order.
        normals: (m, gdim) at the frame's nodes.
        keep: per side (n_i,) whether a row stays as it is; None: all may change.

    Raises:
        ContactError: corrections would be large whatever is left.
    """
    for most in (np.inf, NARROW):
        found = _least_residual(frame, pairs, normals, keep, most)
        if found is not None:
            return found
    apart = max(float(np.linalg.norm(p.gap, axis=1).max()) for p in pairs)
    raise ContactError(
        "design by weights: rows of the curved frame would need corrections above "
        f"{NARROW:g}. The surfaces lie up to {apart:.3g} apart, facets have the size "
        f"{float(frame.cell_size.mean()):.3g}: leave what curves away from the other body and does "
        "not touch it out of the tags. Else give bodies whose meshes along the interface are more "
        "alike, or finer"
    )


def _least_residual(
    frame: Frame,
    pairs: Sequence[ContactPairs],
    normals: Array,
    keep: Sequence[Array] | None,
    most: float,
) -> list[csr_matrix] | None:
    """``bent_rows``, of which those that need corrections above ``most`` for polynomials of degree
    2 alone do not reproduce these; None where others are too large."""
    tangents = local_bases(normals)[:, :-1]
    loading = FrameLoads(
        frame.x, [p.loads for p in pairs], [p.x for p in pairs], float(frame.cell_size.mean()),
        max(float(np.abs(p.loads.forces).max()) for p in pairs), tangents,
    )  # fmt: skip
    ring, plain = adjacency(frame.cells, len(frame.x)), [p.N for p in pairs]
    free = [np.ones(len(p.nodes)) for p in pairs] if keep is None else [1.0 - k for k in keep]
    best, least = plain, np.inf
    for widths in widths_of(frame.x[:, 1:], plain):
        stencils = [
            _stencils(row_stencil_weights(M, ring, frame, width), frame, p, normals, most)
            for M, p, width in zip(plain, pairs, widths, strict=True)
        ]
        last = np.inf
        for held in DAMPINGS:
            found = _balanced(loading, plain, stencils, free, held)
            change = max(abs(M - L).max() for M, L in zip(found, plain, strict=True))
            left = _largest(loading.residual(found))
            if change > NARROW or left > WORTH * last:
                break
            last = left
            if left < GAINS * least:
                best, least = found, left
        if least <= DOES:
            break
    return None if best is plain else best


def _stencils(
    W: csr_matrix, frame: Frame, pairs: ContactPairs, normals: Array, most: float
) -> FlatStencils:
    """Stencils of a side's rows, each in the tangent plane at its node; ``most`` as of
    ``_least_residual``."""
    base = local_bases(unit(pairs.N @ normals))[:, :-1]
    size = frame.cell_size.mean()

    def functions(M: csr_matrix) -> list[Array]:
        arm = (frame.x[M.indices] - spread(pairs.x, M.indptr)) / size
        return monomials(np.einsum("zai,zi->za", spread(base, M.indptr), arm), 2)

    own = pairs.N
    wanted = [-sums(own.data * f, own.indptr) for f in functions(own)]
    wanted[0] = wanted[0] + 1.0
    found = polynomial_stencils(W, functions(W), wanted)
    large = np.maximum.reduceat(np.abs(found.missing), W.indptr[:-1]) > most
    return replace(found, missing=np.where(spread(large, W.indptr), 0.0, found.missing))


def _balanced(
    loading: FrameLoads,
    N: Sequence[csr_matrix],
    found: Sequence[FlatStencils],
    free: Sequence[Array],
    held: float,
) -> list[csr_matrix]:
    """Rows that reproduce their polynomials, and balance as far as held multipliers allow."""
    m, stencils = len(loading.s), [f.rows for f in found]
    corrections = Corrections.of(loading, stencils, free)
    A = corrections.equations
    d = A.diagonal().reshape(m, -1)
    most = max(d[:, 0].max(), d[:, 1:].mean(axis=1).max())  # whatever the axes of the moments
    solve = factor(A + held * most * identity(A.shape[0])).solve
    delta = [f.missing * spread(k, f.rows.indptr) for f, k in zip(found, free, strict=True)]
    last, best = np.inf, list(N)
    for _ in range(REFINED):
        rows = [M + st.matrix(d, m) for M, d, st in zip(N, delta, stencils, strict=True)]
        residual = loading.residual(rows)
        if not _largest(residual) < GAINS * last:
            break
        best, last = rows, _largest(residual)
        step = corrections.under(solve(residual.ravel()).reshape(m, -1))
        delta = [d + more for d, more in zip(delta, step, strict=True)]
    return best


def _largest(residual: Array) -> float:
    """Largest force, or moment whatever its axes, of (m, gdim) at the frame's nodes."""
    force, moment = np.abs(residual[:, 0]), np.linalg.norm(residual[:, 1:], axis=1)
    return float(max(force.max(), moment.max()))
