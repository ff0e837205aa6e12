"""Convergence on non-matching meshes: two blocks tied together, known displacement fields.

Two unit cubes, one on the other, with n and about 1.5 n bricks a side, against a matching mesh of
the coarser kind on both. Errors of the displacement in L2 and H1, and of the normal contact
pressure, over refinements.

    mpirun -n 2 python demos/convergence.py [--field bending] [--refinements K] [--json FILE] ...
"""

import argparse
import json
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

E, NU = 100.0, 0.3
MU, LAM = E / (2 * (1 + NU)), E * NU / (1 + NU) / (1 - 2 * NU)
LOWER, UPPER = 1, 2


def manufactured(x, lib=ufl):
    """A smooth displacement; ``lib``: ufl or numpy."""
    s, c, pi = lib.sin, lib.cos, np.pi
    return (
        0.1 * s(pi * x[0] / 2) * c(pi * x[1] / 3) * c(x[2] / 2),
        0.1 * c(pi * x[0] / 3) * s(x[1]) * s(x[2] + 0.3),
        -0.1 * x[2] * c(x[0]) * c(pi * x[1] / 4),
    )


def bending(x, lib=ufl):
    """Pure bending of a beam along z, split across: no body force, linear pressure and tension."""
    b, k = x[0] - 0.5, 0.1
    return (k / 2 * (x[2] ** 2 + NU * (b**2 - x[1] ** 2)), k * NU * x[1] * b, -k * x[2] * b)


FIELDS = {"manufactured": manufactured, "bending": bending}


def stress(u):
    strain = ufl.sym(ufl.grad(u))
    return 2 * MU * strain + LAM * ufl.tr(strain) * ufl.Identity(3)


def blocks(comm, n_lower, n_upper):
    """Mesh of both cubes, no node shared, and the tags of the two surfaces that touch."""
    points, cells, first = [], [], 0
    for n, base in ((n_lower, 0.0), (n_upper, 1.0)):
        line = np.linspace(0.0, 1.0, n + 1)
        x = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
        node = np.arange(len(x)).reshape((n + 1,) * 3)
        corners = [
            node[i : n + i, j : n + j, k : n + k].ravel()
            for k in (0, 1)
            for j in (0, 1)
            for i in (0, 1)
        ]
        points.append(x + [0.0, 0.0, base])
        cells.append(np.stack(corners, axis=1) + first)
        first += len(x)
    points, cells = np.concatenate(points), np.concatenate(cells)
    if comm.rank:
        points, cells = points[:0], cells[:0]
    domain = compat.create_mesh(comm, cells, points, "hexahedron")
    middle = domain.geometry.x[compat.cell_dofs(domain.geometry)].mean(axis=1)[:, 2]
    facets = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[2], 1.0))
    domain.topology.create_connectivity(2, 3)
    to_cell = domain.topology.connectivity(2, 3)
    upper = middle[to_cell.array[to_cell.offsets[facets]]] > 1.0
    return domain, mesh.meshtags(domain, 2, facets, np.where(upper, UPPER, LOWER).astype(np.int32))


def body_forms(V, exact=manufactured):
    """Bilinear form, load and Dirichlet conditions.

    The exact displacement is prescribed on the lower block's bottom and the upper one's top; on the
    lateral faces the exact traction acts, so that no support meets the interface.
    """
    domain = V.mesh
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    u_exact = ufl.as_vector(exact(ufl.SpatialCoordinate(domain)))
    normal = ufl.FacetNormal(domain)
    ends = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[2] % 2.0, 0.0))
    sides = mesh.locate_entities_boundary(
        domain, 2, lambda x: np.isclose(x[0] % 1.0, 0.0) | np.isclose(x[1] % 1.0, 0.0)
    )
    lateral = mesh.meshtags(domain, 2, np.sort(sides), np.full(len(sides), 1, dtype=np.int32))
    ds = ufl.Measure("ds", domain=domain, subdomain_data=lateral)
    g = fem.Function(V)
    g.interpolate(lambda x: np.stack(exact(x, np)))
    a = ufl.inner(stress(u), ufl.grad(w)) * ufl.dx
    L = -ufl.inner(ufl.div(stress(u_exact)), w) * ufl.dx(metadata={"quadrature_degree": 5})
    L += ufl.inner(stress(u_exact) * normal, w) * ds(1, metadata={"quadrature_degree": 5})
    return a, L, [fem.dirichletbc(g, fem.locate_dofs_topological(V, 2, ends))]


def field_errors(uh, exact=manufactured):
    """Relative errors of a displacement in L2 and in the H1 seminorm."""
    domain = uh.function_space.mesh
    u_exact = ufl.as_vector(exact(ufl.SpatialCoordinate(domain)))
    gap, grad = uh - u_exact, ufl.grad(u_exact)

    def norm(form):
        local = fem.assemble_scalar(fem.form(form))
        return np.sqrt(domain.comm.allreduce(local, op=MPI.SUM))

    dx = ufl.Measure("dx", domain=domain, metadata={"quadrature_degree": 5})
    l2 = norm(ufl.inner(gap, gap) * dx) / norm(ufl.inner(u_exact, u_exact) * dx)
    h1 = norm(ufl.inner(ufl.grad(gap), ufl.grad(gap)) * dx) / norm(ufl.inner(grad, grad) * dx)
    return {"l2": l2, "h1": h1}


def solve(comm, n_lower, n_upper, exact=manufactured):
    """Errors in L2 and H1 (relative), of the pressure, and the unknowns."""
    domain, tags = blocks(comm, n_lower, n_upper)
    V = compat.function_space(domain, shape=(3,))
    a, L, bcs = body_forms(V, exact)
    interface = llm.Interface(tags, (LOWER, UPPER))
    problem = llm.ContactProblem(a, L, bcs=bcs, interfaces=[interface])
    errors = field_errors(problem.solve(), exact)
    result = problem.results[0]
    pressure = pressure_error(result.frame.x, result.frame_area, result.pressure, exact)
    unknowns = sum(problem.unknowns.values())
    problem.destroy()
    return {**errors, "pressure": pressure, "unknowns": unknowns}


def pressure_error(x, area, pressure, exact=manufactured):
    """Relative L2 error of pressures at nodes x (n, 3), each for its area, against the exact normal
    stress."""
    step = 1e-5  # central differences of the exact field

    def gradient(i, k):
        ahead, back = x.copy(), x.copy()
        ahead[:, k] += step
        back[:, k] -= step
        return (exact(ahead.T, np)[i] - exact(back.T, np)[i]) / (2 * step)

    trace = sum(gradient(k, k) for k in range(3))
    theory = -(2 * MU * gradient(2, 2) + LAM * trace)
    return float(np.sqrt((area @ (pressure - theory) ** 2) / (area @ theory**2)))


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--refinements", type=int, default=3)
    parser.add_argument("--field", choices=FIELDS, default="manufactured")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    comm = MPI.COMM_WORLD
    rows = []
    for n in [2 * 2**k for k in range(args.refinements)]:
        field = FIELDS[args.field]
        row = {
            "n": n,
            "tied": solve(comm, n, 3 * n // 2, field),
            "matching": solve(comm, n, n, field),
        }
        rows.append(row)
        if comm.rank == 0:
            for name in ("tied", "matching"):
                e = row[name]
                line = f"n = {n:3} {name:>9}: {e['unknowns']:8} unknowns"
                for key in ("l2", "h1", "pressure"):
                    line += f"   {key} {e[key]:.3e}"
                    if len(rows) > 1:
                        line += f" rate {np.log2(rows[-2][name][key] / e[key]):.2f}"
                print(line, flush=True)
    if comm.rank == 0 and args.json:
        args.json.write_text(json.dumps(rows, indent=2) + "\n")
    if args.plot:
        lines, h = [], [1.0 / row["n"] for row in rows]
        for k, key in enumerate(("l2", "h1", "pressure")):
            for name, style in (("tied", "o-"), ("matching", "x:")):
                values = [row[name][key] for row in rows]
                lines.append((f"{key}, {name}", f"C{k}{style}", h, values))
        path = args.plot / "convergence.png"
        llm.plot.curves(lines, path, xlabel="h of the coarser side", ylabel="error", log=True)
    return rows


if __name__ == "__main__":
    main()
