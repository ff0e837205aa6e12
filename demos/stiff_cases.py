"""Where contact gets hard: how far each solver is right, or what it is refused with.

Two blocks, one on the other, under uniaxial pressure: displacements and pressures are known. One
property at a time is driven to its extremes; everything else is ordinary.

    python demos/stiff_cases.py [--size N] [--only WORD] [--json FILE]
"""

import argparse
import json
import logging
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

BOTTOM, LOWER, UPPER, TOP = 1, 2, 3, 4
PRESSURE = 0.01  # of E
RIGHT = 1e-8  # relative error up to which a case counts as passed
SOLVERS = ("saddle", "condensed")


# ## Two blocks
def block(lines, low, height, layers):
    """Nodes and bricks of a block over the grid lines x and y."""
    z = low + height * np.linspace(0.0, 1.0, layers + 1)
    x = np.stack(np.meshgrid(*lines, z, indexing="ij"), axis=-1)
    node = np.arange(x[..., 0].size).reshape(x.shape[:3])
    corners = [
        node[i : node.shape[0] - 1 + i, j : node.shape[1] - 1 + j, k : layers + k].ravel()
        for k in (0, 1)
        for j in (0, 1)
        for i in (0, 1)
    ]
    return x.reshape(-1, 3), np.stack(corners, axis=1)


def grid(n, low=0.0, high=1.0, bend=0.0, sliver=0.0):
    """Grid lines of n cells, bent out of uniform; ``sliver``: width of one more cell."""
    t = np.linspace(0.0, 1.0, n + 1)
    t = t + bend * t * (1.0 - t)
    if sliver:
        t = np.sort(np.append(t, t[n // 2] + sliver))
    return low + (high - low) * t


def scene(
    comm, n, *, ratio=1.0, nu=0.3, length=1.0, E=1.0, aspect=1.0, refine=1.3, density=None,
    sliver=0.0, offset=0.0, overhang=0.0, solver="auto", options=None,
):  # fmt: skip
    """The contact problem and the exact displacement.

    Args:
        n: cells along the lower block, in which ``refine`` times as many touch.
        ratio: E of the upper block over that of the lower one.
        aspect: height of the cells over their width.
        density: cells of a frame over those of the coarser side; None: the predicted frame.
        overhang: of the upper block over the lower one's outline, at one side.
        offset: of the origin, in diameters.
    """
    m = max(1, round(refine * n))
    nu = 0.0 if ratio != 1.0 else nu  # else the two contract differently: no uniform stress
    layers, height = 2, 2.0 * aspect / n
    x0, cells0 = block([grid(n, bend=0.2)] * 2, 0.0, height, layers)
    side = grid(m, 0.0, 1.0 + overhang, bend=-0.2, sliver=sliver)
    x1, cells1 = block([side, grid(m, bend=0.3)], height, height, layers)
    x, cells = np.concatenate([x0, x1]), np.concatenate([cells0, cells1 + len(x0)])
    if comm.rank:
        x, cells = x[:0], cells[:0]
    domain = compat.create_mesh(comm, cells, x, "hexahedron")
    at = {z: facets_at(domain, z) for z in (0.0, height, 2 * height)}
    domain.topology.create_connectivity(2, 3)
    to_cell = domain.topology.connectivity(2, 3)
    middle = domain.geometry.x[compat.cell_dofs(domain.geometry)].mean(axis=1)[:, 2]
    above = middle[to_cell.array[to_cell.offsets[at[height]]]] > height
    facets = np.concatenate([at[0.0], at[height], at[2 * height]])
    values = [np.full(len(at[0.0]), BOTTOM), np.where(above, UPPER, LOWER)]
    values = np.concatenate([*values, np.full(len(at[2 * height]), TOP)]).astype(np.int32)
    order = np.argsort(facets)
    tags = mesh.meshtags(domain, 2, facets[order], values[order])
    V = compat.function_space(domain, shape=(3,))
    E_of = fem.Function(compat.function_space(domain, "DG", 0))
    E_of.interpolate(lambda p: np.where(p[2] > height, ratio * E, E))
    shift = offset * np.sqrt(2.0) * length * np.array([0.6, -0.64, 0.48])
    domain.geometry.x[:] = length * domain.geometry.x + shift
    exact = exact_field(length * height, ratio, nu, shift)
    cells = density and max(1, round(density * min(n, m)))
    frame = cells and frame_of(length, height, shift, cells)
    return problem(V, tags, E_of, nu, E, exact, frame, solver, options), exact


def facets_at(domain, z):
    return mesh.locate_entities_boundary(domain, 2, lambda p: np.isclose(p[2], z, atol=1e-10))


def exact_field(height, ratio, nu, shift):
    """Displacement of uniaxial stress, points (3, k)."""

    def exact(p):
        p = p - shift[:, None]
        z = np.minimum(p[2], height) + np.maximum(p[2] - height, 0.0) / ratio
        return PRESSURE * np.array([nu * p[0], nu * p[1], -z])

    return exact


def frame_of(length, height, shift, k):
    line = np.linspace(0.0, 1.0, k + 1)
    x, y = (c.ravel() for c in np.meshgrid(line, line, indexing="ij"))
    corner = (np.arange(k)[:, None] * (k + 1) + np.arange(k)).ravel()[:, None]
    points = np.column_stack([x, y, np.full(len(x), height)])
    return llm.Frame(length * points + shift, corner + [0, k + 1, k + 2, 1])


def problem(V, tags, E_of, nu, E, exact, frame, solver, options):
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    nu = fem.Constant(V.mesh, nu)  # one form to compile for all cases
    mu, lam = E_of / (2 * (1 + nu)), E_of * nu / (1 + nu) / (1 - 2 * nu)
    strain = ufl.sym(ufl.grad(u))
    stress = 2 * mu * strain + lam * ufl.tr(strain) * ufl.Identity(3)
    prescribed = fem.Function(V)
    prescribed.interpolate(exact)
    held = fem.locate_dofs_topological(V, 2, tags.find(BOTTOM))
    lower, upper = (tags, LOWER), (tags, UPPER)
    loads = [
        llm.free_surface_load(V, tags, TOP, PRESSURE * E),
        llm.free_surface_load(V, *lower, PRESSURE * E, covered_by=upper),
        llm.free_surface_load(V, *upper, PRESSURE * E, covered_by=lower),
    ]
    return llm.ContactProblem(
        ufl.inner(stress, ufl.grad(w)) * ufl.dx,
        ufl.inner(fem.Constant(V.mesh, np.zeros(3)), w) * ufl.dx,
        bcs=[fem.dirichletbc(prescribed, held)],
        interfaces=[llm.Interface(tags, (LOWER, UPPER), frame=frame)],
        nodal_loads=loads,
        solver=solver,
        petsc_options=options,
    )


# ## Cases
CASES = {
    "E ratio": [("ratio", 10.0**k) for k in (-8, -4, -2, 2, 4, 8)],
    "Poisson's ratio": [("nu", nu) for nu in (0.0, 0.49, 0.499, 0.4999)],
    "length": [("length", 10.0**k) for k in (-6, -3, 3, 6)],
    "E": [("E", 10.0**k) for k in (-3, 3, 9, 15)],
    "aspect ratio": [("aspect", a) for a in (0.01, 0.1, 10.0, 100.0)],
    "mesh ratio": [("refine", r) for r in (1.0, 2.0, 4.0, 8.0, 16.0)],
    "frame density": [("density", d) for d in (0.25, 0.5, 1.0, 2.0, 4.0)],
    "sliver": [("sliver", 10.0**k) for k in (-2, -4, -6, -8)],
    "offset": [("offset", 10.0**k) for k in (2, 4, 6)],
    "overhang": [("overhang", 10.0**k) for k in (-3, -6, -9, -12)],
}


def solve(n, comm=MPI.COMM_WORLD, **case):
    """Errors of a case, or the words it is refused with."""
    try:
        contact, exact = scene(comm, n, **case)
        u = contact.solve()
    except llm.ContactError as error:
        return {"refused": str(error)}
    V = u.function_space
    k = V.dofmap.index_map.size_local
    known = exact(V.tabulate_dof_coordinates()[:k].T).T
    off = np.abs(u.x.array[: 3 * k].reshape(k, 3) - known).max(initial=0.0)
    size = max(comm.allgather(np.abs(known).max(initial=0.0)))
    pressure = PRESSURE * case.get("E", 1.0)
    result, system = contact.results[0], getattr(contact.method.form, "system", None)
    row = {
        "unknowns": contact.unknowns["u"],
        "displacement": max(comm.allgather(off)) / size,
        "pressure": float(np.abs(result.pressure / pressure - 1.0).max()),
        "method": system.solver.method if system else "LDLᵀ",
        "iterations": getattr(system, "iterations", 0),
        "notes": getattr(system, "notes", []),
        "lost": contact.method.iteration.verdict.lost,
    }
    contact.destroy()
    return row


def verdict(row):
    """passed, warned of, refused or wrong."""
    if "refused" in row:
        return "refused"
    if max(row["displacement"], row["pressure"]) <= RIGHT:
        return "passed"
    return "warned of" if row["lost"] else "WRONG"


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=8, metavar="N", help="cells along a block")
    parser.add_argument("--only", default="", metavar="WORD")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    rank, rows = MPI.COMM_WORLD.rank, []
    for name, cases in CASES.items():
        for key, value in cases if args.only in name else []:
            for solver in SOLVERS:
                row = solve(args.size, solver=solver, **{key: value})
                row = {"case": name, "value": value, "solver": solver, **row}
                row["verdict"] = verdict(row)
                rows.append(row)
                if rank == 0:
                    print(line(row), flush=True)
    if args.json and rank == 0:
        args.json.write_text(json.dumps(rows, indent=2) + "\n")
    if args.plot:
        diagrams = []
        for solver in SOLVERS:
            lines = []
            for k, name in enumerate(dict.fromkeys(row["case"] for row in rows)):
                own = [row for row in rows if (row["case"], row["solver"]) == (name, solver)]
                own = [row for row in own if "refused" not in row]
                error = [max(row["displacement"], 1e-17) for row in own]
                style = f"C{k % 10}{'o-' if k < 10 else 'x:'}"
                lines.append((f"{solver}: {name}", style, [row["value"] for row in own], error))
            diagrams.append(lines)
        names = {"xlabel": "property over the ordinary", "ylabel": "error of the displacement"}
        llm.plot.curves(diagrams, args.plot / "stiff_cases.png", log=True, **names)
    return rows


def line(row):
    head = f"{row['case']:<16}{row['value']:<9.4g}{row['solver']:<10}{row['verdict']:<10}"
    if "refused" in row:
        return head + row["refused"][:90]
    text = f"{row['unknowns']:7} u {row['displacement']:.1e}  p {row['pressure']:.1e}  "
    text += f"{row['method']}, {row['iterations']} iterations" if row["iterations"] else "LDLᵀ"
    return head + text + "".join(f"; {note[:70]}" for note in row["notes"] + row["lost"])


if __name__ == "__main__":
    logging.getLogger().setLevel(logging.ERROR)  # what is said stands in the table
    main()
