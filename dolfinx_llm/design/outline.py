"""Rows of curved frames at the outline, which bind nodes there to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.spatial import cKDTree

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.design.stencils import adjacency, row_weights, spread
from dolfinx_llm.geometry.cells import areas_around, outline_edges, unit
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.pairs import ContactPairs

AT_NODE = 1e-9  # from 1, at which a row is its frame node's
TILTED = 2.0  # angles of cells to the surface's normal, by which the way across a gap may be off
ON_LINE = 0.5  # how near to an edge's line nodes of the outline belong to it, of its length and of
# their way from its ends


@dataclass(frozen=True, eq=False)
class Clamped:
    """Rows of one side, with those at the frame's outline bound to the outline's nodes."""

    rows: Array  # (c,) rows at the outline
    edge: Array  # (c,) edge of the outline
    N: csr_matrix  # (n, m) all rows
    cell: Array  # (n,) cell of each row


def at_outline(
    frame: Frame, pairs: ContactPairs, edges: Array, normals: Array, near: float
) -> Clamped:
    """Bind nodes of a side's outline that lie at the frame's to it: what a symmetry plane or an
    edge prescribes for the one must not concern the frame's inner nodes.

    Args:
        normals: (n_cells, gdim) of the frame's cells.
        near: how near a node lies to the frame's outline that is bound to it, in cells.
    """
    own = np.unique(outline_edges(pairs.surface.facets))
    rows = np.flatnonzero(np.isin(pairs.nodes, own))
    if not len(edges) or not len(rows):
        return Clamped(rows[:0], rows[:0], pairs.N, pairs.cell)
    ends, x = frame.x[edges], pairs.x[rows]
    some = cKDTree(ends.mean(axis=1)).query(x, k=min(8, len(edges)))[1].reshape(len(x), -1)
    a, b = ends[some, 0], ends[some, -1]
    along = np.einsum("nei,nei->ne", x[:, None] - a, b - a)
    length2 = np.maximum(np.einsum("nei,nei->ne", b - a, b - a), 1e-300)
    t = np.clip(along / length2, 0.0, 1.0)
    distance = np.linalg.norm(x[:, None] - a - t[..., None] * (b - a), axis=2)
    # The cell that an edge belongs to, and the distance within its plane.
    owner = _cells_of_edges(frame.cells, edges)[some]
    if edges.shape[1] > 1:
        t = _over_nodes(x[:, None], a, b, t, TILTED * _tilt(frame, normals)[owner])
    miss = x[:, None] - a - t[..., None] * (b - a)
    normal = normals[owner]
    miss -= np.einsum("nei,nei->ne", miss, normal)[..., None] * normal
    off = np.linalg.norm(miss, axis=2) / frame.cell_size[owner]
    # Of two edges that are as near, next to a node, the one in whose cell's plane it is nearer.
    distance = np.round(distance / max(distance.max(), 1e-300), 9)
    nearest = distance == distance.min(axis=1, keepdims=True)
    pick = np.arange(len(x)), np.where(nearest, np.round(off, 9), np.inf).argmin(axis=1)
    close = off[pick] <= near
    rows, edge, t, owner = rows[close], some[pick][close], t[pick][close], owner[pick][close]
    inner, cell = np.ones(len(pairs.nodes)), pairs.cell.copy()
    inner[rows], cell[rows] = 0.0, owner
    share = np.column_stack([1.0 - t, t])[:, : edges.shape[1]]
    at = np.repeat(rows, edges.shape[1]), edges[edge].ravel()
    N = (diags(inner) @ pairs.N + csr_matrix((share.ravel(), at), pairs.N.shape)).tocsr()
    N.eliminate_zeros()
    return Clamped(rows, edge, N, cell)


def _over_nodes(x: Array, a: Array, b: Array, t: Array, tilt: Array) -> Array:
    """(n, e) places on edges from a to b (n, e, gdim), 0 or 1 where a node x (n, 1, gdim) lies over
    an end: across a gap or an overlap, which cells are square to but for a tilt (n, e). What is
    held at a corner would else hold the nodes along both edges, by next to nothing."""
    length = np.linalg.norm(b - a, axis=2)
    for end, value, way in ((a, 0.0, t * length), (b, 1.0, (1.0 - t) * length)):
        t = np.where(way <= tilt * np.linalg.norm(x - end, axis=2), value, t)
    return t


def _tilt(frame: Frame, normals: Array) -> Array:
    """(n_cells,) largest difference of a cell's normal and the mean ones at its nodes."""
    at_nodes = unit(areas_around(frame.x, frame.corners, frame.cells))[frame.corners]
    return np.linalg.norm(at_nodes - normals[:, None], axis=2).max(axis=1)


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


def outline_weights(
    frame: Frame, clamped: Clamped, edges: Array, normals: Array, ring: csr_matrix
) -> csr_matrix:
    """(n, m) weights of the frame nodes in each row's stencil.

    Rows at the outline take the nodes along the line of their edge alone, which the outline leads
    to: those across a thin slice are of another edge. On a line, as anywhere in 2D, one ring of
    three nodes would leave nothing beside three constraints: they take two.

    Args:
        normals: (n_cells, gdim) of the frame's cells.
        ring: ``adjacency`` of the frame's nodes.
    """
    wide = row_weights(clamped.N, ring @ ring)
    if frame.gdim == 3:
        along = adjacency(edges, len(frame.x)) ** 2
        wide = row_weights(clamped.N, (ring @ ring).multiply(along > 0.0).tocsr())
        at_edge = np.zeros(wide.shape[0])
        at_edge[clamped.rows] = 1.0
        wide = diags(1.0 - at_edge) @ row_weights(clamped.N, ring) + diags(at_edge) @ wide
    W = wide.tocsr()
    if len(clamped.rows):
        W.data[~_along_lines(frame, clamped, edges, normals, W)] = 0.0
    W.eliminate_zeros()
    return W


def _along_lines(
    frame: Frame, clamped: Clamped, edges: Array, normals: Array, W: csr_matrix
) -> Array:
    """(z,) which entries of W stay: those of inner rows, and of nodes along a row's own edge."""
    edge_of = np.full(W.shape[0], -1)
    edge_of[clamped.rows] = clamped.edge
    at = spread(edge_of, W.indptr)
    keep = at < 0
    entries = np.flatnonzero(at >= 0)
    node, normal = W.indices[entries], normals[spread(clamped.cell, W.indptr)[entries]]
    keep[entries] = (node[:, None] == edges[at[entries]]).any(axis=1)
    if edges.shape[1] == 2:
        keep[entries] |= _on_line(frame.x, edges, at[entries], node, normal)
        # A node at a corner of the outline lies on the lines of both edges: it stays.
        for other in _edges_there(clamped, edges):
            edge_of[clamped.rows] = other
            also = spread(edge_of, W.indptr)[entries]
            some = entries[there := also >= 0]
            keep[some] &= _on_line(frame.x, edges, also[there], node[there], normal[there])
    return keep


def _on_line(x: Array, edges: Array, edge: Array, node: Array, normal: Array) -> Array:
    """(z,) which nodes (z,) are of the outline and lie near the lines of edges (z,), in planes of
    these normals (z, gdim)."""
    a, b = x[edges[edge, 0]], x[edges[edge, 1]]
    length = np.linalg.norm(b - a, axis=1)
    across = unit(np.cross(normal, (b - a) / length[:, None]))
    off = np.abs(np.einsum("zi,zi->z", x[node] - a, across))
    from_ends = np.linalg.norm(x[node] - [a, b], axis=2).min(axis=0)
    near = off <= ON_LINE * np.where(from_ends > 0.0, np.minimum(length, from_ends), length)
    return np.isin(node, edges) & near


def _edges_there(clamped: Clamped, edges: Array) -> list[Array]:
    """Twice (c,) an edge of the outline at the node on which a row of it lies, -1: on none."""
    rows = clamped.N[clamped.rows]
    alone = np.asarray(rows.max(axis=1).todense()).ravel() > 1.0 - AT_NODE
    node = np.where(alone, np.asarray(rows.argmax(axis=1)).ravel(), -1)
    ends, edge = edges.ravel(), np.repeat(np.arange(len(edges)), 2)
    first, last = np.full((2, edges.max() + 1), -1)
    last[ends], first[ends[::-1]] = edge, edge[::-1]  # of what is given twice the last one stays
    return [np.where(alone, of[node], -1) for of in (first, last)]
