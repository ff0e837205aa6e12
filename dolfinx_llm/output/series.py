"""Series of a displacement in the formats of dolfinx's own: VTX and VTKHDF."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import dolfinx
import dolfinx.fem
import numpy as np

from dolfinx_llm.base import compat
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.output.writing import writing


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
