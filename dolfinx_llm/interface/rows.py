"""Rows of L_b that balance, flat or curved, and what can be said of them before any solve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.log import warn_of
from dolfinx_llm.design.balance import balance
from dolfinx_llm.design.bent import bent_normals, bent_rows, from_smooth
from dolfinx_llm.design.curved import (
    AT_OUTLINE,
    loads_along_normals,
    nodal_normals,
    smooth_rows,
    vector_residual,
    with_mean_normals,
)
from dolfinx_llm.design.line import check_closed_form
from dolfinx_llm.design.outline import at_outline
from dolfinx_llm.design.quadric import SmoothSurface
from dolfinx_llm.design.residual import FrameLoads
from dolfinx_llm.design.weights import TOLERANCE, balanced_rows, rings_across
from dolfinx_llm.geometry.cells import outline_edges, unit_normals
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.overlap_flat import Plane
from dolfinx_llm.geometry.pairs import ContactPairs, rank_certificate, with_weights
from dolfinx_llm.interface.choices import Interface
from dolfinx_llm.interface.join import Certificate, Part

BALANCES = 1.0 / 3.0  # of the residual of coarse surfaces: rows that leave more are worse than none
COARSE = 0.1  # vector residual of curved surfaces, from which on it is said
FAR_FINER = 2  # rings of frame nodes between a side's rows, 4 times as fine: from there it is said
SHARES = (1.0, 0.5, 0.0)  # of the way to the places on the smooth surface that rows are tried with
UNITY = 1e-9  # by which the sum of a row may differ from 1


def balanced(
    interface: Interface,
    frame: Frame,
    pairs: list[ContactPairs],
    vectors: Sequence[Array],
    notes: list[str],
    designs: bool = True,
) -> tuple[list[ContactPairs], Certificate, Array]:
    """Pairs of curved surfaces after design, their certificate, and normals at the frame's nodes.

    Args:
        vectors: pair of (n_surface, gdim) vector areas in contact [area].
        designs: False: supports bear what does not balance, rows stay on the cells.
    """
    close_gap = interface.law.closes_gap
    vectors = [a[p.nodes] for a, p in zip(vectors, pairs, strict=True)]
    plain = [p.N for p in pairs]
    normals, place = nodal_normals(frame), 0.0
    along = interface.law.components == "normal"
    before = after = _residual(plain, vectors, normals, along)
    if interface.design is not None:
        if designs:
            pairs, surface = _least_residual(frame, pairs, vectors, before, close_gap, along, notes)
        else:
            smooth = smooth_rows(frame, pairs, close_gap, along)
            both = zip(smooth.pairs, smooth.start, strict=True)
            pairs, surface = [replace(p, N=M) for p, M in both], smooth.surface
        found, place = (
            _residual([p.N for p in pairs], vectors, surface.normals, along),
            surface.error,
        )
        if not along or found.max() <= before.max():
            normals, after = surface.normals, found
    N = [p.N for p in pairs]
    pairs = with_mean_normals(pairs, normals)
    size = max(p.surface.diameter for p in pairs)
    certificate = Certificate(
        float(after.max()),
        float(before.max()),
        rank_certificate(frame, N),
        float(max(np.abs(p.x - M @ frame.x).max() for p, M in zip(pairs, N, strict=True)) / size),
        float(max(np.abs(a - b).max() for a, b in zip(N, plain, strict=True))),
        place,
    )
    notes.append(
        f"curved: {'areas along normals' if along else 'vector areas'}, in least squares; "
        f"root mean square of the patch residual "
        f"{np.sqrt(np.mean(after**2)):.1e} (before design {np.sqrt(np.mean(before**2)):.1e})"
    )
    if close_gap:
        notes.append(f"the smooth surface that gaps are counted from is known to about {place:.1e}")
    return pairs, certificate, normals


def bent_pairs(
    interface: Interface,
    frame: Frame,
    pairs: list[ContactPairs],
    vectors: Sequence[Array],
    notes: list[str],
    keep: Sequence[Array] | None,
    designs: bool = True,
) -> tuple[list[ContactPairs], Certificate, Array]:
    """As ``balanced`` between second-order bodies tied along curved surfaces, on a frame that is
    bent as they are; ``keep`` as of ``kept_nodes``."""
    if frame.gdim == 2:  # ends over ends: nodes there would be held by what lies beyond
        edges, cells = outline_edges(frame.corners), unit_normals(frame.x, frame.corners)
        over = [at_outline(frame, p, edges, cells, AT_OUTLINE).N for p in pairs]
        pairs = [with_weights(p, M, frame) for p, M in zip(pairs, over, strict=True)]
    normals, plain = bent_normals(frame), [p.N for p in pairs]
    vectors = [a[p.nodes] for a, p in zip(vectors, pairs, strict=True)]
    before = _residual(plain, vectors, normals, False)
    if interface.design is not None and designs:
        N = bent_rows(frame, pairs, normals, keep)
        pairs = [with_weights(p, M, frame) for p, M in zip(pairs, N, strict=True)]
        notes.append("design: rows of L_b corrected (weights), in tangent planes")
    N = [p.N for p in pairs]
    after = _residual(N, vectors, normals, False)
    pairs = [from_smooth(frame, p, normals) for p in with_mean_normals(pairs, normals)]
    across = [np.einsum("ni,ni->n", p.gap, p.normal) for p in pairs]
    size = max(p.surface.diameter for p in pairs)
    along = [p.gap - a[:, None] * p.normal for a, p in zip(across, pairs, strict=True)]
    certificate = Certificate(
        float(after.max()),
        float(before.max()),
        rank_certificate(frame, N),
        float(max(np.abs(a).max() for a in along) / size),
        float(max(np.abs(a - b).max() for a, b in zip(N, plain, strict=True))),
    )
    return pairs, certificate, normals


def say_left(interface: Interface, part: Part, notes: list[str]) -> None:
    """Say what a curved frame leaves: a large patch residual, and gaps of bodies that are tied."""
    if (residual := part.certificate.residual) > COARSE:
        text = (
            f"curved surfaces are coarse: patch residual {residual:.2g} of the largest nodal "
            f"area, above {COARSE:g}; stresses next to the interface are off by about as much. "
            "Refine both meshes along it"
        )
        warn_of(interface.name, text, notes)
    if not interface.law.opens:
        gap = max(np.abs(np.einsum("ni,ni->n", p.gap, p.normal)).max() for p in part.pairs)
        kept = "is kept, tied as drawn without stress"
        closed = "is closed" if interface.law.closes_gap else kept
        notes.append(f"initial gap or overlap up to {gap:.3g} {closed}")


def _residual(
    N: Sequence[csr_matrix], vectors: Sequence[Array], normals: Array, along: bool
) -> Array:
    """(m,) what a constant pressure leaves at the frame's nodes of the largest nodal force; of
    what acts ``along`` normals alone, if that is all."""
    loads = loads_along_normals(N, vectors, normals) if along else vectors
    return np.linalg.norm(vector_residual(N, loads), axis=1)


def _least_residual(
    frame: Frame,
    pairs: list[ContactPairs],
    vectors: Sequence[Array],
    before: Array,
    close_gap: bool,
    along: bool,
    notes: list[str],
) -> tuple[list[ContactPairs], SmoothSurface]:
    """Pairs with the rows that reproduce the most of the places and balance, and the surface.

    On coarse meshes the bodies enclose other volumes, and rows that reproduce all places cannot
    balance: there they go a part of the way (SHARES), the most that halves the vector residual
    that is printed, else what leaves the least of it, in its largest value and in its norm. Where
    more stays of it than coarse meshes leave, as at the flanks of a roller, which face what they
    never touch, corrections would reach rows in contact: they stay as they are. Where the gap is
    closed it is that between the smooth surfaces, whatever the rows.
    """
    best, least = [p.N for p in pairs], before
    smooth = smooth_rows(frame, pairs, close_gap, along)
    normals, taken, weight = smooth.surface.normals, 0.0, _areas(pairs, vectors)
    for share in SHARES:
        N = smooth.rows(share)
        loads = loads_along_normals(N, vectors, normals) if along else vectors
        N = balance(N, loads, smooth.stencils, weight=weight)
        after = _residual(N, vectors, normals, along)
        unity = max(float(np.abs(M.sum(axis=1) - 1.0).max()) for M in N)
        lower = after.max() < least.max() and np.linalg.norm(after) < np.linalg.norm(before)
        if lower and unity <= UNITY:
            best, least, taken = N, after, share
        if least.max() <= 0.5 * before.max():
            break
    if least.max() > max(BALANCES * before.max(), COARSE):
        best, least = [p.N for p in pairs], before
    if least is before:
        notes.append(f"design: left out, no rows balance: patch residual of {before.max():.1e}")
    elif taken < 1.0:
        notes.append(
            f"design: rows go {taken:.0%} of the way from the cells to the smooth surface; with "
            "finer meshes of the curved surfaces all of it"
        )
    if least is before and not close_gap:
        return pairs, smooth.surface
    return [replace(p, N=M) for p, M in zip(smooth.pairs, best, strict=True)], smooth.surface


def _areas(pairs: Sequence[ContactPairs], vectors: Sequence[Array]) -> Array | None:
    """(m,) of a frame's nodes, of the largest, in proportion to which what balances nowhere is
    left; None where there is no thickness, by which they differ."""
    if all(p.surface.thickness is None for p in pairs):
        return None
    both = zip(pairs, vectors, strict=True)
    areas = sum(p.N.maximum(0.0).T @ np.linalg.norm(a, axis=1) for p, a in both)
    return np.asarray(areas / areas.max())


def designed(
    interface: Interface,
    frame: Frame,
    plane: Plane,
    pairs: list[ContactPairs],
    notes: list[str],
    keep: Sequence[Array] | None,
    designs: bool = True,
) -> tuple[list[ContactPairs], Certificate]:
    """Pairs after design by weights where it is asked for or needed, and their certificate."""
    N: Sequence[csr_matrix] = [p.N for p in pairs]
    loading = FrameLoads.of(frame, plane.project(frame.x), N, [p.loads for p in pairs])
    before = residual = float(np.abs(loading.residual(N)).max())
    change = 0.0
    if not designs:
        notes.append("design: left out, supports bear what does not balance")
    elif interface.design == "weights" or (interface.design == "auto" and before > TOLERANCE):
        _say_long(interface, rings_across(frame, loading, N), notes)
        N, residual, change = _balanced(frame, loading, N, keep)
        pairs = [with_weights(p, M, frame) for p, M in zip(pairs, N)]
        notes.append("design: rows of L_b corrected (weights)")
    elif interface.design == "auto":
        notes.append("design: left out, the frame passes as it is")
    elif interface.design is None:
        notes.append(f"design: none, as asked; patch residual {before:.1e}")
    if interface.design == "positions" and frame.gdim == 2:
        check_closed_form(residual, pairs, frame)
    singular = rank_certificate(frame, N)
    size = max(p.surface.diameter for p in pairs)
    linear = max(np.abs(plane.project(p.x) - plane.project(p.x - p.gap)).max() for p in pairs)
    return pairs, Certificate(residual, before, singular, float(linear / size), change)


def _say_long(interface: Interface, rings: int, notes: list[str]) -> None:
    """Say of a frame that is far finer than a side, perhaps in one direction alone."""
    if rings < FAR_FINER:
        return
    text = (
        f"the frame is some {2 * rings} times as fine as one of the sides, perhaps in one "
        "direction alone, as where cells are long across those of the other side: contact is as "
        "coarse there. Take cells of like shape on both sides, at most three times as long as wide"
    )
    warn_of(interface.name, text, notes)


def _balanced(
    frame: Frame, loading: FrameLoads, plain: Sequence[csr_matrix], keep: Sequence[Array] | None
) -> tuple[Sequence[csr_matrix], float, float]:
    """``balanced_rows`` through which loads pass: those of degree 2 only if they can. Rows at
    supports bind the frame's edge: better left alone, where that is enough."""
    tries = [(loading, keep)] if keep is None else [(loading, keep), (loading, None)]
    if loading.square:
        linear = replace(loading, loads=[load.linear() for load in loading.loads])
        tries += [(linear, stay) for _, stay in tries]
    for of, stay in tries[:-1]:
        try:
            return balanced_rows(frame, of, plain, stay)
        except ContactError:
            pass
    of, stay = tries[-1]
    return balanced_rows(frame, of, plain, stay)
