"""The smooth surface through a curved frame's nodes.

Around every cell a surface of third order is fitted to the nodes of the cell and of the cells
around it, in the cell's own axes: exact for circles, cylinders and spheres. Between them the
surface is blended by the shape functions, so that it is one surface, whichever cell of the frame a
point is said to lie in.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, identity

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.design.stencils import inner_part, spread, sums
from dolfinx_llm.geometry.cells import bases, unit, vector_areas
from dolfinx_llm.geometry.frame import Frame

FIT = 60  # steps of the fit
STEPS = 2  # towards the point of the surface along the normal
RIDGE = 0.1  # by which terms of third order fade that the nodes hardly tell


@dataclass(frozen=True, eq=False)
class SmoothSurface:
    """Quadrics of all cells, in axes of their cell, and what blends them."""

    x: Array  # (m, gdim) nodes of the frame [length]
    centre: Array  # (n_cells, gdim) origin of a cell's axes [length]
    base: Array  # (n_cells, gdim, gdim) tangents and normal, the mean of the cells around
    size: Array  # (n_cells,) half-width of the cells that were fitted [length]
    height: Array  # (n_cells, 4 or 10) q of the fitted surface z = q(s) + bend z²
    bend: Array  # (n_cells,)
    share: csr_matrix  # (m, n_cells) of the cells around each node in the blend; sums 1
    miss: Array  # (m, gdim) the blend at the nodes less the nodes [length]
    normals: Array  # (m, gdim) unit normals at the nodes

    @staticmethod
    def through(frame: Frame) -> SmoothSurface:
        """The surface through the nodes of a frame."""
        cells, m = frame.cells, len(frame.x)
        n, k = cells.shape
        nodes, mask = _nodes_around(cells)
        centre = frame.x[cells].mean(axis=1)
        base = _mean_bases(frame)
        local = np.einsum("gai,gwi->gwa", base, frame.x[nodes] - centre[:, None, :])
        local *= mask[..., None]
        size = np.linalg.norm(local, axis=2).max(axis=1)  # however the axes lie
        height, bend = _fit(local / size[:, None, None], mask)
        share = csr_matrix((np.ones(n * k), (cells.ravel(), np.repeat(np.arange(n), k))), (m, n))
        share.data /= spread(sums(share.data, share.indptr), share.indptr)
        none = np.zeros_like(frame.x)
        raw = SmoothSurface(frame.x, centre, base, size, height, bend, share, none, none)
        point, normals = raw.at(identity(m, format="csr"), frame.x)
        return replace(raw, miss=point - frame.x, normals=normals)

    @property
    def error(self) -> float:
        """About how far the surface is off between the nodes: twice what it was off at them
        [length]."""
        return 2.0 * float(np.linalg.norm(self.miss, axis=1).max())

    def at(self, N: csr_matrix, x: Array) -> tuple[Array, Array]:
        """Points (n, gdim) of the surface along whose normals positions x lie, and unit normals
        there; rows N say which cells are near. Beyond the outline the quadrics next to it go on."""
        blend = (inner_part(N) @ self.share).tocsr()
        start, weight = x, blend.data[:, None]
        # Again from what lies along the normal there: the cells' axes differ from it, and the mean
        # of what lies along them from afar is below a curved surface.
        for _ in range(STEPS):
            found = self._quadrics(blend.indices, spread(start, blend.indptr))
            point, normal = (
                np.column_stack([sums(c, blend.indptr) for c in (weight * a).T]) for a in found
            )
            normal = unit(normal)
            start = x + np.einsum("ni,ni->n", point - x, normal)[:, None] * normal
        return point - N @ self.miss, normal

    def _quadrics(self, cell: Array, x: Array) -> tuple[Array, Array]:
        """Points and unit normals of cells' quadrics above or below places x (n, gdim)."""
        d = (x - self.centre[cell]) / self.size[cell, None]
        s = np.einsum("nai,ni->na", self.base[cell], d)[:, :-1]
        q, bend = self.height[cell], self.bend[cell]
        start = np.einsum("nk,nk->n", _monomials(s), q)
        # The root near 0; where there is none, the place is beyond a sphere's equator.
        z = 2.0 * start / (1.0 + np.sqrt(np.maximum(1.0 - 4.0 * bend * start, 0.0)))
        if s.shape[1] == 1:
            slope = q[:, 1:2] + 2.0 * q[:, 2:3] * s + 3.0 * q[:, 3:4] * s * s
        else:
            a, b = s.T
            slope = np.column_stack([
                q[:, 1] + 2.0 * q[:, 3] * a + q[:, 4] * b
                + 3.0 * (q[:, 6] * a * a + q[:, 8] * b * b) + 6.0 * q[:, 7] * a * b,
                q[:, 2] + q[:, 4] * a + 2.0 * q[:, 5] * b
                + 3.0 * (q[:, 7] * a * a + q[:, 9] * b * b) + 6.0 * q[:, 8] * a * b,
            ])  # fmt: skip
        normal = unit(np.column_stack([-slope, 1.0 - 2.0 * bend * z]))
        local = self.size[cell, None] * np.column_stack([s, z])
        base = self.base[cell]
        return (
            self.centre[cell] + np.einsum("nai,na->ni", base, local),
            np.einsum("nai,na->ni", base, normal),
        )


def _mean_bases(frame: Frame) -> Array:
    """(n_cells, gdim, gdim) bases whose normals are the means of the cells around each: what is
    fitted slopes least there, and a surface that bends is nearest to one of third order."""
    n, k = frame.cells.shape
    of = csr_matrix((np.ones(n * k), frame.cells.ravel(), np.arange(0, n * k + 1, k)))
    around = of @ of.T
    around.data[:] = 1.0
    normal = unit(around @ vector_areas(frame.x, frame.cells))
    middle = np.full((n, min(k - 1, 2)), {2: 0.5, 3: 1.0 / 3.0, 4: 0.0}[k])
    t = frame.evaluate(np.arange(n), middle)[2]
    return bases(t - np.einsum("nai,ni->na", t, normal)[..., None] * normal[:, None, :])


def _monomials(s: Array) -> Array:
    """1, s, s², s³ (and products, those of third order three times) of coordinates (..., d)."""
    one = np.ones_like(s[..., :1])
    if s.shape[-1] == 1:
        return np.concatenate([one, s, s * s, s**3], axis=-1)
    a, b = s[..., :1], s[..., 1:]
    cubic = [a**3, 3.0 * a * a * b, 3.0 * a * b * b, b**3]
    return np.concatenate([one, a, b, a * a, a * b, b * b, *cubic], axis=-1)


def _fit(local: Array, mask: Array) -> Any:
    """Fit z = q(s) + bend z², q cubic: exact for circles, cylinders and spheres.

    With the Hessian H of q, bend = tr H² / (2 tr H): half the curvature on these surfaces.
    """
    columns = _monomials(local[..., :-1]) * mask[..., None]
    n, width, k = columns.shape
    # With coefficients times these, of ab and the cubic terms, sums of squares know no axes.
    times = np.sqrt([1, 1, 1, 1] if k == 4 else [1, 1, 1, 1, 0.5, 1, 1, 3, 3, 1])
    ridge = RIDGE * np.eye(k)[k - (1 if k == 4 else 4) :]
    both = np.concatenate([columns / times, np.broadcast_to(ridge, (n, *ridge.shape))], axis=1)
    inverse = np.linalg.pinv(both, rcond=1e-6)[..., :width] / times[:, None]
    z, bend = local[..., -1], np.zeros(len(local))
    for _ in range(FIT):
        last, q = bend, np.einsum("gkw,gw->gk", inverse, z - bend[:, None] * z * z)
        if local.shape[2] == 2:
            bend = q[:, 2]
        else:
            trace, det = 2.0 * (q[:, 3] + q[:, 5]), 4.0 * q[:, 3] * q[:, 5] - q[:, 4] ** 2
            # Where the curvatures differ in sign it fades.
            fade = 2.0 * trace**2 + 8.0 * np.maximum(-det, 0.0)
            bend = trace * (trace**2 - 2.0 * det) / np.maximum(fade, 1e-300)
        if not np.abs(bend - last).max() > 1e-15:
            break
    return q, bend


def _nodes_around(cells: Array) -> tuple[Array, Array]:
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
