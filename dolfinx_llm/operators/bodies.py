"""Connected bodies and their rigid motions."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.cells import connected, rigid_modes
from dolfinx_llm.geometry.pairs import control_points
from dolfinx_llm.geometry.surface import Surface

ALONG = 1e-2  # part of a rotation below which it counts as translation, of a screw as rotation
SHARED = 0.3  # mean square of what surfaces have of a direction, from which on bodies slide so


def body_labels(V: Any) -> tuple[Array, int]:
    """Number of the connected body of every local node of V (owned and ghost), and their count, by
    the mesh's connectivity on all ranks together."""
    comm, index_map = V.mesh.comm, V.dofmap.index_map
    n = index_map.size_local + index_map.num_ghosts
    part = connected(compat.cell_dofs(V), n)[1]
    number = index_map.local_to_global(np.arange(n, dtype=np.int32))
    label = _of_groups(np.maximum, number, part, part.max(initial=-1) + 1, -1)
    if comm.size > 1:
        label = _of_all_ranks(V, label, part)
    found = np.unique(np.concatenate(comm.allgather(np.unique(label))))
    return np.searchsorted(found, label[part]), len(found)


def _of_all_ranks(V: Any, label: Array, part: Array) -> Array:
    """Labels of this rank's parts, the same where they hang together by other ranks' nodes."""
    vector = compat.ghosted_vector(V, 1)
    while True:  # as many rounds as ranks a body winds through
        with vector.localForm() as local:
            local.array_w[:] = label[part]
        vector.ghostUpdate(addv=PETSc.InsertMode.MAX_VALUES, mode=PETSc.ScatterMode.REVERSE)
        vector.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        with vector.localForm() as local:
            seen = local.array_r.astype(np.int64)
        before = label.copy()
        np.maximum.at(label, part, seen)
        if not V.mesh.comm.allreduce(int((label != before).sum())):
            vector.destroy()
            return label


def _of_groups(extreme: Any, values: Array, group: Array, count: int, none: float) -> Array:
    """(count, ...) largest or smallest values (n, ...) of each group (n,), ``none`` where it is
    empty; ``at`` of NumPy's functions takes many times as long."""
    found = np.full((count, *values.shape[1:]), none, dtype=values.dtype)
    size = np.bincount(group, minlength=count)
    there, ends = np.flatnonzero(size), np.cumsum(size)
    if len(there):
        order = np.argsort(group, kind="stable")
        found[there] = extreme.reduceat(values[order], (ends - size)[there])
    return found


def sliding_ways(normals: Array) -> Array:
    """(gdim, k) directions in which surfaces with unit normals (n, gdim) let bodies slide."""
    share, ways = np.linalg.eigh(np.eye(normals.shape[1]) - normals.T @ normals / len(normals))
    return np.asarray(ways[:, share > SHARED])


def two_sides(count: int, tied: Array, meet: Array) -> Array:
    """(count,) 1 or -1 for each body: bodies that are tied are on one side, bodies that meet on
    both, as far as there are two sides to all of it.

    Args:
        count: of the bodies.
        tied: (t, 2) bodies that are tied to each other.
        meet: (k, 2) bodies that slide on each other.
    """

    def graph(ends: Array) -> csr_matrix:
        return csr_matrix((np.ones(len(ends)), tuple(ends.T)), (count, count))

    _, group = connected_components(graph(tied), directed=False)
    between, side = graph(group[meet]), np.zeros(count)
    for first in range(count):
        if side[first] == 0.0:
            side[first] = 1.0
            order, before = breadth_first_order(between, first, directed=False)
            for body in order[1:]:
                side[body] = -side[before[body]]
    return np.asarray(side[group])


class Bodies:
    """Connected bodies of the meshes of function spaces and the rigid motions of each; of a scalar
    field, in the place of these, its constants.

    Args:
        spaces: of the displacements, or of the field.
        dofs: (nodes gdim,) this rank's dofs that these are; None: all, one after the other.
        controlled: (space, surface) of second order whose unknowns are control values: a rotation
            moves control points, which are off the surface where facets are curved.
    """

    def __init__(
        self,
        spaces: Sequence[Any],
        dofs: Array | None = None,
        controlled: Sequence[tuple[int, Surface]] = (),
    ) -> None:
        self.comm = spaces[0].mesh.comm
        self.gdim = spaces[0].mesh.geometry.dim
        self.components = spaces[0].dofmap.index_map_bs
        self.ways = 1 if self.components == 1 else 3 * (self.gdim - 1)
        labels, points, first = [], [], 0
        for V in spaces:
            label, count = body_labels(V)
            n = V.dofmap.index_map.size_local
            labels.append(label[:n] + first)
            points.append(V.tabulate_dof_coordinates()[:n, : self.gdim])
            first += count
        self.count = first
        label, x = np.concatenate(labels), np.concatenate(points)
        low, high = (
            extreme.reduce(self.comm.allgather(_of_groups(extreme, x, label, first, none)), axis=0)
            for extreme, none in ((np.minimum, np.inf), (np.maximum, -np.inf))
        )
        # Numbered by position, so that messages do not depend on the number of ranks.
        order = np.lexsort(np.concatenate([high.T[::-1], low.T[::-1]]).round(12))
        self.low, self.high = low[order], high[order]
        self.farthest = float(max(np.abs(low).max(), np.abs(high).max()))
        self.label, self.points = np.argsort(order)[label], x
        sizes = [V.dofmap.index_map.size_local for V in spaces]
        for space, surface in controlled:
            mine = surface.owner == self.comm.rank
            start = sum(sizes[:space]) - spaces[space].dofmap.index_map.local_range[0]
            self.points[surface.dofs[mine] + start] = control_points(surface)[mine]
        self.dofs = np.arange(len(x) * self.components) if dofs is None else dofs

    def own_modes(self, label: Array, x: Array) -> Array:
        """(n, components, modes per body) rigid motions of each point's own body, about the body's
        centre, rotations scaled to size 1."""
        centre, size = 0.5 * (self.low + self.high), np.linalg.norm(self.high - self.low, axis=1)
        return rigid_modes(2.0 * (x - centre[label]) / size[label, None], self.components)

    def modes(self, label: Array, x: Array) -> Array:
        """(n, components, bodies, modes per body) the same, zero for the other bodies' motions."""
        modes = np.zeros((len(x), self.components, self.count, self.ways))
        modes[np.arange(len(x)), :, label] = self.own_modes(label, x)
        return modes

    def name(self, body: int) -> str:
        low, high = (checks.place(x[body]) for x in (self.low, self.high))
        return f"body {body} (from {low} to {high})"

    def motion(self, body: int, amounts: Array, work: float) -> str:
        """Words for a rigid motion of a body, (3 or 6,) amounts of those of ``own_modes``, and for
        the force or moment that does this work along it [force length]."""
        low, high, gdim = self.low[body], self.high[body], self.gdim
        if self.components == 1:
            return f"{self.name(body)}: all of it alike, flow into it {abs(work / amounts[0]):.3g}"
        centre, size = 0.5 * (low + high), np.linalg.norm(high - low)
        shift, turn = amounts[:gdim], 2.0 / size * amounts[gdim:]
        if gdim == 2:
            shift, centre, turn = np.append(shift, 0.0), np.append(centre, 0.0), [0.0, 0.0, turn[0]]
        else:
            turn = turn[[1, 2, 0]]  # from the planes xy, yz, zx
        rate = np.linalg.norm(turn)
        if 0.5 * size * rate <= ALONG * np.linalg.norm(shift):
            length = np.linalg.norm(shift)
            words = f"a translation along {_listed(shift[:gdim] / length)}"
            return f"{self.name(body)}: {words}, force along it {abs(work) / length:.3g}"
        about = centre + np.cross(turn, shift) / rate**2
        words = f"a rotation about {_listed(about[:gdim])}"
        if gdim == 3:
            words += f" and the axis {_listed(turn / rate)}"
            along = turn @ shift / rate**2
            if abs(along) > ALONG * size:
                words += f", with a shift of {along:.3g} along it per radian"
        return f"{self.name(body)}: {words}, moment about it {abs(work) / rate:.3g}"


def _listed(values: Array) -> list[float]:
    """Three digits each, without those below a thousandth of the largest."""
    size = np.abs(values).max()
    return [float(f"{v:.3g}") if abs(v) > 1e-3 * size else 0.0 for v in values]
