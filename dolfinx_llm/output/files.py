"""Bodies and interfaces as files for ParaView and spreadsheets, load steps as time series."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import dolfinx.fem
import dolfinx.io
import dolfinx.mesh
import numpy as np
from ufl.core.expr import Expr

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.parallel import check, collective
from dolfinx_llm.interface.forces import InterfaceForces
from dolfinx_llm.output.values import (
    cell_maximum,
    check_displacement,
    check_expression,
    check_result,
    vertex_function,
)
from dolfinx_llm.output.writing import writable_file, writable_folder, write_step, writing

SUFFIXES = (".xdmf", ".bp")


def write_csv(path: str | Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Table as CSV; call it on one rank.

    Args:
        path: file to write.
        header: names of the columns.
        rows: one sequence of values each.

    Raises:
        ContactInputError: rows of another length than the header, or a path that cannot be written.
    """
    names = checks.items("header", header, "give a list of names")
    table = [checks.items("rows: row", row, "give a list of values") for row in
             checks.items("rows", rows, "give a list of rows")]  # fmt: skip
    for i, row in enumerate(table):
        if len(row) != len(names):
            raise ContactInputError(f"rows: row {i} has {len(row)} values, header {len(names)}")
    file_path = writable_file("path", path)
    with writing(file_path), open(file_path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows(table)


def write_bodies(
    path: str | Path, u: dolfinx.fem.Function, cell_fields: dict[str, Expr] | None = None
) -> None:
    """Displacement and piecewise constant fields of one mesh, for ParaView. Collective.

    Args:
        path: file that ends on .xdmf (XDMF and HDF5), or on .bp (VTX, where dolfinx has ADIOS2);
            its folder is made.
        u: displacement Function.
        cell_fields: name to scalar UFL expression; in XDMF only.

    Raises:
        ContactInputError: another ending, or what VTX cannot hold or this dolfinx not write; a path
            that cannot be written; other types. On all ranks.
    """
    file = _BodyFile(path, u, {} if cell_fields is None else cell_fields)
    file.write(0.0)
    file.close()


class _BodyFile:
    """An open file of one mesh's fields: what they are now, step by step."""

    def __init__(self, given: str | Path, u: dolfinx.fem.Function, cell_fields: dict[str, Expr]):
        comm = check_displacement(u)
        with collective(comm):
            path = writable_file("path", given, SUFFIXES)
            _check_fields(cell_fields, u.function_space.mesh)
            if path.suffix == ".bp" and cell_fields:
                raise ContactInputError(f"{path}: cell_fields are for .xdmf; VTX holds one space")
            if path.suffix == ".xdmf" and path.with_suffix(".h5").is_dir():
                raise ContactInputError(f"{path} cannot be written: its .h5 is a folder")
        self._u, self._cell_fields = u, cell_fields
        self._drawn = u if path.suffix == ".bp" else vertex_function(u)
        self._drawn.name = "displacement"
        self._file: Any
        if path.suffix == ".xdmf":
            with writing(path):
                self._file = dolfinx.io.XDMFFile(comm, str(path), "w")
                self._file.write_mesh(u.function_space.mesh)
        else:
            with writing(path):
                self._file = compat.vtx_writer(comm, path, u)
            if self._file is None:
                raise ContactInputError(
                    f"{path}: this dolfinx {dolfinx.__version__} is built without ADIOS2, which "
                    "VTX needs. Write .xdmf instead"
                )
        self._is_vtx = path.suffix == ".bp"

    def write(self, time: float) -> None:
        if self._is_vtx:
            self._file.write(time)
            return
        if self._drawn is not self._u:
            self._drawn.interpolate(self._u)
        self._file.write_function(self._drawn, time)
        for name, expression in self._cell_fields.items():
            function = cell_maximum(expression, self._u.function_space.mesh)
            function.name = name
            self._file.write_function(function, time)

    def close(self) -> None:
        self._file.close()


def _check_fields(fields: Any, mesh: Any) -> None:
    """Require names of scalar expressions on a mesh."""
    accepted = 'give a dict of names and scalar UFL expressions, e.g. {"pressure": p}, or None'
    for name, expression in checks.instance("cell_fields", fields, dict, accepted).items():
        checks.instance("cell_fields: name", name, str, accepted)
        check_expression(expression, mesh, 2)


def interface_fields(
    result: InterfaceForces,
) -> dict[str, tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]]:
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
        fields = {"displacement": frame.v, **own, "status": result.frame_status.astype(float)}
        parts["frame"] = result.frame_drawn, frame.corners, fields
    for k, side in enumerate(result.sides):
        own_gap = {"frame_gap": side.frame_gap} if hasattr(side, "frame_gap") else {}
        there = np.isfinite(side.gap)  # inf cannot be written
        far = side.gap[there].max(initial=np.ptp(side.x, axis=0).sum())
        parts[f"side_{k}"] = side.drawn, side.facets, {
            "displacement": side.u,
            "force": side.force,
            "normal_force": side.normal_force,
            "gap": np.where(there, side.gap, far),
            **own_gap,
            "slip": side.slip,
            "status": side.status.astype(float),
            "area": side.area,
            **({} if result.frame is not None else own),
        }  # fmt: skip
    return parts


def write_interface(folder: str | Path, result: InterfaceForces) -> None:
    """Frame and sides with their fields as XDMF, for ParaView, and as CSV; call it on one rank.

    Writes frame.xdmf (displacement, pressure, traction, area, status) and per side side_0.xdmf,
    side_1.xdmf (displacement, force, normal force, gap, frame_gap, slip, status, area), a
    CSV beside each.

    Args:
        folder: where the files go; it is made.
        result: of a solve, ``problem.results[i]``.

    Raises:
        ContactInputError: result is none, or the folder cannot be written.
    """
    check_result(result)
    folder = writable_folder("folder", folder)
    parts = interface_fields(result)
    _write_parts(folder, parts, 0.0, append=False)
    for name, (x, _, fields) in parts.items():
        columns = {"x": x, **fields}
        header = [
            key if np.ndim(values) == 1 else f"{key}_{'xyz'[i]}"
            for key, values in columns.items()
            for i in range(1 if np.ndim(values) == 1 else values.shape[1])
        ]
        table = np.column_stack([np.asarray(v).reshape(len(x), -1) for v in columns.values()])
        write_csv(folder / f"{name}.csv", header, table.tolist())


def _write_parts(folder: Path, parts: dict[str, Any], time: float, append: bool) -> None:
    folder = writable_folder("folder", folder)
    for name, (x, cells, fields) in parts.items():
        path = folder / f"{name}.xdmf"
        with writing(path):
            write_step(path, time, x, cells, fields, append)


class LoadSteps:
    """Files of a problem's load steps, which ParaView opens as time series.

    bodies_0.xdmf ... of the meshes, as by ``write_bodies``, and in folders interface_0 ... the
    files of ``write_interface`` without its CSV. All calls are collective.

    Args:
        problem: the ``ContactProblem``, or the ``NonlinearContactProblem``.
        folder: where the files go; it is made.
        suffix: of the bodies' files: ".xdmf", or ".bp" for VTX.
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
        suffix: str = ".xdmf",
        cell_fields: Callable[[dolfinx.fem.Function], dict[str, Expr]] | None = None,
    ):
        if {"solve", "reset", "u"} - set(dir(type(problem))):
            checks.refuse("problem", problem, "give a ContactProblem")
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
        self._problem, self._steps, self._closed = problem, 0, False
        self._files: list[_BodyFile] = []
        for i, u in enumerate(self._u):
            self._files.append(_BodyFile(self._folder / f"bodies_{i}{suffix}", u, fields[i]))

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
            time = float(self._steps) if time is None else checks.number("time", time, accepted)
        u = self._problem.u
        solved = u if isinstance(u, list) else [u]
        for own, u, file in zip(self._u, solved, self._files, strict=True):
            own.x.array[:] = u.x.array
            file.write(time)
        with collective(comm):
            for i, result in enumerate(self._problem.results):
                parts, folder = interface_fields(result), self._folder / f"interface_{i}"
                if comm.rank == 0:
                    _write_parts(folder, parts, time, append=self._steps > 0)
        self._steps += 1

    def close(self) -> None:
        """Close the files; leaving a ``with`` block does so, too. May be called again."""
        for file in [] if self._closed else self._files:
            file.close()
        self._closed = True

    def __enter__(self) -> LoadSteps:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
