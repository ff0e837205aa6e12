"""Design of a frame: make a constant pressure pass exactly (paper, section 5, (28)).

The residual of a frame is, per frame node, the force that arrives from side 0 less the one from
side 1 when both sides carry the same pressure. ``design_weights`` brings it to zero by the smallest
change of the rows of L_b, ``positions.design_positions`` by moving the frame's nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.design.arguments import weight_arguments
from dolfinx_llm.geometry.frame import Frame

TOLERANCE = 1e-13  # a frame with max|r| / max f below this passes


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

    Minimises sum_p f_p |delta_p|^2 over corrections delta_p on the cell of p and the cells around
    it, subject to sum_J delta_pJ = 0 and sum_J delta_pJ Y_J = 0 (rigid motions and linear fields
    still pass exactly) and to (28). With one multiplier mu_J per frame node the solution is
    delta_p = -+ P_e mu_e: P_e projects onto what is orthogonal to 1 and Y on the stencil of cell e.

    Args:
        frame: the frame, m nodes.
        s: (m, d) its nodes in coordinates of the contact plane.
        N: pair of (n_i, m) interpolation matrices.
        cells: pair of (n_i,) frame cells of the rows.
        forces: pair of (n_i,) forces of unit pressure [area].
        keep: pair of (n_i,) whether a row stays as it is; None: all may change.

    Returns:
        Pair of corrected (n_i, m) CSR matrices.

    Raises:
        ContactInputError: an argument of another type, shape or size.
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
    s, N, cells, forces, keep = weight_arguments(frame, s, N, cells, forces, keep)
    nodes, mask, P = _stencils(frame.cells, s)
    scale = max(f.max() for f in forces)
    change = [np.ones(len(c)) if keep is None else 1.0 - k for c, k in zip(cells, keep or cells)]
    weights = [
        np.bincount(c, f * free / scale, minlength=len(nodes))
        for c, f, free in zip(cells, forces, change, strict=True)
    ]
    weight = weights[0] + weights[1]
    m = len(s)
    rows = np.broadcast_to(nodes[:, :, None], P.shape)
    cols = np.broadcast_to(nodes[:, None, :], P.shape)
    A = csr_matrix(((weight[:, None, None] * P).ravel(), (rows.ravel(), cols.ravel())), (m, m))
    parts = _affine_functions(A, s)
    factor = splu(
        (A + _pins(A, parts)).tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        options={"SymmetricMode": True},
    )
    delta = np.zeros(nodes.shape)
    designed = N
    for _ in range(5):  # the first solve, then refinement against rounding
        residual = patch_residual(designed, forces)
        if np.abs(residual).max() <= 0.01 * TOLERANCE:
            break
        mu = factor.solve(_without_affine(residual, parts))
        # P takes away nearly all of a large smooth mu. Applied twice, the rounding that this
        # leaves keeps the rows' constraints; summed as corrections, the next round sees it.
        step = np.einsum("est,et->es", P, np.where(mask, mu[nodes], 0.0))
        delta += np.einsum("est,et->es", P, step)
        designed = [
            M - sign * stencil_rows(delta[c] * free[:, None], nodes[c], mask[c], m)
            for M, c, sign, free in zip(N, cells, (1.0, -1.0), change, strict=True)
        ]
    residual = np.abs(patch_residual(designed, forces))
    far = np.abs(frame.x).max() / np.ptp(frame.x, axis=0).max()
    allowed = max(TOLERANCE, 50.0 * np.finfo(float).eps * far)  # rounding of far coordinates
    if not residual.max() <= allowed:
        worst = np.argsort(residual)[::-1][:5]
        raise ContactError(
            f"design by weights leaves a patch residual of {residual.max():.1e} of the largest "
            f"nodal force, above {allowed:.0e}, at the frame nodes {worst.tolist()} "
            f"(positions {frame.x[worst].round(6).tolist()}): the frame leaves too little freedom "
            "there. Give a coarser frame, or frame=None for a predicted one"
        )
    return designed


def nodes_around(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of every cell and of the cells around it.

    Returns:
        nodes (n_cells, w), padded with node 0; mask (n_cells, w).
    """
    n, k = cells.shape
    incidence = csr_matrix((np.ones(n * k), (np.repeat(np.arange(n), k), cells.ravel())))
    around = (incidence @ incidence.T @ incidence).tocsr()
    around.sort_indices()
    width = np.diff(around.indptr)
    mask = np.arange(width.max()) < width[:, None]
    nodes = np.zeros(mask.shape, dtype=np.int64)
    nodes[mask] = around.indices
    return nodes, mask


def _stencils(cells: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stencil of every cell (its nodes and those of the cells around it) and its projector.

    Returns:
        nodes (n_cells, w), padded with node 0; mask (n_cells, w); P (n_cells, w, w).
    """
    nodes, mask = nodes_around(cells)
    local = s[nodes] - s[cells].mean(axis=1)[:, None, :]
    local /= np.abs(np.where(mask[..., None], local, 0.0)).max(axis=(1, 2))[:, None, None]
    C = np.concatenate([np.ones((*mask.shape, 1)), local], axis=2) * mask[..., None]
    # Orthonormal columns: then the projector is symmetric and idempotent to rounding.
    Q, R = np.linalg.qr(C)
    keep = np.abs(np.diagonal(R, axis1=1, axis2=2)) > 1e-10
    Q = Q * keep[:, None, :]
    P = np.eye(mask.shape[1]) * mask[:, None, :] - Q @ np.swapaxes(Q, 1, 2)
    return nodes, mask, P


def _affine_functions(A: csr_matrix, s: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Orthonormal affine functions, which A cannot see, on each connected part of the frame.

    Returns:
        List of (nodes, functions (n, <= d + 1)) per part.
    """
    _, part = connected_components(A, directed=False)
    order = np.argsort(part, kind="stable")
    parts = []
    for nodes in np.split(order, np.flatnonzero(np.diff(part[order])) + 1):
        local = np.column_stack([np.ones(len(nodes)), s[nodes] - s[nodes].mean(axis=0)])
        U, size, _ = np.linalg.svd(local / np.linalg.norm(local), full_matrices=False)
        parts.append((nodes, U[:, size > 1e-10]))
    return parts


def _without_affine(r: np.ndarray, parts: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """r less its affine parts: they are rounding (both sides carry the same force with the same
    centroid), and no correction of the rows can remove them."""
    r = r.copy()
    for nodes, U in parts:
        r[nodes] -= U @ (U.T @ r[nodes])
    return r


def _pins(A: csr_matrix, parts: Sequence[tuple[np.ndarray, np.ndarray]]) -> Any:
    """Diagonal that fixes the affine functions on each part, at the nodes that hold them best.

    The right-hand side is free of them, so pinning changes no equation.
    """
    diagonal = A.diagonal()
    pins = np.where(diagonal <= 1e-14 * diagonal.max(), 1.0, 0.0)
    for nodes, U in parts:
        rest = U.copy()
        for _ in range(U.shape[1]):
            size = np.einsum("ni,ni->n", rest, rest)
            best = int(size.argmax())
            pins[nodes[best]] = diagonal.max()
            rest = rest - np.outer(rest @ rest[best], rest[best]) / size[best]
    return diags(pins)


def stencil_rows(values: np.ndarray, nodes: np.ndarray, mask: np.ndarray, m: int) -> csr_matrix:
    """Rows of stencil values as a sparse matrix with m columns."""
    indptr = np.concatenate([[0], np.cumsum(mask.sum(axis=1))])
    return csr_matrix((values[mask], nodes[mask], indptr), shape=(len(values), m))
