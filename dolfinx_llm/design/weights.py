"""Design of a frame: make a constant pressure pass exactly (paper, section 5, (28)).

The residual of a frame is, per frame node, the force that arrives from side 0 less the one from
side 1 when both sides carry the same pressure. ``design_weights`` brings it to zero by the smallest
change of the rows of L_b, ``positions.design_positions`` by moving the frame's nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import matmul

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.design.arguments import weight_arguments
from dolfinx_llm.design.residual import (
    Corrections,
    FrameLoads,
    compatible,
    factor,
    pins,
    without_compatible,
)
from dolfinx_llm.design.residual import patch_residual as patch_residual
from dolfinx_llm.design.stencils import adjacency, flat_stencils, inner_part
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.loads import NodalLoads

TOLERANCE = 1e-13  # a frame with max|r| / max f below this passes
LACKING = 1e-11  # ... above it lacks freedom; what is below is rounding, of slivers of facets
NARROW = 0.15  # largest correction up to which stencils of one ring of nodes are enough
NARROW_LINE = 0.4  # ... along lines of second order: with two, tractions are off by up to 4 times
OUTER = 0.01  # weight of that ring: corrections far from a row's own nodes cost accuracy
# Of refinement, for first and second order: rounds, and what each must leave at most.
ROUNDS_MOST, SLOWER = (6, 40), (0.5, 0.98)
RISES = 4  # rounds that leave more, by rounding, before what does not pass yet is given up
RINGS = 4  # rings in the stencils of a side much coarser than the frame
FARTHEST_RING = 8  # ... of one that is much coarser in one direction
# Correction up to which rings by the number of nodes alone do, and those that are as few as may be.
TOO_LARGE, FAIR = 0.35, 0.25
LOADED = 1e-9  # force of a frame node over the largest, from which on it is to balance


def design_weights(
    frame: Frame,
    s: Array,
    N: Sequence[csr_matrix],
    cells: Sequence[Array],
    forces: Sequence[Array],
    keep: Sequence[Array] | None = None,
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
    >>> (designed[0] @ frame.x[:, 0]).round(12) + 0.0  # linear fields still pass
    array([0. , 1.5, 3. ])
    """
    s, rows, _, forces, keep = weight_arguments(frame, s, N, cells, forces, keep)
    loads = [NodalLoads.of_forces(f) for f in forces]
    return balanced_rows(frame, FrameLoads.of(frame, s, rows, loads), rows, keep)[0]


def balanced_rows(
    frame: Frame, loading: FrameLoads, N: Sequence[csr_matrix], keep: Sequence[Array] | None
) -> tuple[Sequence[csr_matrix], float, float]:
    """``design_weights`` for loads of either order; the largest residual and change of an entry.

    With moments, pressures linear along the surface pass as well, of 9-node facets those of degree
    2, and rows reproduce polynomials of degree 2. Per frame node there are then multipliers for the
    force, and for the moments about it: delta_p = -+ P_p sum_a (c_pa mu_a) / w_p,
    c_p = (f_p, (m_p + (s_p - s_J) f_p) / h), w_p the area that the row stands for, since f_p may
    vanish.
    """
    far = np.abs(frame.x).max() / np.ptp(frame.x, axis=0).max()
    allowed = max(TOLERANCE, 50.0 * np.finfo(float).eps * far)  # rounding of far coordinates
    ring = adjacency(frame.cells, len(loading.s))
    plain, rank = loading.residual(N), (np.inf, np.inf)
    enough = NARROW_LINE if loading.count > 1 and loading.s.shape[1] == 1 else NARROW
    best: tuple[Sequence[csr_matrix], Array, float] = N, plain, 0.0
    widths = widths_of(loading.s, N)
    wider = wider_than(rings_across(frame, loading, N))
    for at, rings in enumerate([*widths, *wider]):
        fair = TOO_LARGE if at == len(widths) else FAIR
        if at >= len(widths) and rank[0] <= allowed and rank[1] <= fair:
            break
        weights = [
            row_stencil_weights(M, ring, frame, width) for M, width in zip(N, rings, strict=True)
        ]
        found, left, change = _corrected(loading, N, plain, keep, weights)
        most = float(np.abs(left).max())
        # What passes with the smaller correction; else what is nearer to passing.
        new = max(most, allowed), change if most <= allowed else 0.0
        if new < rank:
            rank, best = new, (found, left, change)
        if most <= allowed and change <= enough:
            break
    found, left, change = best
    residual = np.abs(left).max(axis=1)
    most = float(residual.max())
    allowed = max(allowed, LACKING)
    if not most <= allowed:
        worst = np.argsort(residual)[::-1][:5]
        raise ContactError(
            f"design by weights leaves a patch residual of {most:.1e} of the largest "
            f"nodal force, above {allowed:.0e}, at the frame nodes {worst.tolist()} "
            f"(positions {checks.place(frame.x[worst])}): the frame leaves too little freedom "
            "there. Give a coarser frame, or frame=None for a predicted one"
        )
    return found, most, change


def widths_of(s: Array, N: Sequence[csr_matrix]) -> list[tuple[int, int]]:
    """Rings of nodes in the rows' stencils of both sides, in the order in which they are tried.

    A side whose facets are larger than the frame's cells presses on few of its nodes: its rows
    must spread their force over about a facet, which rings of one cell cannot.
    """
    ratio = [(len(s) / M.shape[0]) ** (1.0 / s.shape[1]) for M in N]
    coarse = tuple(int(np.clip(round(r), 1, RINGS)) for r in ratio)
    return list(dict.fromkeys([(1, 1), (coarse[0], coarse[1]), (2, 2)]))


def wider_than(across: int) -> list[tuple[int, int]]:
    """The same where facets are larger in one direction alone, of ``rings_across``, for corrections
    that are ``TOO_LARGE`` with fewer: rows see hardly anything of motions that bodies then have."""
    return [(across + k, across + k) for k in (1, 2) if across > 0]


def rings_across(frame: Frame, loading: FrameLoads, N: Sequence[csr_matrix]) -> int:
    """Rings of the frame's nodes from those that a side's rows (n_i, m) press on to all that are
    loaded, of either side the most: 0 where the frame is as coarse as both in every direction."""
    parts, m = frame.element.parts, len(loading.s)
    next_to = adjacency(frame.cells[:, parts].reshape(-1, parts.shape[1]), m)
    forces = [load.forces for load in loading.loads]
    borne = np.max([abs(M.T @ f) for M, f in zip(N, forces, strict=True)], axis=0)
    loaded, most = borne > LOADED * borne.max(), 0
    for M, f in zip(N, forces, strict=True):
        reached = np.asarray(abs(inner_part(M)).T @ (f > 0.0)) > 0.0
        count = 0
        while count < FARTHEST_RING and not (reached | ~loaded).all():
            reached = np.asarray(next_to @ reached.astype(float)) > 0.0
            count += 1
        most = max(most, count)
    return most


def row_stencil_weights(N: csr_matrix, ring: csr_matrix, frame: Frame, width: int) -> csr_matrix:
    """(n, m) weights of a row's stencil: the nodes of the cells around its own corners."""
    own = inner_part(N)
    corners = own if frame.element.order == 1 else inner_part((N @ _to_corners(frame)).tocsr())
    if width > 1:
        return (corners @ reduce(matmul, [ring] * width)).tocsr()
    if corners is own:  # both at once
        row = np.repeat(np.arange(ring.shape[0]), np.diff(ring.indptr))
        value = np.where(ring.indices == row, 1.0, OUTER)
        return (own @ csr_matrix((value, ring.indices, ring.indptr), ring.shape)).tocsr()
    return (OUTER * (corners @ ring) + (1.0 - OUTER) * own).tocsr()


def _to_corners(frame: Frame) -> csr_matrix:
    """(m, m) shape functions of the corners alone, at all nodes."""
    nodes, first = np.unique(frame.cells, return_index=True)
    cell, place = np.divmod(first, frame.cells.shape[1])
    value = frame.element.linear[place]
    row = np.repeat(nodes, value.shape[1])
    index = row, frame.corners[cell].ravel()
    return csr_matrix((value.ravel(), index), (len(frame.x), len(frame.x)))


def _corrected(
    loading: FrameLoads,
    N: Sequence[csr_matrix],
    plain: Array,
    keep: Sequence[Array] | None,
    weights: Sequence[csr_matrix],
) -> tuple[Sequence[csr_matrix], Array, float]:
    """Rows with the smallest corrections of these weights, which bring (28), ``plain`` without any,
    near zero, what they leave of it, and the largest of them.

    Raises:
        ContactError: the equations of the corrections are singular.
    """
    s, m, high = loading.s, len(loading.s), loading.count > 1
    found = [flat_stencils(W, s, M, 1 + high) for W, M in zip(weights, N, strict=True)]
    stencils = [f.rows for f in found]
    free = [np.ones(M.shape[0]) if keep is None else 1.0 - k for M, k in zip(N, keep or N)]
    corrections = Corrections.of(loading, stencils, free)
    A = corrections.equations
    parts = compatible(A, s, loading)
    solve = factor(A + pins(A, parts)).solve
    delta = best = [f.missing for f in found]
    seen: list[tuple[Array, list[Array]]] = []  # what steps take away, orthonormal

    def of(delta: Sequence[Array]) -> Array:
        """What corrections change of the residual."""
        entries = zip(stencils, delta, strict=True)
        return loading.summed([(st.indptr, st.nodes, d) for st, d in entries])

    residual, least = plain + of(delta), np.inf
    stalled, passes = 0, False
    for done in range(ROUNDS_MOST[high] + 1):  # the first solve, then refinement against rounding
        left, most = float(np.linalg.norm(residual)), np.abs(residual).max()
        stalled = 0 if left < SLOWER[high] * least else stalled + 1
        if left < least:
            least, best, passes = left, delta, most <= TOLERANCE
        if done == ROUNDS_MOST[high] or most <= 0.01 * TOLERANCE:
            break
        if stalled > (0 if passes else RISES):
            break
        mu = solve(without_compatible(residual.ravel(), parts)).reshape(m, -1)
        # Summed as corrections, not as multipliers: what rounding leaves the next round sees.
        step = corrections.under(mu)
        if high:
            taken = -of(step)
            # Smooth multipliers, which the factor hardly knows, by least squares.
            for other, its in seen * 2:
                part = float(np.vdot(other, taken))
                taken, step = taken - part * other, [a - part * b for a, b in zip(step, its)]
            size = np.linalg.norm(taken)
            if not size > 0.0:
                break
            taken, step = taken / size, [d / size for d in step]
            seen.append((taken, step))
            share = float(np.vdot(taken, residual))
            step = [share * d for d in step]
        delta = [a + b for a, b in zip(delta, step, strict=True)]
        residual = plain + of(delta)
    designed = [M + st.matrix(d, m) for M, d, st in zip(N, best, stencils, strict=True)]
    return designed, loading.residual(designed), max(float(np.abs(d).max()) for d in best)
