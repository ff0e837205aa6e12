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
from dolfinx_llm.problem.blocks import Blocks

FORMAT = "dolfinx_llm state 6"
Arrays = dict[str, Array]


def by_cells(blocks: Sequence[Blocks], values: Array) -> list[Array]:
    """Per mesh (cells, nodes, components) of this rank's values (n_local,), on rank 0, in units of
    the form; collective."""
    found, start = [], 0
    for block in blocks:
        V, own = block.W, len(block.scale)
        function = fem.Function(V)
        block.fill(function, values[start : start + own])
        start += own
        cells, count = _cells(V), V.mesh.topology.index_map(V.mesh.topology.dim).size_local
        table = function.x.array.reshape(-1, V.dofmap.index_map_bs)[compat.cell_dofs(V)[:count]]
        parts = V.mesh.comm.gather((cells[:count], table))
        if parts is None:
            found.append(np.zeros(0))
            continue
        cells, table = (np.concatenate(part) for part in zip(*parts, strict=True))
        found.append(table[np.unique(cells, axis=0, return_index=True)[1]])
    return found


def from_cells(blocks: Sequence[Blocks], tables: Sequence[Any], file: Any) -> Array:
    """This rank's values (n_local,) of rank 0's tables per mesh; collective."""
    found = []
    for block, table in zip(blocks, tables, strict=True):
        V = block.W
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
        function = fem.Function(V)
        function.x.array.reshape(-1, shape[2])[dofs[: len(cells)]] = comm.scatter(rows)
        found.append(block.values(function))
    return np.concatenate(found)


def check_order(blocks: Sequence[Blocks]) -> None:
    """Require dofs whose order in a cell does not depend on how a mesh is parted: at most one at
    each edge or facet, or several of a block that are components.

    Raises:
        ContactInputError: a block of a mixed space has others.
    """
    for V in (block.W for block in blocks if block.mixed):
        dim = V.mesh.topology.dim
        layouts = [V.sub(i).dofmap.dof_layout for i in range(V.num_sub_spaces)]
        several = [max(len(L.entity_dofs(d, 0)) for d in range(1, dim)) > 1 for L in layouts]
        if V.element.needs_dof_transformations or any(several):
            raise ContactInputError(
                f"a mixed space of {len(layouts)} blocks cannot be saved, as one of them is of "
                "third order or of vectors along edges or across facets: Lagrange spaces of up to "
                "second order can, continuous or not"
            )


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
