"""Unit blocks of neo-Hookean bodies, with foot and top tagged."""

import finite_patch
import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_llm import compat

FOOT, TOP = 1, 2
KINDS = {"quad": (2, mesh.CellType.quadrilateral), "tet": (3, mesh.CellType.tetrahedron)}


def block(kind, cells=4, degree=1, comm=MPI.COMM_SELF, high=3):
    """Unit block of cells wide and high, its foot and top tagged; displacement and residual."""
    dim, cell = KINDS[kind]
    make = mesh.create_rectangle if dim == 2 else mesh.create_box
    domain = make(comm, [np.zeros(dim), np.ones(dim)], [cells, *(3,) * (dim - 2), high], cell)
    at = [
        mesh.locate_entities_boundary(domain, dim - 1, lambda p, y=y: np.isclose(p[dim - 1], y))
        for y in (0.0, 1.0)
    ]
    order = np.argsort(np.concatenate(at))
    values = np.repeat([FOOT, TOP], [len(found) for found in at]).astype(np.int32)
    tags = mesh.meshtags(domain, dim - 1, np.concatenate(at)[order], values[order])
    V = compat.function_space(domain, degree=degree, shape=(dim,))
    u = fem.Function(V)
    return domain, tags, V, u, finite_patch.residual(u, *finite_patch.lame(1000.0, 0.4), degree)
