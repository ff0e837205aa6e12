"""Rows of L_b on curved frames that reproduce places on the smooth surface.

A frame of flat cells lies below the surface that its nodes are taken from by about h² / 8R. Rows
that interpolate on the cells alone would tie bodies across these chordal gaps: a rigid rotation
would strain them, and a closed gap would be wrong by as much. So each row is corrected on the
nodes around its own, by the smallest change that reproduces the place of its node in space.
``balance`` then corrects all rows so that the vector areas of both sides cancel (design, 5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.design.outline import Clamped, at_outline, outline_weights
from dolfinx_llm.design.quadric import SmoothSurface
from dolfinx_llm.design.stencils import (
    FADE,
    RowStencils,
    adjacency,
    curved_stencils,
    spread,
)
from dolfinx_llm.geometry.cells import areas_around, cross_plane, outline_edges, unit, unit_normals
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.pairs import ContactPairs

LARGEST = 0.3  # correction of an entry of L_b by geometry; larger ones are faded, or left out
AT_OUTLINE = 0.2  # cells: how near to the frame's outline a node of a side's outline belongs to it
FADES = (FADE, 1e-3, 1e-2, 1e-1)  # of ``curved_stencils``, until the correction is small enough


@dataclass(frozen=True, eq=False)
class SmoothRows:
    """Both sides on the smooth surface: geometry, and what corrects rows towards it."""

    pairs: list[ContactPairs]  # with gaps to it along its normals, rows of share 1
    stencils: list[RowStencils]  # what the rows of each side may be corrected on
    start: list[csr_matrix]  # (n, m) rows on the cells
    move: list[csr_matrix]  # (n, m) corrections to the places on the smooth surface
    surface: SmoothSurface  # through the frame's nodes

    def rows(self, share: float) -> list[csr_matrix]:
        """Rows that go a share of the way from the cells to the smooth surface."""
        return [N + share * D for N, D in zip(self.start, self.move, strict=True)]


def smooth_rows(
    frame: Frame,
    pairs: Sequence[ContactPairs],
    close_gap: bool,
    along_normals: bool = False,
    near: float = AT_OUTLINE,
) -> SmoothRows:
    """Rows of both sides that reproduce places on the smooth surface, and their stencils.

    Args:
        frame: the frame.
        pairs: both sides, as located on the frame's cells.
        close_gap: False: rows reproduce the nodes' own places where a small correction can (then
            linear fields and rotations pass exactly); True: the places below them on the surface
            through the frame's nodes, so that what remains is the gap.
        along_normals: forces act along normals alone: then rows, and corrections on the stencils,
            also keep moments.
        near: how near nodes of a side's outline lie to the frame's that are bound to it, in cells:
            what such rows miss along the surface is a part of the gap.
    """
    surface = SmoothSurface.through(frame)
    ring = adjacency(frame.cells, len(frame.x))
    edges = outline_edges(frame.cells)
    normals, sides = unit_normals(frame.x, frame.cells), []
    for p in pairs:
        clamped = at_outline(frame, p, edges, normals, near)
        W = outline_weights(frame, clamped, edges, normals, ring)
        sides.append(_smooth_side(frame, surface, p, clamped, W, close_gap, along_normals))
    out, stencils, start, move = (list(parts) for parts in zip(*sides, strict=True))
    return SmoothRows(out, stencils, start, move, surface)


def _smooth_side(
    frame: Frame,
    surface: SmoothSurface,
    pairs: ContactPairs,
    clamped: Clamped,
    W: csr_matrix,
    close_gap: bool,
    along_normals: bool,
) -> tuple[ContactPairs, RowStencils, csr_matrix, csr_matrix]:
    """A side on the smooth surface: pairs, stencils, rows and what moves them there."""
    place = clamped.N @ frame.x
    point, normal = surface.at(clamped.N, pairs.x)
    # Along the normal: what a row at the outline misses across it would be closed with the gap.
    above = np.einsum("ni,ni->n", pairs.x - point, normal)[:, None] * normal
    target = pairs.x - above if close_gap else pairs.x
    stencils, move = _corrections(W, frame.x[W.indices] - spread(place, W.indptr), target - place)
    start, N = clamped.N, clamped.N + move
    gap = pairs.x - N @ frame.x
    inner = np.ones(len(gap), dtype=bool)
    inner[clamped.rows] = False  # bound to the outline: their gap is what is drawn
    if close_gap:
        gap[inner] = above[inner]
    if along_normals:
        off = frame.x[W.indices] - spread(pairs.x, W.indptr)
        arms = _cross(off, surface.normals[W.indices])
        stencils, turn = _corrections(W, arms, -_moments(frame, surface, pairs.x, start))
        start, move = (
            start + turn,
            move + _corrections(W, arms, -_moments(frame, surface, pairs.x, move))[1],
        )
    return replace(pairs, N=N, cell=clamped.cell, gap=gap), stencils, start, move


def _moments(frame: Frame, surface: SmoothSurface, x: Array, N: csr_matrix) -> Array:
    """(n, 1 or 3) sum_J N_pJ (Y_J - x_p) x n_J: of a force along sum_J N_pJ n_J at x_p, what the
    frame's nodes exert more [length]. Zero: moments of both sides cancel."""
    middle = frame.x.mean(axis=0)
    of_nodes = _cross(frame.x - middle, surface.normals)
    return N @ of_nodes - _cross(x - middle, N @ surface.normals)


def _cross(a: Array, b: Array) -> Array:
    """(n, 3) cross products, or (n, 1) in the plane."""
    if a.shape[1] == 3:
        return np.cross(a, b)
    return cross_plane(a, b)[:, None]


def _corrections(W: csr_matrix, functions: Array, step: Array) -> tuple[RowStencils, csr_matrix]:
    """Stencils, and (n, m) least corrections of rows that change their sums of functions (z, c) by
    steps (n, c), no larger than LARGEST: where they would be, what they can hardly change fades, or
    the row stays."""
    delta = np.zeros(len(W.data))
    todo = np.ones(len(step), dtype=bool)
    stencils = [curved_stencils(W, functions, FADES[0])]
    for fade in FADES:
        if fade != FADES[0]:
            stencils.append(curved_stencils(W, functions, fade))
        change = stencils[-1].moved(step)
        largest = np.maximum.reduceat(np.abs(change), W.indptr[:-1])
        good = todo & (largest <= LARGEST)
        delta = np.where(spread(good, W.indptr), change, delta)
        todo &= ~good
        if not todo.any():
            break
    return stencils[0].rows, stencils[0].rows.matrix(delta, W.shape[1])


def vector_residual(N: Sequence[csr_matrix], vectors: Sequence[Array]) -> Array:
    """(m, gdim) sum of both sides' vector areas at the frame's nodes, over the largest one.

    Args:
        N: pair of (n_i, m) interpolation matrices.
        vectors: pair of (n_i, gdim) vector areas out of each side [area].
    """
    scale = max(np.linalg.norm(a, axis=1).max() for a in vectors)
    at_frame = [M.T @ (a / scale) for M, a in zip(N, vectors, strict=True)]
    return at_frame[0] + at_frame[1]


def loads_along_normals(
    N: Sequence[csr_matrix], vectors: Sequence[Array], normals: Array
) -> list[Array]:
    """Per side (n, 1) what a unit pressure's force exerts on the frame of what acts along the
    rows' mean normals m_p = sum_J N_pJ n_J: a_p · m_p / |m_p|² for unknowns along n_J [area]."""
    means = [M @ normals for M in N]
    return [
        (np.einsum("ni,ni->n", a, n) / np.einsum("ni,ni->n", n, n))[:, None]
        for a, n in zip(vectors, means, strict=True)
    ]


def with_mean_normals(pairs: Sequence[ContactPairs], normals: Array) -> list[ContactPairs]:
    """Both sides with n_p = sum_J N_pJ n_J over its length, out of each, from the frame nodes'."""
    means = [sign * p.N @ normals for sign, p in zip((1.0, -1.0), pairs, strict=True)]
    return [replace(p, normal=unit(n)) for p, n in zip(pairs, means, strict=True)]


def nodal_normals(frame: Frame) -> Array:
    """(m, gdim) unit normals, the mean of the cells around each node by area."""
    return unit(areas_around(frame.x, frame.corners, frame.cells))
