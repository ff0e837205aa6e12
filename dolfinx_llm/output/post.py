"""Derived quantities, tables and files."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import dolfinx.fem
import dolfinx.io
import dolfinx.mesh
import numpy as np
import ufl
from ufl.core.expr import Expr

from dolfinx_llm.base import compat
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.contact.results import InterfaceResult
from dolfinx_llm.output.xdmf import write_step


def von_mises(sigma: Expr) -> Expr:
    """UFL expression of the von Mises stress, sqrt(3/2 s:s) of the deviator s [force / area].

    Args:
        sigma: (3, 3) UFL expression of the stress [force / area].
    """
    s = sigma - ufl.tr(sigma) / 3 * ufl.Identity(3)
    return ufl.sqrt(1.5 * ufl.inner(s, s))


def at_quadrature_points(expression: Expr, mesh: dolfinx.mesh.Mesh, degree: int = 2) -> np.ndarray:
    """Values of a scalar UFL expression at the quadrature points of this rank's cells.

    Args:
        expression: scalar UFL expression.
        mesh: the mesh that it lives on.
        degree: of the quadrature.

    Returns:
        (n_cells, n_points).
    """
    return compat.evaluate(expression, compat.quadrature_points(mesh, degree), mesh)


def write_csv(path: str | Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Table as CSV; call it on one rank.

    Args:
        path: file to write.
        header: names of the columns.
        rows: one sequence of values each.
    """
    with open(Path(path), "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)


def cell_maximum(
    expression: Expr, mesh: dolfinx.mesh.Mesh, degree: int = 2
) -> dolfinx.fem.Function:
    """Largest value of a scalar UFL expression per cell, as a piecewise constant Function.

    Args:
        expression: scalar UFL expression.
        mesh: the mesh that it lives on.
        degree: of the quadrature, at whose points the expression is evaluated.
    """
    V = compat.function_space(mesh, "DG", 0)
    function = dolfinx.fem.Function(V)
    values = at_quadrature_points(expression, mesh, degree)
    function.x.array[compat.cell_dofs(V)[: len(values), 0]] = values.max(axis=1)
    function.x.scatter_forward()
    return function


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
        ContactInputError: another ending, or what VTX cannot hold or this dolfinx not write.
    """
    file = _BodyFile(Path(path), u, cell_fields or {})
    file.write(0.0)
    file.close()


class _BodyFile:
    """An open file of one mesh's fields: what they are now, step by step."""

    def __init__(self, path: Path, u: dolfinx.fem.Function, cell_fields: dict[str, Expr]):
        self._u, self._cell_fields = u, cell_fields
        comm, u.name = u.function_space.mesh.comm, "displacement"
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file: Any
        if path.suffix == ".xdmf":
            self._file = dolfinx.io.XDMFFile(comm, str(path), "w")
            self._file.write_mesh(u.function_space.mesh)
        elif path.suffix != ".bp":
            raise ContactInputError(f"{path}: the file must end on .xdmf or .bp")
        elif cell_fields:
            raise ContactInputError(f"{path}: cell_fields are for .xdmf; VTX holds one space")
        else:
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
        self._file.write_function(self._u, time)
        for name, expression in self._cell_fields.items():
            function = cell_maximum(expression, self._u.function_space.mesh)
            function.name = name
            self._file.write_function(function, time)

    def close(self) -> None:
        self._file.close()


def interface_fields(
    result: InterfaceResult,
) -> dict[str, tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]]:
    """Points, cells and fields of the frame ("frame") and of each side ("side_0", "side_1").

    Against a rigid obstacle there is no frame; pressure and traction then stand with the side.

    Args:
        result: of a solve, ``problem.results[i]``.

    Returns:
        Name of a part to its points (n, gdim) [length], cells (m, k), and name to field (n,) or
        (n, gdim), with the units of ``SideResult`` and ``InterfaceResult``.
    """
    parts: dict[str, Any] = {}
    own = {"pressure": result.pressure, "traction": result.traction, "area": result.frame_area}
    if result.frame is not None:
        frame = result.frame
        fields = {"displacement": frame.v, **own, "status": result.frame_status.astype(float)}
        parts["frame"] = frame.x, frame.cells, fields
    for k, side in enumerate(result.sides):
        parts[f"side_{k}"] = side.x, side.facets, {
            "displacement": side.u,
            "force": side.force,
            "normal_force": side.normal_force,
            "gap": side.gap,
            "slip": side.slip,
            "status": side.status.astype(float),
            "area": side.area,
            **({} if result.frame is not None else own),
        }  # fmt: skip
    return parts


def write_interface(folder: str | Path, result: InterfaceResult) -> None:
    """Frame and sides with their fields as XDMF, for ParaView, and as CSV; call it on one rank.

    Writes frame.xdmf (displacement, pressure, traction, area, status) and per side side_0.xdmf,
    side_1.xdmf (displacement, force, normal force, gap, slip, status, area), a CSV beside each.

    Args:
        folder: where the files go; it is made.
        result: of a solve, ``problem.results[i]``.
    """
    folder = Path(folder)
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
    folder.mkdir(parents=True, exist_ok=True)
    for name, (x, cells, fields) in parts.items():
        write_step(folder / f"{name}.xdmf", time, x, cells, fields, append)


class LoadSteps:
    """Files of a problem's load steps, which ParaView opens as time series.

    bodies_0.xdmf ... of the meshes, as by ``write_bodies``, and in folders interface_0 ... the
    files of ``write_interface`` without its CSV. All calls are collective.

    Args:
        problem: the ``ContactProblem``.
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
        self._problem, self._folder, self._steps = problem, Path(folder), 0
        self._u = [dolfinx.fem.Function(V) for V in problem.spaces]
        self._files = []
        for i, u in enumerate(self._u):
            path = self._folder / f"bodies_{i}{suffix}"
            self._files.append(_BodyFile(path, u, cell_fields(u) if cell_fields else {}))

    def write(self, time: float | None = None) -> None:
        """Add the last solve.

        Args:
            time: of the load step; None: its number, from 0 on.

        Raises:
            ContactError: nothing has been solved.
        """
        if not self._problem.results:
            raise ContactError("there is nothing to write yet: call solve() first")
        time = float(self._steps if time is None else time)
        u = self._problem.u
        solved = u if isinstance(u, list) else [u]
        for own, u, file in zip(self._u, solved, self._files, strict=True):
            own.x.array[:] = u.x.array
            file.write(time)
        with collective(self._problem.comm):
            for i, result in enumerate(self._problem.results):
                parts, folder = interface_fields(result), self._folder / f"interface_{i}"
                if self._problem.comm.rank == 0:
                    _write_parts(folder, parts, time, append=self._steps > 0)
        self._steps += 1

    def close(self) -> None:
        """Close the files; leaving a ``with`` block does so, too."""
        for file in self._files:
            file.close()

    def __enter__(self) -> LoadSteps:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
