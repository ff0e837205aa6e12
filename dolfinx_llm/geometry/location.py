"""The closest point of a surface mesh: segments, triangles or bilinear quads, in 2D or 3D."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import summed, summing
from dolfinx_llm.geometry.cells import (
    CORNERS,
    cell_sizes,
    closest_on_sides,
    facets_around,
    joined_lists,
    outline_edges,
    points_of,
    repeated_for,
    shape_functions,
    unit_normals,
)
from dolfinx_llm.geometry.element import Element

UNFELT = 1e-15  # shape functions below this are zero
EDGE = 1e-14  # the same of a point on an edge


@dataclass(frozen=True, eq=False)
class Location:
    """Points located on a frame: where each lies and how far from it."""

    x: Array  # (n, gdim) the points [length]
    cell: Array  # (n,) frame cell
    xi: Array  # (n, d) reference coordinates of the closest point
    N: Array  # (n, k) shape functions of that cell's nodes, continued linearly outside
    outside: Array  # (n,) tangential distance from the cell in units of its size, 0 inside
    # Other points of the frame that are as close, as in the middle of a fold, or of a dented edge:
    equal: tuple[Array, ...]  # (t,) which of the n, (t,) cell, (t, d) xi


@dataclass(frozen=True, eq=False)
class ClosestPoints:
    """Finds closest points of cells (n_cells, k) over nodes x (m, gdim) [length]."""

    x: Array
    cells: Array

    def locate(self, x: Array) -> Location:
        """Closest point for each x (n, gdim); see ``Frame.locate``."""
        cell = cKDTree(self._balls[0]).query(x)[1]
        xi, distance = self._invert(x, cell)
        far = np.maximum(np.abs(x).max(axis=1, initial=0.0), np.abs(self.x).max())
        rounding = 1e-10 * self._size.mean() + 10.0 * np.finfo(float).eps * far
        N, dN = shape_functions(self.cells.shape[1], xi)
        inside = (N.min(axis=1) > 1e-9) & (distance <= rounding)
        rest = np.flatnonzero(~inside)
        equal: tuple[Array, ...] = rest[:0], cell[:0], xi[:0]
        if len(rest):
            cell[rest], xi[rest], (point, *others) = self._closest(
                x[rest], distance[rest], rounding[rest]
            )
            equal = rest[point], *others
            N, dN = shape_functions(self.cells.shape[1], xi)
        step, offset = self._step(x, cell, xi)
        N = N + np.einsum("nkd,nd->nk", dN, step)
        return Location(x, cell, xi, N, self._outside(offset, cell), equal)

    @cached_property
    def _size(self) -> Array:
        """(n_cells,) size of the cells [length]."""
        return cell_sizes(self.x, self.cells)

    def _closest(
        self, x: Array, bound: Array, rounding: Array
    ) -> tuple[Array, Array, tuple[Array, ...]]:
        """Cells with the closest points, these points, and ``Location.equal``: of cells no farther
        than ``bound`` those that differ by less than ``rounding``, and of these the first (all (n,)
        [length])."""
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
        foot = points_of(self.x, self.cells[cell], xi)[1]
        apart = np.linalg.norm(foot - foot[best][point], axis=1) > 10.0 * rounding[point]
        also = np.flatnonzero(((outside > 0.0) == (outside[best][point] > 0.0)) & apart)
        return cell[best], xi[best], (point[also], cell[also], xi[also])

    def around(self, cell: Array, xi: Array) -> tuple[Array, Array]:
        """Of points xi (n, d) on the sides of cells (n,): (n,) whether they lie on the rim, and
        (n, gdim) the sum of the unit normals of all cells that share them."""
        on = shape_functions(self.cells.shape[1], xi)[0] > EDGE
        count, (row, corner) = on.sum(axis=1), np.nonzero(on)
        node = self.cells[cell[row], corner]
        nodes = csr_matrix((np.ones(len(row)), (row, node)), (len(on), len(self.x)))
        found = (nodes @ facets_around(self.cells, len(self.x))).tocoo()
        shared = found.data == count[found.row]
        point, other = found.row[shared], found.col[shared]
        ends = np.isin(node[np.searchsorted(row, np.arange(len(on)))], outline_edges(self.cells))
        alone = np.bincount(point, minlength=len(on)) == 1
        normals = unit_normals(self.x, self.cells)[other]
        return np.where(count == 1, ends, alone), summing(point, len(on)) @ normals

    def _outside(self, offset: Array, cell: Array) -> Array:
        """Tangential distance from cells in units of their size, 0 inside."""
        outside = np.linalg.norm(offset, axis=1) / self._size[cell]
        outside[outside < 1e-11] = 0.0  # rounding of the coordinates
        return outside

    def _step(self, x: Array, cell: Array, xi: Array) -> tuple[Array, Array]:
        """Newton step towards the foot of points x, and how far it moves in space."""
        step, t, _ = self._newton(x, cell, xi)
        return step, np.einsum("na,nai->ni", step, t)

    def _newton(self, x: Array, cell: Array, xi: Array, inside: bool = False) -> tuple[Array, ...]:
        """Newton step towards the foot of points x, or the closest point inside the quad; tangents
        and position where it starts."""
        _, y, t = points_of(self.x, self.cells[cell], xi)
        JJ = np.einsum("nai,nbi->nab", t, t)
        rhs = np.einsum("nai,ni->na", t, x - y)
        if JJ.shape[1] == 1:
            return rhs / JJ[:, 0], t, y
        a, b, c = JJ[:, 0, 0], JJ[:, 0, 1], JJ[:, 1, 1]
        if inside:  # at a side that a point lies beyond, the other coordinate goes on alone
            b = np.where(((np.abs(xi) >= 1.0) & (xi * rhs > 0.0)).any(axis=1), 0.0, b)
        p, q = rhs.T
        adjugate = np.column_stack([c * p - b * q, a * q - b * p])
        return adjugate / np.maximum(a * c - b * b, 1e-300)[:, None], t, y

    @cached_property
    def _balls(self) -> tuple[Array, Array]:
        """Centroids (n_cells, gdim) and radii (n_cells,) of balls that hold the cells [length]."""
        corners = self.x[self.cells]
        centre = corners.mean(axis=1)
        return centre, np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)

    def _candidates(self, x: Array, bound: Array, rounding: Array) -> tuple[Array, Array]:
        """Pairs (point, cell) of all cells that may be as close as the bound: for points on the
        frame those whose ball holds them, for others what ball and plane of a cell leave."""
        centre, radius = self._balls
        on = np.flatnonzero(bound <= rounding)
        found = cKDTree(x[on]).query_ball_point(centre, radius + 2.0 * rounding.max())
        points, cells = [on[joined_lists(found)]], [repeated_for(np.arange(len(centre)), found)]
        if len(on) == len(x):
            return points[0], cells[0]
        normal = unit_normals(self.x, self.cells)
        corners = self.x[self.cells] - centre[:, None]
        warp = np.abs(np.einsum("cki,ci->ck", corners, normal)).max(axis=1)
        off, bound, tree = np.flatnonzero(bound > rounding), bound + rounding, cKDTree(centre)
        for some in np.array_split(off, len(off) // 1000 + 1):  # points far away have many cells
            found = tree.query_ball_point(x[some], bound[some] + radius.max())
            point, cell = repeated_for(some, found), joined_lists(found)
            d = x[point] - centre[cell]
            height = np.einsum("ni,ni->n", d, normal[cell])
            along = np.linalg.norm(d - height[:, None] * normal[cell], axis=1) - radius[cell]
            above = np.abs(height) - warp[cell]
            near = np.hypot(np.maximum(above, 0.0), np.maximum(along, 0.0)) <= bound[point]
            points.append(point[near])
            cells.append(cell[near])
        return np.concatenate(points), np.concatenate(cells)

    def _invert(self, x: Array, cell: Array) -> tuple[Array, Array]:
        """Reference coordinates of the closest point in a cell, and its distance [length]."""
        k = self.cells.shape[1]
        xi = np.full((len(x), 1 if k == 2 else 2), {2: 0.5, 3: 1.0 / 3.0, 4: 0.0}[k])
        active, y = np.arange(len(x)), np.empty(x.shape)
        for _ in range(2 if k < 4 else 20):
            step, _, y[active] = self._newton(x[active], cell[active], xi[active], inside=k == 4)
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
            xi[beyond] = closest_on_sides(self.x[self.cells[cell[beyond]]], x[beyond])
            active = np.append(active, beyond)
        if len(active):  # what has moved since
            y[active] = points_of(self.x, self.cells[cell[active]], xi[active])[1]
        return xi, np.linalg.norm(x - y, axis=1)

    def interpolation(self, at: Location, cells: Array, element: Element) -> csr_matrix:
        """(n, m) matrix of an element's shape functions at located points, of cells (n_cells, k)
        over nodes (m) whose corners these cells are; see ``Frame.interpolation``."""
        point, cell, xi = at.equal
        row, cell = np.append(np.arange(len(at.x)), point), np.append(at.cell, cell)
        xi = np.concatenate([at.xi, xi])
        inside = at.outside[row] == 0.0
        beyond = np.flatnonzero(~inside)
        known, c, z = row[inside], cell[inside], xi[inside]
        N, dN = element.shape(z)
        N += np.einsum("nkd,nd->nk", dN, self._step(at.x[known], c, z)[0])
        rows, columns, values = np.repeat(known, N.shape[1]), cells[c].ravel(), N.ravel()
        if len(beyond):
            place, nodes, continued = self._continued(
                cell[beyond], xi[beyond], at.x[row[beyond]], cells, element
            )
            rows = np.append(rows, row[beyond][place])
            columns, values = np.append(columns, nodes), np.append(values, continued)
        values = values / np.bincount(row)[rows]  # those as close: the same
        matrix = summed(values, rows, columns, (len(at.x), len(self.x)))
        if element.order > 1:
            matrix.data[np.abs(matrix.data) < UNFELT] = 0.0
            matrix.eliminate_zeros()
        return matrix

    def _continued(
        self, cell: Array, xi: Array, x: Array, cells: Array, element: Element
    ) -> tuple[Array, Array, Array]:
        """Shape functions at x (n, gdim) beyond the points xi of cells, continued from there by the
        gradients at the corners around, each the mean of those of its cells: one cell's alone would
        jump where the next one begins. Which of the n, nodes, and values, to be added up."""
        k, flat = self.cells.shape[1], self.cells.ravel()
        foot, y, _ = points_of(self.x, self.cells[cell], xi)
        point, corner = np.nonzero(foot > EDGE)
        node, share = self.cells[cell[point], corner], foot[point, corner]
        order = np.argsort(flat, kind="stable")
        first, last = (np.searchsorted(flat[order], node, side) for side in ("left", "right"))
        count = last - first
        pair = np.repeat(np.arange(len(node)), count)
        place = order[np.arange(len(pair)) + np.repeat(first - np.cumsum(count) + count, count)]
        around, at = place // k, CORNERS[k][place % k]
        step = self._step((x - y)[point[pair]] + self.x[node[pair]], around, at)[0]
        change = np.einsum("nkd,nd->nk", element.shape(at)[1], step)
        change *= (share / count)[pair][:, None]
        value = element.shape(xi)[0]
        there, own = np.nonzero(np.abs(value) > EDGE)
        return (
            np.append(np.repeat(point[pair], change.shape[1]), there),
            np.append(cells[around].ravel(), cells[cell[there], own]),
            np.append(change.ravel(), value[there, own]),
        )
