"""Bodies and interfaces as files for ParaView and spreadsheets, load steps as time series."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import dolfinx.fem
import dolfinx.io
import dolfinx.mesh
import numpy as np
from ufl.core.expr import Expr

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.parallel import check, collective
from dolfinx_llm.interface.forces import InterfaceForces
from dolfinx_llm.output.values import (
    cell_maximum,
    check_displacement,
    check_fields,
    check_problem,
    check_result,
    displacements,
    of_scalar,
)
from dolfinx_llm.output.writing import (
    VTK,
    Grid,
    open_series,
    surface_grid,
    writable_file,
    writable_folder,
    write_csv,
    write_grid,
    write_index,
)

SUFFIXES = (".pvd", ".bp", ".vtkhdf")


def write_bodies(
    path: str | Path,
    u: dolfinx.fem.Function | Sequence[dolfinx.fem.Function],
    cell_fields: dict[str, Expr] | Sequence[dict[str, Expr]] | None = None,
) -> None:
    """Displacement and piecewise constant fields of the bodies, for ParaView. Collective.

    Args:
        path: file that ends on .pvd: the index of VTU files beside it, one per step and rank, which
            hold all fields in one grid; or on .bp (VTX, where dolfinx has ADIOS2) or .vtkhdf (from
            dolfinx 0.10 on; at corners alone, as "u"). Its folder is made.
        u: displacement Function, or one of a mixed space, of which the displacement is written; of
            several meshes, in VTU only, a list of them.
        cell_fields: name to scalar UFL expression; in VTU only. Of several meshes a list of these.

    Raises:
        ContactInputError: another ending, or what a format cannot hold or this dolfinx not write; a
            path that cannot be written; other types. On all ranks.
    """
    several = isinstance(u, (list, tuple))
    motions: Any = displacements(u)
    fields: Any = [{}] * len(motions) if cell_fields is None else cell_fields
    file = _BodyFile(path, motions, fields if several or cell_fields is None else [fields])
    file.write(0.0)
    file.close()


class _BodyFile:
    """A series of the fields of one mesh or more: what they are now, step by step."""

    def __init__(self, given: str | Path, u: Sequence[Any], cell_fields: Sequence[dict[str, Expr]]):
        self._comm = [check_displacement(motion) for motion in u or [None]][0]
        with collective(self._comm):
            path = writable_file("path", given, SUFFIXES)
            wanted = "give a list with a dict for each mesh, or None"
            if len(checks.items("cell_fields", cell_fields, wanted)) != len(u):
                checks.refuse("cell_fields", cell_fields, wanted)
            for motion, fields in zip(u, cell_fields):
                check_fields(fields, motion.function_space.mesh)
            if path.suffix != ".pvd" and (len(u) > 1 or any(cell_fields)):
                raise ContactInputError(f"{path}: cell_fields and several meshes are for .pvd")
        self._parts, self._path = list(zip(u, cell_fields)), path
        self._steps: list[tuple[float, list[str]]] = []
        self._series: Any = None if path.suffix == ".pvd" else open_series(path, u[0])

    def write(self, time: float) -> None:
        if self._series is not None:
            self._series.write(time)
            return
        stem, names = f"{self._path.stem}_{len(self._steps)}", list[str]()
        for i, (u, cell_fields) in enumerate(self._parts):
            of = f"{stem}_{i}" if len(self._parts) > 1 else stem
            grid = _own_grid(u, cell_fields)
            filled = np.flatnonzero(self._comm.allgather(len(grid.cells) > 0))
            names += [f"{of}_{rank}.vtu" for rank in filled]
            with collective(self._comm):
                if len(grid.cells):
                    write_grid(self._path.with_name(f"{of}_{self._comm.rank}.vtu"), grid)
        self._steps.append((time, names))
        with collective(self._comm):
            if self._comm.rank == 0:
                write_index(self._path, self._steps)

    def close(self) -> None:
        if self._series is not None:
            self._series.close()


def _own_grid(u: dolfinx.fem.Function, cell_fields: dict[str, Expr]) -> Grid:
    """This rank's own cells with the nodes of the displacement; collective."""
    V, mesh = u.function_space, u.function_space.mesh
    gdim, tdim, k = mesh.geometry.dim, mesh.topology.dim, V.dofmap.index_map_bs
    dofs = compat.cell_dofs(V)[: mesh.topology.index_map(tdim).size_local]
    used, cells = np.unique(
        dofs[:, VTK[tdim, V.dofmap.dof_layout.num_dofs][1]], return_inverse=True
    )
    in_cells = {}
    for name, expression in cell_fields.items():
        found = cell_maximum(expression, mesh)
        in_cells[name] = found.x.array[compat.cell_dofs(found.function_space)[: len(dofs), 0]]
    nodal = u.x.array.reshape(-1, k)[used]
    motion = {"displacement": nodal} if k > 1 else {"u": nodal[:, 0]}
    x = V.tabulate_dof_coordinates()[used, :gdim]
    return Grid(x, cells.reshape(dofs.shape), tdim, motion, in_cells)


def interface_fields(
    result: InterfaceForces,
) -> dict[str, tuple[Array, Array, dict[str, Array]]]:
    """Points, cells and fields of the frame ("frame") and of each side ("side_0", "side_1").

    Against a rigid obstacle there is no frame; pressure and traction then stand with the side. A
    gap where there is nothing beyond, inf, is the largest of the others and the side's extent.

    Args:
        result: of a solve, ``problem.results[i]``.

    Returns:
        Name of a part to its points (n, gdim) [length], cells (m, k), and name to field (n,) or
        (n, gdim), with the units of ``SideResult`` and ``InterfaceResult``.

    Raises:
        ContactInputError: result is none.
    """
    check_result(result)
    parts: dict[str, Any] = {}
    own = {"pressure": result.pressure, "traction": result.traction, "area": result.frame_area}
    if result.frame is not None:
        frame = result.frame
        scalar = result.sides[0].u.shape[1] == 1
        motion = frame.v if scalar else result.deformed - result.frame_drawn
        fields = {"displacement": motion, **own, "status": result.frame_status.astype(float)}
        parts["frame"] = result.frame_drawn, frame.corners, fields
    for k, side in enumerate(result.sides):
        far = side.gap[np.isfinite(side.gap)].max(initial=np.ptp(side.x, axis=0).sum())
        gaps = {"gap": side.gap, "frame_gap": side.frame_gap}  # inf cannot be written
        gaps = {name: np.where(np.isfinite(gap), gap, far) for name, gap in gaps.items()}
        parts[f"side_{k}"] = side.drawn, side.facets, {
            "displacement": side.u,
            "force": side.force,
            "normal_force": side.normal_force,
            **gaps,
            "slip": side.slip,
            "status": side.status.astype(float),
            "area": side.area,
            **({} if result.frame is not None else own),
        }  # fmt: skip
    return of_scalar(parts) if result.sides[0].u.shape[1] == 1 else parts


def write_interface(folder: str | Path, result: InterfaceForces) -> None:
    """Frame and sides with their fields as VTU, for ParaView, and as CSV; call it on one rank.

    Writes frame.vtu (displacement, pressure, traction, area, status) and per side side_0.vtu,
    side_1.vtu (displacement, force, normal force, gap, frame_gap, slip, status, area), a
    CSV beside each.

    Args:
        folder: where the files go; it is made.
        result: of a solve, ``problem.results[i]``.

    Raises:
        ContactInputError: result is none, or the folder cannot be written.
    """
    check_result(result)
    folder = writable_folder("folder", folder)
    for name, (x, cells, fields) in interface_fields(result).items():
        write_grid(folder / f"{name}.vtu", surface_grid(x, cells, fields))
        columns = {"x": x, **fields}
        header = [
            key if np.ndim(values) == 1 else f"{key}_{'xyz'[i]}"
            for key, values in columns.items()
            for i in range(1 if np.ndim(values) == 1 else values.shape[1])
        ]
        table = np.column_stack([np.asarray(v).reshape(len(x), -1) for v in columns.values()])
        write_csv(folder / f"{name}.csv", header, table.tolist())


class LoadSteps:
    """Files of a problem's load steps, which ParaView opens as time series.

    bodies_0.pvd ... of the meshes, as by ``write_bodies``, and in folders interface_0 ... series
    frame.pvd, side_0.pvd, side_1.pvd of the files of ``write_interface``. All calls are collective.

    Args:
        problem: the ``ContactProblem``, or the ``NonlinearContactProblem``.
        folder: where the files go; it is made.
        suffix: of the bodies' files: ".pvd", or ".bp" for VTX, ".vtkhdf" for VTKHDF.
        cell_fields: makes of a mesh's displacement the fields of ``write_bodies``.

    Raises:
        ContactInputError: see ``write_bodies``.

    Example::

        with llm.post.LoadSteps(problem, "out") as files:
            for drag.value in (0.0, 0.001, 0.002):
                problem.solve()
                files.write()
    """

    def __init__(
        self,
        problem: Any,
        folder: str | Path,
        *,
        suffix: str = ".pvd",
        cell_fields: Callable[[dolfinx.fem.Function], dict[str, Expr]] | None = None,
    ):
        check_problem(problem)
        with collective(problem.comm):
            checks.one_of("suffix", suffix, SUFFIXES)
            self._folder = writable_folder("folder", folder)
            given: Any = cell_fields
            if not (given is None or callable(given)):
                accepted = "give a function of the displacement that returns a dict, or None"
                checks.refuse("cell_fields", cell_fields, accepted)
        self._u = [dolfinx.fem.Function(V) for V in problem.spaces]
        with collective(problem.comm):
            fields = [cell_fields(u) if cell_fields else {} for u in self._u]
        self._problem, self._times, self._closed = problem, list[float](), False
        self._files: list[_BodyFile] = []
        for i, u in enumerate(self._u):
            self._files.append(_BodyFile(self._folder / f"bodies_{i}{suffix}", [u], [fields[i]]))

    def write(self, time: float | None = None) -> None:
        """Add the last solve.

        Args:
            time: of the load step; None: its number, from 0 on.

        Raises:
            ContactInputError: time is no finite number; after ``close``.
            ContactError: nothing has been solved.
        """
        if not self._problem.results:
            raise ContactError("there is nothing to write yet: call solve() first")
        comm = self._problem.comm
        check(comm, self._closed, "these files are closed: make LoadSteps anew", ContactInputError)
        with collective(comm):
            accepted = "give a finite number or None"
            n = len(self._times)
            time = float(n) if time is None else checks.number("time", time, accepted)
        self._times.append(time)
        for own, u, file in zip(self._u, displacements(self._problem.u), self._files, strict=True):
            own.x.array[:] = u.x.array
            file.write(time)
        with collective(comm):
            for i, result in enumerate(self._problem.results):
                parts = interface_fields(result)
                if comm.rank == 0:
                    self._write_parts(
                        writable_folder("folder", self._folder / f"interface_{i}"), parts
                    )

    def _write_parts(self, folder: Path, parts: dict[str, Any]) -> None:
        """This step of an interface, and the index of all."""
        for name, part in parts.items():
            files = [f"{name}_{step}.vtu" for step in range(len(self._times))]
            write_grid(folder / files[-1], surface_grid(*part))
            steps = [(time, [file]) for time, file in zip(self._times, files, strict=True)]
            write_index(folder / f"{name}.pvd", steps)

    def close(self) -> None:
        """Close the files; leaving a ``with`` block does so, too. May be called again."""
        for file in [] if self._closed else self._files:
            file.close()
        self._closed = True

    def __enter__(self) -> LoadSteps:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
