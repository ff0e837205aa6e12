"""Rows of L_b on curved frames: smooth geometry first, then balance.

A frame of flat cells lies below the surface that its nodes are taken from by about h² / 8R. Rows
that interpolate on the cells alone would tie bodies across these chordal gaps: a rigid rotation
would strain them, and a closed gap would be wrong by as much. So each row is corrected on its cell
and the cells around it, by the smallest change that reproduces the place of its node, also along
the normal; then all rows, by the smallest change that balances the vector areas (design, 5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from dolfinx_llm.design.quadric import Stencils, cell_stencils, projectors, stencil_rows
from dolfinx_llm.geometry.cells import vector_areas
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.overlap_flat import outline_edges
from dolfinx_llm.geometry.pairs import ContactPairs

LARGEST = 0.3  # correction of an entry of L_b by geometry; larger ones are left out
DAMPING = 1e-3  # Tikhonov's parameter of the balance, relative to the mean diagonal
AT_OUTLINE = 0.2  # cells: how near to the frame's outline a node of a side's outline belongs to it


def curved_rows(
    frame: Frame, pairs: Sequence[ContactPairs], close_gap: bool
) -> tuple[list[ContactPairs], Stencils, np.ndarray, list[np.ndarray]]:
    """Rows of both sides that reproduce places on the smooth surface, and their stencils.

    Args:
        frame: the frame.
        pairs: both sides, as located on the frame's cells.
        close_gap: False: rows reproduce the nodes' own places where a small correction can (then
            linear fields and rotations pass exactly); True: the places below them on the surface
            through the frame's nodes, so that what remains is the gap.

    Returns:
        pairs with such rows, smooth normals and gaps along them; stencils of all groups; their
        projectors; per side the group of each row.
    """
    st = cell_stencils(frame)
    edges = outline_edges(frame.cells)
    clamped = [_at_outline(frame, p, edges, st) for p in pairs]
    n = len(frame.cells)
    extra = _along_outline(st, frame, edges, clamped)
    st = replace(st, **extra)
    P, M = projectors(st)
    out, groups = [], []
    for p, c in zip(pairs, clamped, strict=True):
        group = c.cell.copy()
        group[c.rows] = n + np.arange(len(c.rows))
        n += len(c.rows)
        groups.append(group)
        out.append(_smooth_pairs(frame, p, c, st, M, group, close_gap))
    return out, st, P, groups


@dataclass(frozen=True, eq=False)
class _Clamped:
    """Rows of one side, with those at the frame's outline bound to the outline's nodes."""

    rows: np.ndarray  # (c,) rows at the outline
    edge: np.ndarray  # (c,) edge of the outline
    N: csr_matrix  # (n, m) all rows
    cell: np.ndarray  # (n,) cell of each row


def _at_outline(frame: Frame, pairs: ContactPairs, edges: np.ndarray, st: Stencils) -> _Clamped:
    """Bind nodes of a side's outline that lie at the frame's to it: what a symmetry plane or an
    edge prescribes for the one must not concern the frame's inner nodes."""
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
    normal = st.base[owner, -1]
    tangential = miss - np.einsum("ni,ni->n", miss, normal)[:, None] * normal
    close = np.linalg.norm(tangential, axis=1) <= AT_OUTLINE * frame.cell_size[owner]
    rows, edge, t, owner = rows[close], edge[close], t[close], owner[close]
    N, cell = pairs.N.tolil(), pairs.cell.copy()
    N[rows] = 0.0
    N[rows, edges[edge, 0]] = 1.0 - t
    if edges.shape[1] == 2:
        N[rows, edges[edge, 1]] = t
    cell[rows] = owner
    N = N.tocsr()
    N.eliminate_zeros()
    return _Clamped(rows, edge, N, cell)


def _cells_of_edges(cells: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(e,) the one cell of each outline edge (of each end node in 2D)."""
    m = cells.max() + 1
    if edges.shape[1] == 1:
        cell_of = np.zeros(m, dtype=np.int64)
        cell_of[cells] = np.arange(len(cells))[:, None]
        return cell_of[edges[:, 0]]
    key = (cells * m + np.roll(cells, -1, axis=1)).ravel()
    order = np.argsort(key)
    return order[np.searchsorted(key[order], edges[:, 0] * m + edges[:, 1])] // cells.shape[1]


def _along_outline(
    st: Stencils, frame: Frame, edges: np.ndarray, clamped: Sequence[_Clamped]
) -> dict[str, np.ndarray]:
    """Stencils of all cells, followed by one per clamped row: nodes on the line of its edge."""
    cell = np.concatenate([c.cell[c.rows] for c in clamped])
    edge = edges[np.concatenate([c.edge for c in clamped])]
    nodes, local = st.nodes[cell], st.local[cell]
    on_edge = (nodes[..., None] == edge[:, None, :]).any(axis=2) & st.mask[cell]
    mask = on_edge
    if edge.shape[1] == 2 and len(cell):
        a, b = (st.to_local(cell, frame.x[edge[:, k]])[:, :2] for k in (0, 1))
        t = (b - a) / np.linalg.norm(b - a, axis=1)[:, None]
        d = local[..., :2] - a[:, None]
        across = np.abs(d[..., 0] * t[:, None, 1] - d[..., 1] * t[:, None, 0])
        length = np.linalg.norm(b - a, axis=1)[:, None]
        on_line = np.isin(nodes, edges) & (across <= 0.1 * length) & st.mask[cell]
        mask = on_edge | on_line
    return {
        "cell": np.concatenate([st.cell, cell]),
        "nodes": np.concatenate([st.nodes, np.where(mask, nodes, 0)]),
        "mask": np.concatenate([st.mask, mask]),
        "local": np.concatenate([st.local, local * mask[..., None]]),
    }


def _smooth_pairs(
    frame: Frame,
    pairs: ContactPairs,
    clamped: _Clamped,
    st: Stencils,
    M: np.ndarray,
    group: np.ndarray,
    close_gap: bool,
) -> ContactPairs:
    """Correct a side's rows so that they reproduce places on the smooth surface."""
    N, cell, m = clamped.N, clamped.cell, len(frame.x)
    chord = st.to_local(cell, N @ frame.x)
    point, normal = st.smooth(cell, chord[:, :-1])
    delta = np.zeros((len(cell), st.mask.shape[1]))
    free = np.abs(N.max(axis=1).toarray().ravel() - 1.0) > 1e-9  # not at a node of the frame
    targets = [point] if close_gap else [point, pairs.x]
    for target in targets:  # the later one where it takes no large correction
        change = np.einsum("nwd,nd->nw", M[group], st.to_local(cell, target) - chord)
        good = free & (np.abs(change).max(axis=1) <= LARGEST)
        delta[good] = change[good]
    N = N + stencil_rows(delta, st.nodes[group], st.mask[group], m)
    gap = pairs.x - N @ frame.x
    inner = np.ones(len(cell), dtype=bool)
    inner[clamped.rows] = False  # bound to the outline: their gap is what is drawn
    along = np.einsum("ni,ni->n", gap, normal)[:, None] * normal
    side = np.sign(np.einsum("ni,ni->n", pairs.normal, normal))[:, None]
    return replace(
        pairs, N=N, cell=cell, normal=side * normal, gap=np.where(inner[:, None], along, gap)
    )


def vector_residual(N: Sequence[csr_matrix], vectors: Sequence[np.ndarray]) -> np.ndarray:
    """(m, gdim) sum of both sides' vector areas at the frame's nodes, over the largest one.

    Args:
        N: pair of (n_i, m) interpolation matrices.
        vectors: pair of (n_i, gdim) vector areas out of each side [area].
    """
    scale = max(np.linalg.norm(a, axis=1).max() for a in vectors)
    at_frame = [M.T @ (a / scale) for M, a in zip(N, vectors, strict=True)]
    return at_frame[0] + at_frame[1]


def balance(
    frame: Frame,
    pairs: Sequence[ContactPairs],
    vectors: Sequence[np.ndarray],
    st: Stencils,
    P: np.ndarray,
    groups: Sequence[np.ndarray],
) -> list[csr_matrix]:
    """Correct the rows so that the vector areas cancel at the frame's nodes, in least squares.

    Minimises sum_p |a_p| |delta_p|² subject to the rows' constraints (P) and to d_J · r_J = 0 for
    the frame's normal d_J. On chords the totals of both sides differ, so a part of r remains;
    DAMPING keeps corrections small where r hardly depends on them. All components of r instead of
    the normal one leave about as much (measured: 3.4e-3 against 5.1e-3) at three times the size.

    Args:
        frame: the frame, m nodes.
        pairs: both sides with smooth rows.
        vectors: pair of (n_i, gdim) vector areas of the pairs.
        st, P, groups: of ``curved_rows``.

    Returns:
        Pair of (n_i, m) CSR matrices.
    """
    m, normal = len(frame.x), nodal_normals(frame)
    scale = max(np.linalg.norm(a, axis=1).max() for a in vectors)
    weights = [
        np.bincount(g, np.linalg.norm(a, axis=1) / scale, minlength=len(st.cell))
        for g, a in zip(groups, vectors, strict=True)
    ]
    weight = weights[0] + weights[1]
    D = np.einsum("gwi,gi->gw", normal[st.nodes], st.base[st.cell, -1]) * st.mask
    blocks = weight[:, None, None] * D[:, :, None] * P * D[:, None, :]
    rows = np.broadcast_to(st.nodes[:, :, None], P.shape)
    cols = np.broadcast_to(st.nodes[:, None, :], P.shape)
    A = csr_matrix((blocks.ravel(), (rows.ravel(), cols.ravel())), (m, m))
    factor = splu((A + diags(np.full(m, DAMPING * A.diagonal().mean() + 1e-300))).tocsc())
    plain, mu = [p.N for p in pairs], np.zeros(m)
    N, r = plain, np.einsum("mi,mi->m", vector_residual(plain, vectors), normal)
    for _ in range(30):  # each time the damping counts for less; ends when nothing is won
        mu = mu + factor.solve(r)
        delta = np.einsum("gwv,gv->gw", P, D * mu[st.nodes])
        better = [
            M - sign * stencil_rows(delta[g], st.nodes[g], st.mask[g], m)
            for M, g, sign in zip(plain, groups, (1.0, -1.0), strict=True)
        ]
        left = np.einsum("mi,mi->m", vector_residual(better, vectors), normal)
        if not np.linalg.norm(left) < 0.98 * np.linalg.norm(r):
            break
        N, r = better, left
    return N


def nodal_normals(frame: Frame) -> np.ndarray:
    """(m, gdim) unit normals, the mean of the cells around each node by area."""
    area = vector_areas(frame.x, frame.cells)
    normal = np.zeros_like(frame.x)
    np.add.at(normal, frame.cells, area[:, None, :])
    return normal / np.linalg.norm(normal, axis=1)[:, None]
