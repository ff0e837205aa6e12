"""Derived quantities, tables and files."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import dolfinx.fem
import dolfinx.io
import dolfinx.mesh
import numpy as np
import ufl
from ufl.core.expr import Expr

from dolfinx_llm import compat
from dolfinx_llm.results import InterfaceResult


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
    """Displacement and piecewise constant fields of one mesh as XDMF, for ParaView. Collective.

    Args:
        path: file that ends on .xdmf; its folder is made.
        u: displacement Function.
        cell_fields: name to scalar UFL expression.
    """
    path, mesh = Path(path), u.function_space.mesh
    path.parent.mkdir(parents=True, exist_ok=True)
    with dolfinx.io.XDMFFile(mesh.comm, str(path), "w") as file:
        file.write_mesh(mesh)
        u.name = "displacement"
        file.write_function(u)
        for name, expression in (cell_fields or {}).items():
            function = cell_maximum(expression, mesh)
            function.name = name
            file.write_function(function)


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
    """Frame and sides as VTK polydata with their fields, and as CSV; call it on one rank.

    Writes frame.vtk (displacement, pressure, traction, status) and per side side_0.vtk, side_1.vtk
    (displacement, force, normal force, gap, slip, status, area), with a CSV beside each.

    Args:
        folder: where the files go; it is made.
        result: of a solve, ``problem.results[i]``.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name, (x, cells, fields) in interface_fields(result).items():
        _write_vtk(folder / f"{name}.vtk", x, cells, fields)
        columns = {"x": x, **fields}
        header = [
            key if np.ndim(values) == 1 else f"{key}_{'xyz'[i]}"
            for key, values in columns.items()
            for i in range(1 if np.ndim(values) == 1 else values.shape[1])
        ]
        table = np.column_stack([np.asarray(v).reshape(len(x), -1) for v in columns.values()])
        write_csv(folder / f"{name}.csv", header, table.tolist())


def _write_vtk(path: Path, x: np.ndarray, cells: np.ndarray, fields: dict) -> None:
    """Legacy VTK polydata in ASCII with fields at the points."""

    def three(values):
        return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))

    kind = {1: "VERTICES", 2: "LINES"}.get(cells.shape[1], "POLYGONS")
    with open(path, "w", encoding="ascii") as file:
        file.write("# vtk DataFile Version 3.0\ndolfinx_llm\nASCII\nDATASET POLYDATA\n")
        file.write(f"POINTS {len(x)} double\n")
        np.savetxt(file, three(x), fmt="%.16g")
        file.write(f"{kind} {len(cells)} {cells.size + len(cells)}\n")
        np.savetxt(file, np.column_stack([np.full(len(cells), cells.shape[1]), cells]), fmt="%d")
        file.write(f"POINT_DATA {len(x)}\n")
        for name, values in fields.items():
            if values.ndim == 2:
                file.write(f"VECTORS {name} double\n")
                np.savetxt(file, three(values), fmt="%.16g")
            else:
                file.write(f"SCALARS {name} double 1\nLOOKUP_TABLE default\n")
                np.savetxt(file, values, fmt="%.16g")
