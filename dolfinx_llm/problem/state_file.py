"""Files of states: arrays with names, values at the bodies' nodes by the mesh's own cells, in an
order that does not depend on the number of ranks."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from dolfinx import fem

from dolfinx_llm.base import compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.geometry.spaces import CELLS
from dolfinx_llm.output.writing import writing

FORMAT = "dolfinx_llm state 3"
Arrays = dict[str, Array]


def by_cells(spaces: Sequence[Any], values: Array) -> list[Array]:
    """Per mesh (cells, nodes, components) of this rank's values, on rank 0; collective."""
    found, start = [], 0
    for V in spaces:
        function = fem.Function(V)
        k = V.dofmap.index_map_bs
        count = V.dofmap.index_map.size_local * k
        function.x.array[:count] = values[start : start + count]
        function.x.scatter_forward()
        start += count
        cells, own = _cells(V), V.mesh.topology.index_map(V.mesh.topology.dim).size_local
        table = function.x.array.reshape(-1, k)[compat.cell_dofs(V)[:own]]
        parts = V.mesh.comm.gather((cells[:own], table))
        if parts is None:
            found.append(np.zeros(0))
            continue
        cells, table = (np.concatenate(part) for part in zip(*parts, strict=True))
        found.append(table[np.unique(cells, axis=0, return_index=True)[1]])
    return found


def from_cells(spaces: Sequence[Any], tables: Sequence[Any], file: Any) -> Array:
    """This rank's values of rank 0's tables per mesh; collective."""
    found = []
    for V, table in zip(spaces, tables, strict=True):
        comm, cells, dofs = V.mesh.comm, _cells(V), compat.cell_dofs(V)
        count = V.mesh.topology.index_map(V.mesh.topology.dim).size_global
        shape = count, V.dofmap.dof_layout.num_dofs, V.dofmap.index_map_bs
        parts = comm.gather(cells)
        with collective(comm):
            if parts is not None and (table is None or table.shape != shape):
                raise other_scene(file, "meshes of other sizes")
        rows = None
        if parts is not None:
            number = np.unique(np.concatenate(parts), axis=0, return_inverse=True)[1].ravel()
            rows = np.split(table[number], np.cumsum([len(part) for part in parts])[:-1])
        own = comm.scatter(rows)
        index_map = V.dofmap.index_map
        values = np.zeros((index_map.size_local + index_map.num_ghosts, V.dofmap.index_map_bs))
        values[dofs[: len(cells)]] = own
        found.append(values[: index_map.size_local].ravel())
    return np.concatenate(found)


def _cells(V: Any) -> Array:
    """(n, nodes) numbers that the nodes of this rank's cells had when the mesh was read or made,
    which tell cells from each other, on submeshes as well."""
    geometry, degree = V.mesh.geometry, compat.geometry_degree(V.mesh)
    nodes = compat.cell_dofs(geometry).reshape(-1, CELLS[compat.cell_kinds(V.mesh)[0]][degree - 1])
    return np.asarray(geometry.input_global_indices)[nodes]


def other_scene(file: Any, what: str) -> ContactInputError:
    return ContactInputError(f"{file} was saved of another scene: it has {what}")


def write_state(path: Path, arrays: Arrays) -> None:
    """Write a file beside the old one, and put it in its place."""
    new = path.with_name(f".{path.name}.{os.getpid()}.new")
    try:
        with writing(path):
            with open(new, "wb") as stream:
                np.savez(stream, **arrays)
            os.replace(new, path)
    finally:
        new.unlink(missing_ok=True)


def read_state(file: Any) -> Arrays:
    try:
        with np.load(file, allow_pickle=False) as stored:
            found = {name: stored[name] for name in stored.files}
    except (OSError, ValueError, EOFError, TypeError, AttributeError, BadZipFile) as error:
        words = " ".join(str(error).split())[:200]
        raise ContactInputError(f"{file} is no file that save() wrote: {words}") from error
    if str(found.pop("format", "")) != FORMAT:
        raise ContactInputError(
            f"{file} is no file that this version's save() wrote: give one that it has written"
        )
    return found
