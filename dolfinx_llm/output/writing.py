"""Where files go, errors of writing them, and grids with fields as VTU, which ParaView, PyVista and
meshio read, with an index of their steps (PVD): without a library. Series in dolfinx's own formats,
VTX and VTKHDF. Tables as CSV."""

from __future__ import annotations

import base64
import csv
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import dolfinx
import dolfinx.fem
import numpy as np

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError

# VTK's type of cells, by dimension and number of nodes, and its order of dolfinx's nodes.
VTK = {
    (0, 1): (1, [0]),
    (1, 2): (3, [0, 1]),
    (2, 3): (5, [0, 1, 2]),
    (2, 4): (9, [0, 1, 3, 2]),
    (2, 6): (22, [0, 1, 2, 5, 3, 4]),
    (2, 9): (28, [0, 1, 3, 2, 4, 6, 7, 5, 8]),
    (3, 4): (10, [0, 1, 2, 3]),
    (3, 8): (12, [0, 1, 3, 2, 4, 5, 7, 6]),
    (3, 10): (24, [0, 1, 2, 3, 9, 6, 8, 7, 5, 4]),
    (3, 27): (
        29,
        [0, 1, 3, 2, 4, 5, 7, 6, 8, 11, 13, 9, 16, 18, 19, 17, 10, 12, 15, 14]
        + [22, 23, 21, 24, 20, 25, 26],
    ),
}


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells of one kind with fields."""

    x: Array  # (n, gdim) nodes [length]
    cells: Array  # (m, k) their nodes, in VTK's order
    dimension: int  # of the cells
    at_nodes: dict[str, Array]  # (n,) or (n, gdim)
    in_cells: dict[str, Array]  # (m,)


def surface_grid(x: Array, cells: Array, fields: dict[str, Array]) -> Grid:
    """Nodes (n, gdim), corners (m, k) of facets, which go round as VTK's do, fields at nodes."""
    dimension = {1: 0, 2: 1}.get(cells.shape[1], 2)
    return Grid(x, cells, dimension, fields, {})


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Says where something could not be written: by the operating system, HDF5 or Matplotlib."""
    try:
        yield
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, ContactInputError):
            raise
        words = getattr(error, "strerror", None) or " ".join(str(error).split())[:200]
        raise ContactInputError(
            f"{path} cannot be written: {words}. Give a path in a folder that can be made and "
            "written"
        ) from error


def writable_folder(name: str, value: Any) -> Path:
    """A folder, made where it is missing, in which files can be written, also from another working
    directory. Every rank may call it by itself: all find the same."""
    folder = checks.path(name, value).absolute()
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(13, "no permission", str(folder))
    return folder


def writable_file(name: str, value: Any, endings: tuple[str, ...] = ()) -> Path:
    """A file that can be written, in a folder that is made, with one of the endings, if any is
    asked for."""
    path = checks.path(name, value).absolute()
    if endings and path.suffix not in endings:
        raise ContactInputError(f"{path}: the file must end on {' or '.join(endings)}")
    writable_folder(name, path.parent)
    with writing(path):
        if path.is_dir() and path.suffix != ".bp":  # which is a folder
            raise IsADirectoryError(21, "is a folder", str(path))
        if path.exists() and not os.access(path, os.W_OK):
            raise PermissionError(13, "no permission", str(path))
    return path


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


def write_grid(path: Path, grid: Grid) -> None:
    """Write a grid as VTU, with its fields in one piece, so that those of cells can be shown on the
    deformed shape."""
    m, k = grid.cells.shape
    kind, _ = VTK[grid.dimension, k]
    topology = {
        "connectivity": grid.cells.astype(np.int64).ravel(),
        "offsets": k * np.arange(1, m + 1),
        "types": np.full(m, kind, dtype=np.uint8),
    }
    parts = {
        "PointData": grid.at_nodes,
        "CellData": grid.in_cells,
        "Points": {"points": np.pad(grid.x, ((0, 0), (0, 3 - grid.x.shape[1])))},
        "Cells": topology,
    }
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64">',
        f'<UnstructuredGrid>\n<Piece NumberOfPoints="{len(grid.x)}" NumberOfCells="{m}">',
    ]
    for part, fields in parts.items():
        arrays = [_data_array(name, values) for name, values in fields.items()]
        lines += [f"<{part}>", *arrays, f"</{part}>"]
    lines.append("</Piece>\n</UnstructuredGrid>\n</VTKFile>\n")
    with writing(path):
        path.write_text("\n".join(lines), encoding="utf-8")


def write_index(path: Path, steps: Sequence[tuple[float, Sequence[str]]]) -> None:
    """Write the index (PVD) of a series: times, and the files of their pieces, which lie beside
    it."""
    lines = [
        f'<DataSet timestep="{time!r}" part="{i}" file="{escape(file)}"/>'
        for time, files in steps
        for i, file in enumerate(files)
    ]
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n<Collection>\n'
    with writing(path):
        path.write_text(head + "\n".join(lines) + "\n</Collection>\n</VTKFile>\n", encoding="utf-8")


def _data_array(name: str, values: Array) -> str:
    """Numbers as raw bytes behind their count; vectors have three components in VTK."""
    kind = {"f": "Float64", "i": "Int64", "u": "UInt8"}[values.dtype.kind]
    size = ""
    if values.ndim == 2:
        values = np.pad(values, ((0, 0), (0, 3 - values.shape[1])))
        size = ' NumberOfComponents="3"'
    raw = np.ascontiguousarray(values, dtype=np.dtype(kind.lower()).newbyteorder("<")).tobytes()
    text = base64.b64encode(np.array(len(raw), dtype="<u8").tobytes() + raw).decode()
    return (
        f'<DataArray type="{kind}" Name="{escape(name)}"{size} format="binary">{text}</DataArray>'
    )


def open_series(path: Path, u: dolfinx.fem.Function) -> Any:
    """An open file for a displacement, with ``write(time)`` and ``close()``: on .bp VTX, on .vtkhdf
    VTKHDF. Collective.

    Raises:
        ContactInputError: this dolfinx cannot write it; on all ranks.
    """
    u.name = "displacement"
    with writing(path):
        if path.suffix == ".vtkhdf":
            module = compat.io_module("vtkhdf")
            found = module and _VTKHDF(module, path, u)
            lack = "has no VTKHDF, which came with 0.10"
        else:
            found = compat.vtx_writer(u.function_space.mesh.comm, path, u)
            lack = "is built without ADIOS2, which VTX needs"
    if found is None:
        raise ContactInputError(
            f"{path}: this dolfinx {dolfinx.__version__} {lack}. Write .pvd instead"
        )
    return found


class _VTKHDF:
    """A displacement at the nodes of its mesh, which VTKHDF calls u."""

    def __init__(self, module: Any, path: Path, u: dolfinx.fem.Function):
        mesh = u.function_space.mesh
        nodes = compat.cell_dofs(mesh.geometry)
        # The corners' dofs come first, as the mesh's nodes do.
        self._dofs = np.zeros(len(mesh.geometry.x), dtype=np.int64)
        self._dofs[nodes] = compat.cell_dofs(u.function_space)[:, : nodes.shape[1]]
        self._own = mesh.geometry.index_map().size_local
        self._module, self._path, self._u = module, path, u
        module.write_mesh(path, mesh)

    def write(self, time: float) -> None:
        mesh = self._u.function_space.mesh
        gdim = mesh.geometry.dim
        values = self._u.x.array.reshape(-1, gdim)[self._dofs[: self._own]]
        data = np.pad(values, ((0, 0), (0, 3 - gdim))).ravel()
        with writing(self._path):
            self._module.write_point_data(self._path, mesh, data, time)

    def close(self) -> None:
        """Nothing is held open."""
