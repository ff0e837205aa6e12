"""Surfaces of bodies, gathered, and the scenes that are drawn of them: deformed, coloured by a
scalar or, translucent, around the surfaces in contact with their pressure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import ufl
from dolfinx.fem import Function
from dolfinx.mesh import exterior_facet_indices
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.geometry.cells import unit_normals
from dolfinx_llm.geometry.element import element_of
from dolfinx_llm.geometry.spaces import is_scalar
from dolfinx_llm.geometry.surface import facet_nodes
from dolfinx_llm.interface.forces import InterfaceForces
from dolfinx_llm.output.render import ABOVE, STATUS, Scene
from dolfinx_llm.output.values import cell_maximum

ON_CONTACT = ("pressure", "status")  # colours of surfaces in contact
COLOURS = (*ON_CONTACT, "displacement")  # of bodies
EDGE_COSINE = 0.86  # of the angle between facets from which the edge between is an outline
Plane3 = tuple[Array, Array]  # a point and a normal


@dataclass(frozen=True, eq=False)
class Skin:
    """Polygons of a body's outside, in 2D its cells."""

    x: Array  # (n, k, gdim) corners as drawn [length]
    u: Array  # (n, k, gdim) their displacement [length]
    nodes: Array  # (n, k) their numbers
    values: Array  # (n,) of the cell


def skin(u: Function, field: Function | None = None, section: Plane3 | None = None) -> Skin:
    """This rank's outer facets (cells in 2D); of a section those of the cells whose middle lies
    behind the plane."""
    V, mesh = u.function_space, u.function_space.mesh
    tdim, gdim = mesh.topology.dim, mesh.geometry.dim
    dofs, x = compat.cell_dofs(V), V.tabulate_dof_coordinates()[:, :gdim]
    n_owned = mesh.topology.index_map(tdim).size_local
    if tdim == 2:
        order = [0, 1, 2] if V.dofmap.dof_layout.num_dofs in (3, 6) else [0, 1, 3, 2]
        nodes, cells = dofs[:n_owned][:, order], np.arange(n_owned)
    else:
        facets, cells = _outer(mesh, x[dofs], section)
        told, corners = facet_nodes(V, facets)
        corners = corners[:, : element_of(2, corners.shape[1]).corners]
        nodes = dofs[told[:, None], corners][cells < n_owned]
        cells = cells[cells < n_owned]
    values = np.zeros(len(cells))
    if field is not None:
        values = field.x.array[compat.cell_dofs(field.function_space)[cells, 0]]
    numbers = V.dofmap.index_map.local_to_global(nodes.ravel().astype(np.int32))
    motion = u.x.array.reshape(-1, V.dofmap.index_map_bs)
    if is_scalar(V):  # nothing moves
        motion = np.zeros((len(motion), gdim))
    return Skin(x[nodes], motion[nodes], np.reshape(numbers, nodes.shape), values)


def _outer(mesh: Any, x: Array, section: Plane3 | None) -> tuple[Array, Array]:
    """Facets with one cell that is shown, and that cell; x (cells, k, 3) are the cells' nodes."""
    mesh.topology.create_connectivity(2, 3)
    mesh.topology.create_connectivity(3, 2)
    facets = exterior_facet_indices(mesh.topology)
    to_cell = mesh.topology.connectivity(2, 3)
    first = to_cell.array[to_cell.offsets[facets]]
    if section is None:
        return facets, first
    point, normal = section
    shown = (x.mean(axis=1) - point) @ normal <= 0.0
    inner = np.flatnonzero(np.diff(to_cell.offsets) == 2).astype(np.int32)
    pairs = to_cell.array[to_cell.offsets[inner][:, None] + np.arange(2)]
    cut = shown[pairs[:, 0]] != shown[pairs[:, 1]]
    behind = np.where(shown[pairs[:, 0]], pairs[:, 0], pairs[:, 1])
    facets = np.concatenate([facets[shown[first]], inner[cut]])
    return facets, np.concatenate([first[shown[first]], behind[cut]])


def checked_view(colour: Any, scale: Any, section: Any, gdim: int, label: str = "") -> View:
    """A view, if it is one."""
    if callable(colour):
        name = getattr(colour, "__name__", "<lambda>").replace("_", " ")
        label = label or ("value" if name == "<lambda>" else name)
    else:
        names = {"displacement": "length of u"}
        label = names.get(checks.one_of("colour", colour, COLOURS), colour)
    if scale is not None:
        scale = checks.number("scale", scale, "give a finite number or None")
    if section is not None:
        accepted = "give (point, normal) of a plane in 3D, or None"
        given = checks.items("section", section, accepted)
        if len(given) != 2 or gdim != 3:
            checks.refuse("section", section, accepted)
        point, normal = (checks.array("section", value, (3,), accepted) for value in given)
        section = point, normal
    return View(colour, label, scale, section)


def gather(
    comm: MPI.Comm, u: Sequence[Function], fields: Sequence[Function | None], section: Plane3 | None
) -> list[Skin] | None:
    """The skin of every mesh, on rank 0; collective."""
    found = []
    for motion, field in zip(u, fields, strict=True):
        own = skin(motion, field, section)
        parts = comm.gather((own.x, own.u, own.nodes, own.values), root=0)
        if parts is not None:
            found.append(Skin(*(np.concatenate(part) for part in zip(*parts))))
    return found if comm.rank == 0 else None


def suited_scale(skins: Sequence[Skin]) -> float:
    """Factor by which the largest displacement is a twentieth of the size, or 1."""
    x = np.concatenate([s.x.reshape(-1, s.x.shape[2]) for s in skins])
    size = np.ptp(x, axis=0).max() if len(x) else 0.0
    motion = max(np.abs(s.u).max(initial=0.0) for s in skins)
    return 1.0 if motion > 0.02 * size or motion == 0.0 else float(0.05 * size / motion)


def outline(skins: Sequence[Skin]) -> Array:
    """(m, 2, gdim) edges of the bodies as drawn: of one facet alone, or between facets that stand
    at an angle."""
    found = []
    for s in skins:
        n, k, gdim = s.x.shape
        ends = np.stack([s.nodes, np.roll(s.nodes, -1, axis=1)], axis=-1).reshape(-1, 2)
        x = np.stack([s.x, np.roll(s.x, -1, axis=1)], axis=2).reshape(-1, 2, gdim)
        _, first, edge, count = np.unique(
            np.sort(ends, axis=1),
            axis=0,
            return_index=True,
            return_inverse=True,
            return_counts=True,
        )
        bent = count == 1
        if gdim == 3:
            cells = np.arange(n * k).reshape(n, k)
            normals = np.repeat(unit_normals(s.x.reshape(-1, 3), cells), k, axis=0)
            sums = np.zeros((len(first), 3, 3))
            np.add.at(sums, edge.ravel(), normals[:, :, None] * normals[:, None, :])
            # Facets turn either way round: |n1 n1ᵀ + n2 n2ᵀ|² = 2 + 2 (n1·n2)²
            bent |= np.sum(sums**2, axis=(1, 2)) < 2.0 + 2.0 * EDGE_COSINE**2
        found.append(x[first[bent]])
    return np.concatenate(found)


def polygons(skins: Sequence[Skin], scale: float) -> Array:
    """(n, k, gdim) deformed facets of all bodies; triangles among quads repeat
    their last corner."""
    k = max(s.x.shape[1] for s in skins)
    moved = [s.x + scale * s.u for s in skins]
    return np.concatenate([m[:, [*range(m.shape[1]), *[-1] * (k - m.shape[1])]] for m in moved])


@dataclass(frozen=True, eq=False)
class View:
    """What a picture of bodies shows."""

    colour: Any  # one of COLOURS, or a function that makes a scalar of a mesh's displacement
    label: str  # of the colours
    scale: float | None  # factor on the displacement; None: one that suits
    section: Plane3 | None  # cells in front of it are left out
    moved: bool = True  # bodies are; not by a scalar field

    def seen(
        self, comm: MPI.Comm, u: Sequence[Function], results: Sequence[InterfaceForces]
    ) -> Seen | None:
        """What is there now, on rank 0; collective."""
        fields: list[Function | None] = [None] * len(u)
        if self.colour not in ON_CONTACT:
            with collective(comm):
                make = self.colour if callable(self.colour) else length
                expressions = [make(motion) for motion in u]
            fields = [cell_maximum(e, m.function_space.mesh) for e, m in zip(expressions, u)]
        skins = gather(comm, u, fields, self.section)
        view = self
        if is_scalar(u[0].function_space):
            names = {"length of u": "u", "pressure": "flux"}
            view = replace(self, label=names.get(self.label, self.label), moved=False)
        return None if skins is None else Seen(view, skins, list(results))


@dataclass(frozen=True, eq=False)
class Seen:
    """Bodies and interfaces of a load step, to be drawn."""

    view: View
    skins: list[Skin]
    results: list[InterfaceForces]

    def scene(self, scale: float | None = None) -> Scene:
        """Deformed bodies in colours, or translucent around the pressure."""
        chosen = self.view.scale if scale is None else scale
        scale = suited_scale(self.skins) if chosen is None else chosen
        pressed = self.view.colour in ON_CONTACT
        surface = _pressures(self.results, scale) if pressed else _values(self.skins, scale)
        points, cells, values, status = surface
        low, high = values.min(initial=0.0 if pressed else np.inf), values.max()
        if high - low < 1e-6 * max(abs(high), 1e-300):  # constant: do not paint rounding
            low, high = low - 0.5 * abs(low), high + 0.5 * abs(high) + 1e-300
        told, named = f" ({values.min():.6g} to {values.max():.6g})", None
        if self.view.colour == "status":
            values, named, told = commonest(status[cells]), np.array(list(STATUS)), ""
        return Scene(
            points,
            cells,
            values,
            (low, high),
            f"{self.view.label}{told}" + f"; displacement × {scale:.3g}" * self.view.moved,
            seen_from=ABOVE if self.view.section is None else _onto(self.view.section[1]),
            named=named,
            status=status,
            outline=outline(self.skins) if self.view.section is None else None,
            body=polygons(self.skins, scale) if pressed else None,
        )


def _onto(normal: Array) -> Array:
    """(3,) from where a section of this normal is seen, half from the side."""
    n = normal / np.linalg.norm(normal)
    aside = np.array(ABOVE) - (n @ ABOVE) * n
    return n + 0.9 * aside / max(np.linalg.norm(aside), 0.1)


def length(u: Function) -> Expr:
    """Length of the displacement; a scalar field itself."""
    return ufl.sqrt(ufl.inner(u, u)) if u.ufl_shape else 1.0 * u


def _values(skins: Sequence[Skin], scale: float) -> tuple[Any, ...]:
    """Points, cells and values of the bodies' facets."""
    at = polygons(skins, scale)
    cells = np.arange(at.shape[0] * at.shape[1]).reshape(at.shape[:2])
    return at.reshape(-1, at.shape[2]), cells, np.concatenate([s.values for s in skins]), None


def _pressures(results: Sequence[InterfaceForces], scale: float) -> tuple[Any, ...]:
    """Points, cells, pressure and status of all surfaces in contact: of frames, or of the bodies on
    rigid obstacles. Where several interfaces have a surface in common, that with most pressure."""
    points, cells, start = [], [], 0
    surfaces = [
        (r.sides[0].drawn, r.sides[0].facets)
        if r.frame is None
        else (r.frame_drawn, r.frame.corners)
        for r in results
    ]
    k = max(corners.shape[1] for _, corners in surfaces)
    for result, (drawn, corners) in zip(results, surfaces, strict=True):
        points.append(result.moved(scale))
        c = corners.shape[1]
        cells.append(start + corners[:, [*range(c), *[-1] * (k - c)]])
        start += len(drawn)
    pressure, status = (
        np.concatenate([getattr(result, name) for result in results])
        for name in ("pressure", "frame_status")
    )
    every = np.concatenate(cells)
    middles = np.concatenate([drawn[corners].mean(axis=1) for drawn, corners in surfaces])
    most = np.argsort(-pressure[every].max(axis=1), kind="stable")
    size = np.ptp(middles, axis=0).max() or 1.0
    _, first = np.unique(np.round(middles[most] / size, 9), axis=0, return_index=True)
    shown = every[np.sort(most[first])]
    status = status.copy()
    status[np.setdiff1d(every, shown)] = -1  # no mark
    return np.concatenate(points), shown, pressure, status


def commonest(marks: Array) -> Array:
    """(m,) the mark that most corners of each cell (m, k) have, of equals the largest."""
    counts = (marks[:, :, None] == np.arange(len(STATUS))).sum(axis=1)
    return counts.shape[1] - 1.0 - np.argmax(counts[:, ::-1], axis=1)
