"""Design of a frame: make a constant pressure pass exactly (paper, section 5, (28)).

The residual of a frame is, per frame node, the force that arrives from side 0 less the one from
side 1 when both sides carry the same pressure. ``design_weights`` brings it to zero by the smallest
change of the rows of L_b, ``positions.design_positions`` by moving the frame's nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import matmul
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, diags, identity, vstack
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.design.arguments import weight_arguments
from dolfinx_llm.design.stencils import (
    RowStencils,
    adjacency,
    flat_stencils,
    row_weights,
    spread,
)
from dolfinx_llm.geometry.frame import Frame

TOLERANCE = 1e-13  # a frame with max|r| / max f below this passes
NARROW = 0.15  # largest correction up to which stencils of one ring of nodes are enough
OUTER = 0.01  # weight of that ring: corrections far from a row's own nodes cost accuracy
RINGS = 4  # rings in the stencils of a side much coarser than the frame
SHIFT = 1e-13  # of the largest diagonal entry, on all of it


_Parts = Sequence[tuple[np.ndarray, np.ndarray]]  # nodes (n,) and functions (n, c) of each part


def patch_residual(N: Sequence[csr_matrix], forces: Sequence[np.ndarray]) -> np.ndarray:
    """Residual (28) at the frame's nodes over the largest force.

    Args:
        N: pair of (n_i, m) sparse matrices, the scalar L_b of each side.
        forces: pair of (n_i,) forces of unit pressure [area].

    Returns:
        (m,) residual; the frame passes where its largest value is at most 1e-13.
    """
    scale = max(f.max() for f in forces)
    # Nᵀ f without the transpose: SciPy takes longer to make that than the product of small frames.
    at_frame = [
        np.bincount(M.indices, M.data * np.repeat(f / scale, np.diff(M.indptr)), M.shape[1])
        for M, f in zip(N, forces, strict=True)
    ]
    return at_frame[0] - at_frame[1]


def design_weights(
    frame: Frame,
    s: np.ndarray,
    N: Sequence[csr_matrix],
    cells: Sequence[np.ndarray],
    forces: Sequence[np.ndarray],
    keep: Sequence[np.ndarray] | None = None,
) -> Sequence[csr_matrix]:
    """Correct the rows of L_b so that the frame passes, by the smallest change.

    Minimises sum_p f_p sum_J delta_pJ² / w_pJ subject to sum_J delta_pJ = 0 and
    sum_J delta_pJ Y_J = 0 (rigid motions and linear fields still pass exactly) and to (28). The
    weights w_pJ = sum_K N_pK A_KJ, A_KK = 1 and less for other nodes of one cell, are those of the
    nodes around p's own; they vary continuously with the place of p, also across the edges of
    cells, and know no axes. With one multiplier mu_J per frame node the solution is
    delta_p = -+ P_p mu.

    Args:
        frame: the frame, m nodes.
        s: (m, d) its nodes in coordinates of the contact plane.
        N: pair of (n_i, m) interpolation matrices.
        cells: pair of (n_i,) frame cell of each row; the stencils need N alone.
        forces: pair of (n_i,) forces of unit pressure [area].
        keep: pair of (n_i,) whether a row stays as it is; None: all may change.

    Returns:
        Pair of corrected (n_i, m) CSR matrices.

    Raises:
        ContactError: the stencils leave too little freedom; the message names the frame nodes.

    Three segments between sides of two and of three facets; forces are those of unit pressure:

    >>> frame = Frame([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]], [[0, 1], [1, 2], [2, 3]])
    >>> x = np.array([0.0, 1.5, 3.0]), np.array([0.0, 0.8, 2.0, 3.0])
    >>> forces = np.array([0.75, 1.5, 0.75]), np.array([0.4, 1.0, 1.1, 0.5])
    >>> at = [frame.locate(np.column_stack([s, 0.0 * s])) for s in x]
    >>> N = [frame.interpolation(a) for a in at]
    >>> (patch_residual(N, forces) * 1.5).round(3) + 0.0
    array([ 0.15, -0.05, -0.35,  0.25])
    >>> designed = design_weights(frame, frame.x[:, :1], N, [a.cell for a in at], forces)
    >>> bool(np.abs(patch_residual(designed, forces)).max() < 1e-13)
    True
    >>> (designed[0] @ frame.x[:, 0]).round(12)  # linear fields still pass
    array([0. , 1.5, 3. ])
    """
    s, rows, _, forces, keep = weight_arguments(frame, s, N, cells, forces, keep)
    far = np.abs(frame.x).max() / np.ptp(frame.x, axis=0).max()
    allowed = max(TOLERANCE, 50.0 * np.finfo(float).eps * far)  # rounding of far coordinates
    ring = adjacency(frame.cells, len(s))
    narrow = OUTER * ring + (1.0 - OUTER) * identity(len(s))
    best: Sequence[csr_matrix] = rows
    least = (np.inf, np.inf)
    for widths in _widths(s, rows):
        around = [reduce(matmul, [ring] * w) if w > 1 else narrow for w in widths]
        found = _corrected(s, rows, forces, keep, around)
        residual = np.abs(patch_residual(found, forces)).max()
        change = max(abs(M - L).max() for M, L in zip(found, rows, strict=True))
        # What passes with the smaller correction; else what is nearer to passing.
        rank = (max(residual, allowed), change if residual <= allowed else 0.0)
        if rank < least:
            best, least = found, rank
        if residual <= allowed and change <= NARROW:
            break
    residual = np.abs(patch_residual(best, forces))
    if not residual.max() <= allowed:
        worst = np.argsort(residual)[::-1][:5]
        raise ContactError(
            f"design by weights leaves a patch residual of {residual.max():.1e} of the largest "
            f"nodal force, above {allowed:.0e}, at the frame nodes {worst.tolist()} "
            f"(positions {frame.x[worst].round(6).tolist()}): the frame leaves too little freedom "
            "there. Give a coarser frame, or frame=None for a predicted one"
        )
    return best


def _widths(s: np.ndarray, N: Sequence[csr_matrix]) -> list[tuple[int, int]]:
    """Rings of nodes in the rows' stencils of both sides, in the order in which they are tried.

    A side whose facets are larger than the frame's cells presses on few of its nodes: its rows
    must spread their force over about a facet, which rings of one cell cannot.
    """
    ratio = [(len(s) / M.shape[0]) ** (1.0 / s.shape[1]) for M in N]
    coarse = tuple(int(np.clip(round(r), 1, RINGS)) for r in ratio)
    return list(dict.fromkeys([(1, 1), (coarse[0], coarse[1]), (2, 2)]))


def _corrected(
    s: np.ndarray,
    N: Sequence[csr_matrix],
    forces: Sequence[np.ndarray],
    keep: Sequence[np.ndarray] | None,
    around: Sequence[csr_matrix],
) -> Sequence[csr_matrix]:
    """Rows with the smallest corrections on the nodes ``around``, which bring (28) near zero.

    Raises:
        ContactError: the equations of the corrections are singular.
    """
    stencils = [flat_stencils(row_weights(M, A), s) for M, A in zip(N, around, strict=True)]
    scale = max(f.max() for f in forces)
    free = [np.ones(M.shape[0]) if keep is None else 1.0 - k for M, k in zip(N, keep or N)]
    loads = [f * k / scale for f, k in zip(forces, free, strict=True)]
    A = _equations(stencils, loads, len(s))
    parts = _affine_functions(A, s)
    factor = _factor(A + _pins(A, parts))
    delta, designed, last = [np.zeros(len(st.nodes)) for st in stencils], N, np.inf
    for _ in range(6):  # the first solve, then refinement against rounding
        residual = patch_residual(designed, forces)
        if not 0.01 * TOLERANCE < np.abs(residual).max() < 0.5 * last:
            break
        last = np.abs(residual).max()
        mu = factor.solve(_without_affine(residual, parts))
        # Summed as corrections, not as multipliers: what rounding leaves the next round sees.
        for d, st, sign, k in zip(delta, stencils, (-1.0, 1.0), free, strict=True):
            d += sign * spread(k, st.indptr) * st.project(mu[st.nodes])
        designed = [M + st.matrix(d, len(s)) for M, d, st in zip(N, delta, stencils, strict=True)]
    return designed


def _equations(stencils: Sequence[RowStencils], loads: Sequence[np.ndarray], m: int) -> csr_matrix:
    """(m, m) sum_p f_p P_p, by which the multipliers mu change the residual."""
    diagonal, rows = np.zeros(m), []
    for st, f in zip(stencils, loads, strict=True):
        load = spread(f, st.indptr)
        diagonal += np.bincount(st.nodes, load * st.root**2, m)
        rows += [st.matrix(np.sqrt(load) * st.root * q, m) for q in st.Q.T]
    B = vstack(rows, format="csr")
    return (diags(diagonal) - B.T @ B).tocsr()


def _factor(A: Any) -> Any:
    """Factors of the equations.

    Raises:
        ContactError: they are singular: rows that may be corrected are missing.
    """
    try:
        return splu(A.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    except RuntimeError as error:  # SuperLU's "exactly singular"
        raise ContactError(
            "design by weights: the rows that may be corrected cannot balance the frame "
            f"(SuperLU: {error}). Give a coarser frame, or frame=None for a predicted one"
        ) from None


def _affine_functions(A: csr_matrix, s: np.ndarray) -> _Parts:
    """Orthonormal affine functions, which A cannot see, on each connected part of the frame.

    Returns:
        List of (nodes, functions (n, <= d + 1)) per part.
    """
    seen = abs(A) > 1e-14 * max(A.diagonal().max(), 1e-300)
    _, part = connected_components(seen, directed=False)
    order = np.argsort(part, kind="stable")
    parts = []
    for nodes in np.split(order, np.flatnonzero(np.diff(part[order])) + 1):
        local = np.column_stack([np.ones(len(nodes)), s[nodes] - s[nodes].mean(axis=0)])
        U, size, _ = np.linalg.svd(local / np.linalg.norm(local), full_matrices=False)
        parts.append((nodes, U[:, size > 1e-10]))
    return parts


def _without_affine(r: np.ndarray, parts: _Parts) -> np.ndarray:
    """r less its affine parts: they are rounding (both sides carry the same force with the same
    centroid), and no correction of the rows can remove them."""
    r = r.copy()
    for nodes, U in parts:
        r[nodes] -= U @ (U.T @ r[nodes])
    return r


def _pins(A: csr_matrix, parts: _Parts) -> Any:
    """Diagonal that fixes the affine functions on each part, at the nodes that hold them best.

    The right-hand side is free of them, so pinning changes no equation. SHIFT is for what else A
    cannot see, as where rows that are kept leave strips of stencils; refinement makes up for it.
    """
    diagonal = A.diagonal()
    largest = diagonal.max()
    if not largest > 0.0:  # no row may be corrected
        return diags(np.ones(len(diagonal)))
    pins = np.where(diagonal <= 1e-14 * largest, largest, SHIFT * largest)
    for nodes, U in parts:
        rest = U.copy()
        for _ in range(U.shape[1]):
            size = np.einsum("ni,ni->n", rest, rest)
            best = int(size.argmax())
            pins[nodes[best]] = largest
            rest = rest - np.outer(rest @ rest[best], rest[best]) / size[best]
    return diags(pins)
