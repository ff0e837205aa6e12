"""Effective conductivity of a square array of fibres, from one periodic cell.

Opposite sides of the cell are tied at a distance, whatever the numbers of their nodes, by
``Interface(tags, (LEFT, RIGHT), shift=(-1, 0))``. Under a mean gradient g the temperature is
g·x + u with a periodic u, and the mean of k (g + grad u) is the flux of the whole. Known are the
series of Perrins, McKenzie and McPhedran (1979), and that without fibre u vanishes, to rounding.

    mpirun -n 2 python demos/periodic_cell.py [--refine N] [--ratio K] [--plot DIR] [--json FILE]
"""

import argparse
import json
from pathlib import Path

import gmsh
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

MATRIX, FIBRE, LEFT, RIGHT, BELOW, ABOVE = 1, 2, 11, 12, 13, 14
COUNTS = {BELOW: 9, RIGHT: 14, ABOVE: 12, LEFT: 10}  # segments of the sides, times ``refine``


def cell(comm, radius, refine=1):
    """Unit square with a disc in its middle: mesh, cell tags, facet tags."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    if comm.rank == 0:
        model, occ = gmsh.model, gmsh.model.occ
        square, disc = occ.addRectangle(0, 0, 0, 1, 1), occ.addDisk(0.5, 0.5, 0, radius, radius)
        centre = occ.addPoint(0.5, 0.5, 0)
        _, parts = occ.fragment([(2, square)], [(2, disc), (0, centre)])
        occ.synchronize()
        model.addPhysicalGroup(2, [parts[1][0][1]], FIBRE)
        model.addPhysicalGroup(2, [k for _, k in parts[0] if k != parts[1][0][1]], MATRIX)
        places = {BELOW: (0.5, 0.0), RIGHT: (1.0, 0.5), ABOVE: (0.5, 1.0), LEFT: (0.0, 0.5)}
        for _, curve in model.getEntities(1):
            x, y, _ = occ.getCenterOfMass(1, curve)
            for tag, at in places.items():
                if np.allclose((x, y), at, atol=1e-6):
                    model.addPhysicalGroup(1, [curve], tag)
                    model.mesh.setTransfiniteCurve(curve, refine * COUNTS[tag] + 1)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.09 / refine)
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 40 * refine)
        model.mesh.generate(2)
    mesh = compat.model_to_mesh(gmsh.model, comm, 0, gdim=2)
    gmsh.finalize()
    return mesh


def effective(mesh, cells, tags, ratio):
    """Conductivity along x, with a fibre of so much times the matrix'; the temperature, and u."""
    V, D = compat.function_space(mesh), compat.function_space(mesh, "DG", 0)
    k, g = fem.Function(D), ufl.as_vector([1.0, 0.0])
    dofs = compat.cell_dofs(D)
    k.x.array[dofs[cells.indices, 0]] = np.where(cells.values == FIBRE, ratio, 1.0)
    k.x.scatter_forward()
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    middle = fem.locate_dofs_geometrical(V, lambda x: np.isclose(np.hypot(*(x[:2] - 0.5)), 0.0))
    problem = llm.ContactProblem(
        k * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        -k * ufl.inner(g, ufl.grad(v)) * ufl.dx,
        bcs=[fem.dirichletbc(fem.Function(V), middle)],
        interfaces=[
            llm.Interface(tags, (LEFT, RIGHT), shift=(-1.0, 0.0)),
            llm.Interface(tags, (BELOW, ABOVE), shift=(0.0, -1.0)),
        ],
    )
    u = problem.solve()
    flux = fem.assemble_scalar(fem.form(k * ufl.inner(g + ufl.grad(u), g) * ufl.dx))
    area = fem.assemble_scalar(fem.form(k * ufl.inner(g, g) * ufl.dx))
    share = (mesh.comm.allreduce(area) - 1.0) / (ratio - 1.0) if ratio != 1.0 else 0.0
    return mesh.comm.allreduce(flux), share, u


def series(share, ratio):
    """Effective conductivity for a share of fibres, up to about a half."""
    T = (1.0 + ratio) / (ratio - 1.0)
    more = 0.305827 * share**4 * T / (T**2 - 1.402958 * share**8) + 0.013362 * share**8 / T
    return 1.0 + 2.0 * share / (T - share - more)


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--refine", type=int, default=2, metavar="N")
    parser.add_argument("--ratio", type=float, default=10.0, metavar="K")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    parser.add_argument("--json", type=Path, metavar="FILE")
    args = parser.parse_args(arguments)
    comm, rows = MPI.COMM_WORLD, []
    for radius in (0.2, 0.3, 0.38):
        mesh, cells, tags = cell(comm, radius, args.refine)
        k, share, u = effective(mesh, cells, tags, args.ratio)
        none, _, rest = effective(mesh, cells, tags, 1.0)
        left = comm.allreduce(float(np.abs(rest.x.array).max(initial=0.0)), op=MPI.MAX)
        known = series(share, args.ratio)
        rows.append({"share": share, "k": k, "series": known, "no fibre": [none - 1.0, left]})
        if comm.rank == 0:
            print(f"share {share:.4f}: k {k:.5f}, series {known:.5f}, off by {k / known - 1:.1e}; "
                  f"without fibre u is {left:.0e}")  # fmt: skip
    if args.json and comm.rank == 0:
        args.json.write_text(json.dumps(rows) + "\n")
    if args.plot:
        x = ufl.SpatialCoordinate(mesh)
        plot.bodies(u, x[0] + u, args.plot / "periodic_cell.png", label="temperature")
    return rows


if __name__ == "__main__":
    main()
