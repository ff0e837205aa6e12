"""The smooth surface through a curved frame's nodes, and what rows may be corrected on.

Around every cell a quadric is fitted to the nodes of the cell and of the cells around it, in the
cell's own axes: exact for circles, cylinders and spheres, of third order elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.geometry.cells import bases
from dolfinx_llm.geometry.frame import Frame


@dataclass(frozen=True, eq=False)
class Stencils:
    """Groups of frame nodes that rows may be corrected on, in axes of their cell."""

    cell: np.ndarray  # (g,) cell of each group
    nodes: np.ndarray  # (g, w), padded with node 0
    mask: np.ndarray  # (g, w)
    centre: np.ndarray  # (n_cells, gdim) origin of a cell's axes [length]
    base: np.ndarray  # (n_cells, gdim, gdim) tangents and normal of the cell
    size: np.ndarray  # (n_cells,) half-width of the stencil [length]
    local: np.ndarray  # (g, w, gdim) nodes in these axes over the size
    height: np.ndarray  # (n_cells, 3 or 6) q of the fitted surface z = q(s) + bend z²
    bend: np.ndarray  # (n_cells,)

    def to_local(self, cell: np.ndarray, x: np.ndarray) -> np.ndarray:
        """(n, gdim) positions in the axes of their cells."""
        d = (x - self.centre[cell]) / self.size[cell, None]
        return np.einsum("nai,ni->na", self.base[cell], d)

    def smooth(self, cell: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (n, gdim) and unit normals of the fitted surface over tangent coordinates s."""
        q, bend = self.height[cell], self.bend[cell]
        base = np.einsum("nk,nk->n", _monomials(s), q)
        z = base
        for _ in range(6):
            z = base + bend * z * z
        if s.shape[1] == 1:
            slope = q[:, 1:2] + 2.0 * q[:, 2:3] * s
        else:
            slope = np.column_stack([
                q[:, 1] + 2.0 * q[:, 3] * s[:, 0] + q[:, 4] * s[:, 1],
                q[:, 2] + q[:, 4] * s[:, 0] + 2.0 * q[:, 5] * s[:, 1],
            ])  # fmt: skip
        normal = np.column_stack([-slope, 1.0 - 2.0 * bend * z])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        point = np.column_stack([s, z])
        x = self.centre[cell] + self.size[cell, None] * np.einsum(
            "nai,na->ni", self.base[cell], point
        )
        return x, np.einsum("nai,na->ni", self.base[cell], normal)


def _monomials(s: np.ndarray) -> np.ndarray:
    """1, s, s² (and products) of tangent coordinates (..., d)."""
    one = np.ones_like(s[..., :1])
    if s.shape[-1] == 1:
        return np.concatenate([one, s, s * s], axis=-1)
    a, b = s[..., :1], s[..., 1:]
    return np.concatenate([one, a, b, a * a, a * b, b * b], axis=-1)


def cell_stencils(frame: Frame) -> Stencils:
    """One stencil per cell: its nodes and those of the cells around it."""
    nodes, mask = nodes_around(frame.cells)
    centre = frame.x[frame.cells].mean(axis=1)
    k = frame.cells.shape[1]
    middle = np.full((len(centre), min(k - 1, 2)), {2: 0.5, 3: 1.0 / 3.0, 4: 0.0}[k])
    base = bases(frame.evaluate(np.arange(len(centre)), middle)[2])
    local = np.einsum("gai,gwi->gwa", base, frame.x[nodes] - centre[:, None, :])
    local *= mask[..., None]
    size = np.abs(local).max(axis=(1, 2))
    local /= size[:, None, None]
    height, bend = _fit(local, mask)
    return Stencils(np.arange(len(centre)), nodes, mask, centre, base, size, local, height, bend)


def _fit(local: np.ndarray, mask: np.ndarray) -> Any:
    """Fit z = q(s) + bend z², q quadratic: exact for circles, cylinders and spheres.

    With the Hessian H of q, bend = tr H² / (2 tr H): half the curvature on these surfaces.
    """
    inverse = np.linalg.pinv(_monomials(local[..., :-1]) * mask[..., None], rcond=1e-6)
    z, bend = local[..., -1], np.zeros(len(local))
    for _ in range(8):
        q = np.einsum("gkw,gw->gk", inverse, z - bend[:, None] * z * z)
        if local.shape[2] == 2:
            bend = q[:, 2]
            continue
        trace = 2.0 * (q[:, 3] + q[:, 5])
        square = 4.0 * q[:, 3] ** 2 + 2.0 * q[:, 4] ** 2 + 4.0 * q[:, 5] ** 2
        # No more than on a cylinder, also where a saddle's trace vanishes.
        bend = square / np.where(trace == 0.0, np.inf, 2.0 * trace)
        bend = np.clip(bend, -0.5 * np.sqrt(square), 0.5 * np.sqrt(square))
    return q, bend


def projectors(st: Stencils) -> Any:
    """Projector on what no row constraint sees, and the least correction for given moments.

    The moments of a row are sum delta, sum delta s, sum delta n; the last where the stencil is
    curved and its nodes tell n from s.

    Returns:
        P (g, w, w); M (g, w, gdim): correction for moments (0, s, n).
    """
    C = np.concatenate([np.ones((*st.mask.shape, 1)), st.local], axis=2) * st.mask[..., None]
    bow = np.abs(C[..., -1]).max(axis=1)
    scale = np.where(bow > 1e-5, 1.0 / np.maximum(bow, 1e-300), 0.0)
    C[..., -1] *= scale[:, None]
    U, S, Vt = np.linalg.svd(C, full_matrices=False)
    keep = S > 1e-3 * S[:, :1]
    U = U * keep[:, None, :]
    P = np.eye(st.mask.shape[1]) * st.mask[:, None, :] - U @ np.swapaxes(U, 1, 2)
    M = (U / np.where(keep, S, 1.0)[:, None, :]) @ Vt
    M[..., -1] *= scale[:, None]
    return P, M[..., 1:]


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


def stencil_rows(values: np.ndarray, nodes: np.ndarray, mask: np.ndarray, m: int) -> csr_matrix:
    """Rows of stencil values as a sparse matrix with m columns."""
    indptr = np.concatenate([[0], np.cumsum(mask.sum(axis=1))])
    return csr_matrix((values[mask], nodes[mask], indptr), shape=(len(values), m))
