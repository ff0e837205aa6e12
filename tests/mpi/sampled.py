"""What a Function is at nodes of surfaces: errors against its values there."""

import json

import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_llm import compat
from dolfinx_llm.geometry.at_nodes import values_at_surfaces

N = 6


def error(domain, family, degree, order, f, exact, on):
    """Largest at nodes of a space of an order where ``on`` says so, of f in another space."""
    function = fem.Function(compat.function_space(domain, family, degree))
    function.interpolate(f)
    V = compat.function_space(domain, degree=order, shape=(domain.geometry.dim,))
    n = V.dofmap.index_map.size_local
    x = V.tabulate_dof_coordinates()[:n].T
    miss = np.abs(values_at_surfaces(function, V) - exact(x))[on(x)]
    found = domain.comm.allgather(miss.max() if len(miss) else 0.0)
    return float(max(found))


def errors(comm):
    square = mesh.create_rectangle(comm, [[0.0, 0.0], [1.0, 1.0]], [N, N])
    cube = mesh.create_unit_cube(comm, 3, 3, 3, mesh.CellType.hexahedron)

    def linear(x):
        return x[0] + 2.0 * x[1]

    def quadratic(x):
        return 1.0 + x[0] * x[1] - 2.0 * x[2] ** 2

    def between(x):  # the middles of the two triangles on y = 0 that meet in x
        return linear(x) + (1.0 / 6.0 + 2.0 / 3.0) / N

    def below(x):
        return (x[1] < 1e-9) & (x[0] > 1e-9) & (x[0] < 1.0 - 1e-9)

    def outside(x):
        return (np.abs(x - 0.5) > 0.5 - 1e-9)[: 2 if (x[2] == 0.0).all() else 3].any(axis=0)

    return {
        "by cell": error(square, "DG", 0, 1, linear, between, below),
        "linear": error(square, "Lagrange", 1, 1, linear, linear, outside),
        "linear by cell": error(square, "DG", 1, 2, linear, linear, outside),
        "quadratic": error(cube, "Lagrange", 2, 2, quadratic, quadratic, outside),
    }


if __name__ == "__main__":
    found = errors(MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))
