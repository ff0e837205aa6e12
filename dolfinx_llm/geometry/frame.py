"""The contact frame: a surface mesh with its own nodes between two bodies.

Plain NumPy; knows neither dolfinx nor PETSc. Cells are segments (in the plane), linear triangles
or bilinear quadrilaterals (paper, (23)). The surface bases of a cell follow its orientation: its
normal points out of side 0 into side 1.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix, diags
from scipy.spatial import cKDTree

from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.geometry.cells import (
    _joined,
    _on_sides,
    _repeated,
    shape_functions,
    vector_areas,
)


@dataclass(frozen=True)
class Location:
    """Points located on a frame: where each lies and how far from it."""

    cell: np.ndarray  # (n,) frame cell
    xi: np.ndarray  # (n, d) reference coordinates of the closest point
    N: np.ndarray  # (n, k) shape functions of that cell's nodes, continued linearly outside
    outside: np.ndarray  # (n,) tangential distance from the cell in units of its size, 0 inside


@dataclass(frozen=True)
class Quality:
    """Shape of a frame's cells."""

    min_angle: float  # smallest corner angle [degree]
    max_angle: float  # largest corner angle [degree]
    min_side: float  # shortest side [length]
    min_jacobian: float  # smallest corner Jacobian over the cell's mean (1: parallelogram)


@dataclass(frozen=True)
class Frame:
    """A frame: nodes Y (or the current y = Y + v of (8)) and cells.

    Args:
        x: (m, gdim) node positions [length].
        cells: (n, 2), (n, 3) or (n, 4) node numbers; quads in cyclic order. Neighbouring cells
            must be oriented alike; which of the two ways is found out from the bodies.
        v: (m, gdim) displacement of the nodes, in results [length].

    Raises:
        ContactInputError: for wrong shapes, node numbers out of range, unused nodes, NaN, cells
            that are inverted, degenerate or turned against their neighbours.

    >>> frame = Frame([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], [[0, 1, 2, 3]])
    >>> at = frame.locate([[0.5, 0.5, 0.0]])
    >>> at.xi.tolist(), at.N.tolist()  # bilinear on [-1, 1]²
    ([[-0.5, 0.0]], [[0.375, 0.125, 0.125, 0.375]])
    >>> frame.interpolation(at) @ frame.x
    array([[0.5, 0.5, 0. ]])
    >>> frame.quality.max_angle, frame.quality.min_side
    (90.0, 1.0)
    """

    x: np.ndarray
    cells: np.ndarray
    v: np.ndarray | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        x = np.ascontiguousarray(self.x, dtype=np.float64)
        cells = np.ascontiguousarray(self.cells, dtype=np.int64)
        object.__setattr__(self, "x", x)
        object.__setattr__(self, "cells", cells)
        if x.ndim != 2 or x.shape[1] not in (2, 3):
            raise ContactInputError(f"frame: x must be (m, 2) or (m, 3), is {x.shape}")
        kinds = (2,) if x.shape[1] == 2 else (3, 4)
        if cells.ndim != 2 or cells.shape[1] not in kinds or len(cells) == 0:
            raise ContactInputError(
                f"frame: cells must be (n, {' or '.join(map(str, kinds))}) node numbers with n > 0 "
                f"for nodes in {x.shape[1]}D, is {cells.shape}"
            )
        if cells.min() < 0 or cells.max() >= len(x):
            raise ContactInputError(
                f"frame: cells name nodes {cells.min()} to {cells.max()}, there are 0 to "
                f"{len(x) - 1}"
            )
        if not np.isfinite(x).all():
            raise ContactInputError(f"frame: {np.sum(~np.isfinite(x))} coordinates are not finite")
        unused = np.setdiff1d(np.arange(len(x)), cells)
        if len(unused):
            raise ContactInputError(f"frame: nodes {unused[:10].tolist()} belong to no cell")
        bad = np.flatnonzero(self._corner_jacobians.min(axis=1) <= 1e-8)
        if len(bad):
            raise ContactInputError(
                f"frame: cells {bad[:10].tolist()} are inverted or degenerate (corner Jacobian at "
                f"most 1e-8 of the cell's mean); first: nodes {cells[bad[0]].tolist()} at "
                f"{x[cells[bad[0]]].tolist()}"
            )
        self._check_orientation()

    def _check_orientation(self) -> None:
        """An edge (a node in 2D) of two cells must be run through once each way."""
        if self.cells.shape[1] == 2:
            counts = [np.bincount(c, minlength=len(self.x)) for c in self.cells.T]
            bad = np.flatnonzero(np.maximum(*counts) > 1)
        else:
            edges = self.cells * len(self.x) + np.roll(self.cells, -1, axis=1)  # one number each
            _, first, count = np.unique(edges, return_index=True, return_counts=True)
            bad = first[count > 1] // self.cells.shape[1]
        if len(bad):
            where = "nodes" if self.cells.shape[1] == 2 else "cells"
            raise ContactInputError(
                f"frame: neighbouring cells are turned against each other (inverted) or overlap "
                f"at {where} {bad[:10].tolist()}"
            )

    @classmethod
    def from_gmsh(
        cls, model: Any, physical_group: int, comm: MPI.Comm | None = None, gdim: int = 3
    ) -> Frame:
        """Frame from a physical group of a meshed gmsh model: surfaces, curves where gdim is 2.

        Args:
            model: gmsh.model; used on rank 0 only.
            physical_group: tag of the group.
            comm: MPI communicator, or None for a model that every rank has.
            gdim: dimension of the space.

        Raises:
            ContactInputError: no first-order cells of one kind in the group; see ``Frame``.
        """
        if comm is None:
            return cls(*_read_gmsh(model, physical_group, gdim))
        data = _read_gmsh(model, physical_group, gdim) if comm.rank == 0 else None
        return cls(*comm.bcast(data, root=0))

    @property
    def gdim(self) -> int:
        """Dimension of the space, 2 or 3."""
        return self.x.shape[1]

    @cached_property
    def _corner_jacobians(self) -> np.ndarray:
        """(n_cells, k) Jacobian at the corners over the cell's mean; of a warped quad, along its
        mean normal."""
        p = self.x[self.cells]
        if self.cells.shape[1] == 2:
            length = np.linalg.norm(p[:, 1] - p[:, 0], axis=1)
            return np.column_stack([length, length]) / max(length.mean(), 1e-300)
        area = vector_areas(self.x, self.cells)
        size = np.linalg.norm(area, axis=1)
        if self.cells.shape[1] == 3:
            side = np.linalg.norm(p - np.roll(p, -1, axis=1), axis=2).max(axis=1)
            return np.repeat((size / np.maximum(side, 1e-300) ** 2)[:, None], 3, axis=1)
        corner = np.cross(np.roll(p, -1, axis=1) - p, np.roll(p, 1, axis=1) - p)
        normal = area / np.maximum(size, 1e-300)[:, None]
        return np.einsum("cki,ci->ck", corner, normal) / np.maximum(size, 1e-300)[:, None]

    @cached_property
    def quality(self) -> Quality:
        """Corner angles, shortest side and Jacobian over all cells."""
        p = self.x[self.cells]
        if self.cells.shape[1] == 2:
            side = np.linalg.norm(p[:, 1] - p[:, 0], axis=1)
            return Quality(180.0, 180.0, float(side.min()), 1.0)
        e = np.roll(p, -1, axis=1) - p
        b = -np.roll(e, 1, axis=1)
        angle = np.degrees(
            np.arctan2(np.linalg.norm(np.cross(e, b), axis=2), np.einsum("cki,cki->ck", e, b))
        )
        return Quality(
            float(angle.min()),
            float(angle.max()),
            float(np.linalg.norm(e, axis=2).min()),
            float(self._corner_jacobians.min()),
        )

    @cached_property
    def cell_size(self) -> np.ndarray:
        """(n_cells,) square root of the area (length in 2D) [length]."""
        area = np.linalg.norm(vector_areas(self.x, self.cells), axis=1)
        return area if self.cells.shape[1] == 2 else np.sqrt(area)

    def flipped(self) -> Frame:
        """The same frame with its normal turned round."""
        return replace(self, cells=self.cells[:, ::-1])

    def evaluate(self, cell: np.ndarray, xi: np.ndarray) -> tuple[np.ndarray, ...]:
        """Shape functions, positions and tangents at points of the frame, (23).

        Args:
            cell: (n,) frame cells.
            xi: (n, d) reference coordinates in them.

        Returns:
            N (n, k), positions (n, gdim) [length] and derivatives of the position by the
            reference coordinates (n, d, gdim) [length].
        """
        N, dN = shape_functions(self.cells.shape[1], xi)
        p = self.x[self.cells[cell]]
        return N, np.einsum("nk,nki->ni", N, p), np.einsum("nkd,nki->ndi", dN, p)

    def locate(self, points: ArrayLike) -> Location:
        """Closest point of the frame for each given point (inverse isoparametric mapping).

        Beyond the closest point (outside the outline) the shape functions are continued by their
        gradient: they still sum to 1 and still reproduce linear fields. Where several cells share
        the closest point, it belongs to the first one.

        Args:
            points: (n, gdim) positions [length].

        Returns:
            A ``Location`` with one row per point.
        """
        x = np.asarray(points, dtype=np.float64)
        cell = cKDTree(self._balls[0]).query(x)[1]
        xi, distance = self._invert(x, cell)
        far = np.maximum(np.abs(x).max(axis=1, initial=0.0), np.abs(self.x).max())
        rounding = 1e-10 * self.cell_size.mean() + 10.0 * np.finfo(float).eps * far
        N, dN = shape_functions(self.cells.shape[1], xi)
        inside = (N.min(axis=1) > 1e-9) & (distance <= rounding)
        rest = np.flatnonzero(~inside)
        if len(rest):
            cell[rest], xi[rest] = self._closest(x[rest], distance[rest], rounding[rest])
            N, dN = shape_functions(self.cells.shape[1], xi)
        step, offset = self._step(x, cell, xi)
        N = N + np.einsum("nkd,nd->nk", dN, step)
        return Location(cell, xi, N, self._outside(offset, cell))

    def _closest(
        self, x: np.ndarray, bound: np.ndarray, rounding: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Cells with the closest points, of equally close ones the first, and these points.

        Args:
            x: (n, gdim) points [length].
            bound: (n,) how far from each there is a cell [length].
            rounding: (n,) distances that differ by less are the same [length].
        """
        point, cell = self._candidates(x, bound, rounding)
        xi, distance = self._invert(x[point], cell)
        least = np.full(len(x), np.inf)
        np.minimum.at(least, point, distance)
        close = distance <= (least + rounding)[point]
        point, cell, xi = point[close], cell[close], xi[close]
        # Above an edge distances hardly differ from where the foot lies in one of its cells.
        outside = self._outside(self._step(x[point], cell, xi)[1], cell)
        order = np.lexsort((cell, outside > 0.0, point))
        best = order[np.unique(point[order], return_index=True)[1]]
        return cell[best], xi[best]

    def _outside(self, offset: np.ndarray, cell: np.ndarray) -> np.ndarray:
        """Tangential distance from cells in units of their size, 0 inside."""
        outside = np.linalg.norm(offset, axis=1) / self.cell_size[cell]
        outside[outside < 1e-11] = 0.0  # rounding of the coordinates
        return outside

    def _step(
        self, x: np.ndarray, cell: np.ndarray, xi: np.ndarray, inside: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Newton step towards the foot of points x, or the closest point inside the quad, and how
        far it moves in space."""
        _, y, t = self.evaluate(cell, xi)
        JJ = np.einsum("nai,nbi->nab", t, t)
        rhs = np.einsum("nai,ni->na", t, x - y)
        if JJ.shape[1] == 1:
            step = rhs / JJ[:, 0]
        else:
            a, b, c = JJ[:, 0, 0], JJ[:, 0, 1], JJ[:, 1, 1]
            if inside:  # at a side that a point lies beyond, the other coordinate goes on alone
                b = np.where(((np.abs(xi) >= 1.0) & (xi * rhs > 0.0)).any(axis=1), 0.0, b)
            adjugate = np.column_stack(
                [c * rhs[:, 0] - b * rhs[:, 1], a * rhs[:, 1] - b * rhs[:, 0]]
            )
            step = adjugate / np.maximum(a * c - b * b, 1e-300)[:, None]
        return step, np.einsum("na,nai->ni", step, t)

    @cached_property
    def _balls(self) -> tuple[np.ndarray, np.ndarray]:
        """Centroids (n_cells, gdim) and radii (n_cells,) of balls that hold the cells [length]."""
        corners = self.x[self.cells]
        centre = corners.mean(axis=1)
        return centre, np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)

    def _candidates(
        self, x: np.ndarray, bound: np.ndarray, rounding: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (point, cell) of all cells that may be as close as the bound: for points on the
        frame those whose ball holds them, for others what ball and plane of a cell leave."""
        centre, radius = self._balls
        on = np.flatnonzero(bound <= rounding)
        found = cKDTree(x[on]).query_ball_point(centre, radius + 2.0 * rounding.max())
        points, cells = [on[_joined(found)]], [_repeated(np.arange(len(centre)), found)]
        normal = vector_areas(self.x, self.cells)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        corners = self.x[self.cells] - centre[:, None]
        warp = np.abs(np.einsum("cki,ci->ck", corners, normal)).max(axis=1)
        off, bound, tree = np.flatnonzero(bound > rounding), bound + rounding, cKDTree(centre)
        for some in np.array_split(off, len(off) // 1000 + 1):  # points far away have many cells
            found = tree.query_ball_point(x[some], bound[some] + radius.max())
            point, cell = _repeated(some, found), _joined(found)
            d = x[point] - centre[cell]
            height = np.einsum("ni,ni->n", d, normal[cell])
            along = np.linalg.norm(d - height[:, None] * normal[cell], axis=1) - radius[cell]
            above = np.abs(height) - warp[cell]
            near = np.hypot(np.maximum(above, 0.0), np.maximum(along, 0.0)) <= bound[point]
            points.append(point[near])
            cells.append(cell[near])
        return np.concatenate(points), np.concatenate(cells)

    def _invert(self, x: np.ndarray, cell: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Reference coordinates of the closest point in a cell, and its distance [length]."""
        k = self.cells.shape[1]
        xi = np.full((len(x), 1 if k == 2 else 2), {2: 0.5, 3: 1.0 / 3.0, 4: 0.0}[k])
        active = np.arange(len(x))
        for _ in range(2 if k < 4 else 20):
            step, _ = self._step(x[active], cell[active], xi[active], inside=k == 4)
            new = xi[active] + step
            if k != 3:
                new = np.clip(new, -1.0 if k == 4 else 0.0, 1.0)
            moved = np.abs(new - xi[active]).max(axis=1) > 1e-14  # below is rounding
            xi[active] = new
            active = active[moved]
            if not len(active):
                break
        if k == 3:
            beyond = np.flatnonzero((xi < 0.0).any(axis=1) | (xi.sum(axis=1) > 1.0))
            xi[beyond] = _on_sides(self.x[self.cells[cell[beyond]]], x[beyond])
        return xi, np.linalg.norm(x - self.evaluate(cell, xi)[1], axis=1)

    def interpolation(self, location: Location, points: ArrayLike | None = None) -> csr_matrix:
        """(n, m) matrix of the shape functions N_J(xi_p): the scalar L_b before any design.

        Args:
            location: of n points, as ``locate`` gives it.
            points: (n, gdim) these points; then the shape functions of those beyond a node of the
                outline are the mean of what the cells around it continue theirs to, whichever of
                these cells comes first.
        """
        n, k = location.N.shape
        cols, begins = self.cells[location.cell], np.arange(0, n * k + 1, k)
        matrix = csr_matrix((location.N.ravel(), cols.ravel(), begins), shape=(n, len(self.x)))
        matrix.sort_indices()
        if points is None:
            return matrix
        foot = shape_functions(k, location.xi)[0]
        beyond = np.flatnonzero((location.outside > 0.0) & (foot.max(axis=1) > 1.0 - 1e-9))
        if not len(beyond):
            return matrix
        at = cols[beyond, foot[beyond].argmax(axis=1)]
        mean = self._continued(at, np.asarray(points, dtype=np.float64)[beyond])
        keep, put = np.ones(n), csr_matrix((np.ones(len(beyond)), (beyond, np.arange(len(beyond)))),
                                           (n, len(beyond)))  # fmt: skip
        keep[beyond] = 0.0
        matrix = diags(keep) @ matrix
        matrix.eliminate_zeros()
        return (matrix + put @ mean).tocsr()

    def _continued(self, node: np.ndarray, x: np.ndarray) -> csr_matrix:
        """(n, m) mean over the cells around each node of their shape functions continued to x."""
        k = self.cells.shape[1]
        corner = {2: [[0.0], [1.0]], 3: [[0, 0], [1, 0], [0, 1]], 4: [[-1, -1], [1, -1], [1, 1], [-1, 1]]}
        order = np.argsort(self.cells, axis=None, kind="stable")
        first, last = (np.searchsorted(self.cells.ravel()[order], node, side) for side in ("left", "right"))
        row = np.repeat(np.arange(len(node)), last - first)
        flat = order[np.arange(len(row)) + np.repeat(first - np.cumsum(last - first), last - first)
                     + np.repeat(last - first, last - first)]
        cell, xi = flat // k, np.array(corner[k], dtype=float)[flat % k]
        N, dN = shape_functions(k, xi)
        N = N + np.einsum("nkd,nd->nk", dN, self._step(x[row], cell, xi)[0])
        share = N / np.bincount(row, minlength=len(x))[row][:, None]
        index = np.repeat(row, k), self.cells[cell].ravel()
        return csr_matrix((share.ravel(), index), shape=(len(x), len(self.x)))


def _read_gmsh(model: Any, physical_group: int, gdim: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and cells of a physical group; no cells where they are not of one first-order kind."""
    nodes = {1: 2, 2: 3, 3: 4}  # gmsh's lines, triangles, quads
    kinds: set[int] = set()
    parts = [np.empty(0, dtype=np.int64)]
    if (gdim - 1, physical_group) in model.getPhysicalGroups():
        for entity in model.getEntitiesForPhysicalGroup(gdim - 1, physical_group):
            found = model.mesh.getElements(gdim - 1, entity)
            kinds |= set(map(int, found[0]))
            parts += [np.asarray(tags, dtype=np.int64) for tags in found[2]]
    if len(kinds) != 1 or not kinds <= set(nodes):
        return np.zeros((0, gdim)), np.zeros((0, gdim), dtype=np.int64)
    tags, x, _ = model.mesh.getNodes()
    used, cells = np.unique(np.concatenate(parts), return_inverse=True)
    order = np.argsort(tags)
    x = np.reshape(x, (-1, 3))[order[np.searchsorted(tags, used, sorter=order)], :gdim]
    return x, cells.reshape(-1, nodes[kinds.pop()])
