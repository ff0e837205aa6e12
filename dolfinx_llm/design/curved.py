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
from scipy.sparse import csr_matrix, diags
from scipy.spatial import cKDTree

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.design.quadric import SmoothSurface
from dolfinx_llm.design.stencils import (
    FADE,
    RowStencils,
    adjacency,
    curved_stencils,
    row_weights,
    spread,
)
from dolfinx_llm.geometry.cells import areas_around, cross_plane, unit, unit_normals
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.overlap_flat import outline_edges
from dolfinx_llm.geometry.pairs import ContactPairs

LARGEST = 0.3  # correction of an entry of L_b by geometry; larger ones are faded, or left out
FADES = (FADE, 1e-3, 1e-2, 1e-1)  # of ``curved_stencils``, until the correction is small enough
AT_OUTLINE = 0.2  # cells: how near to the frame's outline a node of a side's outline belongs to it
ON_LINE = 0.5  # edge lengths: how near to an edge's line nodes of the outline belong to it


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
    frame: Frame, pairs: Sequence[ContactPairs], close_gap: bool, along_normals: bool = False
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
    """
    surface = SmoothSurface.through(frame)
    ring = adjacency(frame.cells, len(frame.x))
    edges = outline_edges(frame.cells)
    normals, sides = unit_normals(frame.x, frame.cells), []
    for p in pairs:
        clamped = _at_outline(frame, p, edges, normals)
        W = _weights(frame, clamped, edges, normals, ring)
        sides.append(_smooth_side(frame, surface, p, clamped, W, close_gap, along_normals))
    out, stencils, start, move = (list(parts) for parts in zip(*sides, strict=True))
    return SmoothRows(out, stencils, start, move, surface)


@dataclass(frozen=True, eq=False)
class _Clamped:
    """Rows of one side, with those at the frame's outline bound to the outline's nodes."""

    rows: Array  # (c,) rows at the outline
    edge: Array  # (c,) edge of the outline
    N: csr_matrix  # (n, m) all rows
    cell: Array  # (n,) cell of each row


def _at_outline(frame: Frame, pairs: ContactPairs, edges: Array, normals: Array) -> _Clamped:
    """Bind nodes of a side's outline that lie at the frame's to it: what a symmetry plane or an
    edge prescribes for the one must not concern the frame's inner nodes.

    Args:
        normals: (n_cells, gdim) of the frame's cells.
    """
    own = np.unique(outline_edges(pairs.surface.facets))
    rows = np.flatnonzero(np.isin(pairs.nodes, own))
    if not len(edges) or not len(rows):
        return _Clamped(rows[:0], rows[:0], pairs.N, pairs.cell)
    ends, x = frame.x[edges], pairs.x[rows]
    near = cKDTree(ends.mean(axis=1)).query(x, k=min(8, len(edges)))[1].reshape(len(x), -1)
    a, b = ends[near, 0], ends[near, -1]
    along = np.einsum("nei,nei->ne", x[:, None] - a, b - a)
    length2 = np.maximum(np.einsum("nei,nei->ne", b - a, b - a), 1e-300)
    t = np.clip(along / length2, 0.0, 1.0)
    distance = np.linalg.norm(x[:, None] - a - t[..., None] * (b - a), axis=2)
    best = np.round(distance / distance.max(), 9).argmin(axis=1)
    pick = np.arange(len(x)), best
    edge, t = near[pick], t[pick]
    # The cell that the edge belongs to, and the distance within its plane.
    owner = _cells_of_edges(frame.cells, edges)[edge]
    miss = x - ends[edge, 0] - t[:, None] * (ends[edge, -1] - ends[edge, 0])
    normal = normals[owner]
    tangential = miss - np.einsum("ni,ni->n", miss, normal)[:, None] * normal
    close = np.linalg.norm(tangential, axis=1) <= AT_OUTLINE * frame.cell_size[owner]
    rows, edge, t, owner = rows[close], edge[close], t[close], owner[close]
    inner, cell = np.ones(len(pairs.nodes)), pairs.cell.copy()
    inner[rows], cell[rows] = 0.0, owner
    share = np.column_stack([1.0 - t, t])[:, : edges.shape[1]]
    at = np.repeat(rows, edges.shape[1]), edges[edge].ravel()
    N = (diags(inner) @ pairs.N + csr_matrix((share.ravel(), at), pairs.N.shape)).tocsr()
    N.eliminate_zeros()
    return _Clamped(rows, edge, N, cell)


def _cells_of_edges(cells: Array, edges: Array) -> Array:
    """(e,) the one cell of each outline edge (of each end node in 2D)."""
    m = cells.max() + 1
    if edges.shape[1] == 1:
        cell_of = np.zeros(m, dtype=np.int64)
        cell_of[cells] = np.arange(len(cells))[:, None]
        return cell_of[edges[:, 0]]
    key = (cells * m + np.roll(cells, -1, axis=1)).ravel()
    order = np.argsort(key)
    return order[np.searchsorted(key[order], edges[:, 0] * m + edges[:, 1])] // cells.shape[1]


def _weights(
    frame: Frame, clamped: _Clamped, edges: Array, normals: Array, ring: csr_matrix
) -> csr_matrix:
    """(n, m) weights of the frame nodes in each row's stencil.

    Rows at the outline take the nodes along the line of their edge alone. On a line, as anywhere
    in 2D, one ring of three nodes would leave nothing beside three constraints: they take two.

    Args:
        normals: (n_cells, gdim) of the frame's cells.
        ring: ``adjacency`` of the frame's nodes.
    """
    wide = row_weights(clamped.N, ring @ ring)
    if frame.gdim == 3:
        at_edge = np.zeros(wide.shape[0])
        at_edge[clamped.rows] = 1.0
        wide = diags(1.0 - at_edge) @ row_weights(clamped.N, ring) + diags(at_edge) @ wide
    W = wide.tocsr()
    if len(clamped.rows):
        W.data[~_along_lines(frame, clamped, edges, normals, W)] = 0.0
    W.eliminate_zeros()
    return W


def _along_lines(
    frame: Frame, clamped: _Clamped, edges: Array, normals: Array, W: csr_matrix
) -> Array:
    """(z,) which entries of W stay: those of inner rows, and of nodes along a row's own edge."""
    edge_of = np.full(W.shape[0], -1)
    edge_of[clamped.rows] = clamped.edge
    at = spread(edge_of, W.indptr)
    keep = at < 0
    entries = np.flatnonzero(at >= 0)
    edge, node = edges[at[entries]], W.indices[entries]
    on = (node[:, None] == edge).any(axis=1)
    if edge.shape[1] == 2:
        a, b = frame.x[edge[:, 0]], frame.x[edge[:, 1]]
        length = np.linalg.norm(b - a, axis=1)
        t = (b - a) / length[:, None]
        across = unit(np.cross(normals[spread(clamped.cell, W.indptr)[entries]], t))
        off = np.abs(np.einsum("zi,zi->z", frame.x[node] - a, across))
        on |= np.isin(node, edges) & (off <= ON_LINE * length)
    keep[entries] = on
    return keep


def _smooth_side(
    frame: Frame,
    surface: SmoothSurface,
    pairs: ContactPairs,
    clamped: _Clamped,
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
