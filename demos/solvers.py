"""What a contact costs: the forms of the system against a matching mesh of equal size.

Two cubes, one on the other, meshes of n and about 1.2 n bricks a side, clamped below, held
sideways above and under a body force that presses, bends and twists; the reference is one mesh of
the same two cubes, matching, with as many unknowns. Of bodies that may part, without friction and
with a coefficient of 0.3, the figures are those of all solves together. Every case runs in a
process of its own, so that its peak memory is its own.

    python demos/solvers.py [--largest N] [--repeat K] [--ranks R] [--only WORD] [--plot DIR] ...
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

METHODS = (
    "saddle",
    "condensed Cholesky",
    "condensed CG + GAMG",
    "frictionless CG + GAMG",
    "friction GMRES + GAMG",
    "matching CG + GAMG",
)
DIRECT = {"ksp_type": "preonly", "pc_type": "cholesky"}
SIZES = {8_500: 9, 60_000: 19, 190_000: 28, 440_000: 37}  # unknowns, about: bricks a side
LARGEST = {"saddle": 200_000, "condensed Cholesky": 200_000}  # a factor's memory grows faster
E, NU = 100.0, 0.3


# ## The bodies
def forms(V):
    import ufl

    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    mu, lam = E / (2 * (1 + NU)), E * NU / (1 + NU) / (1 - 2 * NU)
    strain = ufl.sym(ufl.grad(u))
    stress = 2 * mu * strain + lam * ufl.tr(strain) * ufl.Identity(3)
    x = ufl.SpatialCoordinate(V.mesh)
    force = ufl.as_vector([0.2 * x[1] - 0.05, 0.1 + 0.08 * x[2], -0.6 * x[0] - 4.0])
    return ufl.inner(stress, ufl.grad(w)) * ufl.dx, ufl.inner(force, w) * ufl.dx


def supports(V):
    import numpy as np
    from dolfinx import fem

    dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[2], 0.0))
    bcs = [fem.dirichletbc(np.zeros(3), dofs, V)]
    for k in (0, 1):
        V_k = V.sub(k).collapse()[0]
        dofs = fem.locate_dofs_geometrical((V.sub(k), V_k), lambda x: np.isclose(x[2], 2.0))
        bcs.append(fem.dirichletbc(fem.Function(V_k), dofs, V.sub(k)))
    return bcs


# ## Two meshes that do not match
def contact(comm, n, solver, options, law):
    from convergence import LOWER, UPPER, blocks

    import dolfinx_llm as llm
    from dolfinx_llm import compat

    laws = {"frictionless": llm.Frictionless(), "friction": llm.Coulomb(0.3)}
    parts, law = law in laws, laws.get(law, llm.Tied())
    domain, tags = blocks(comm, n, round(1.2 * n))
    V = compat.function_space(domain, shape=(3,))
    a, L = forms(V)
    problem = llm.ContactProblem(
        a, L, bcs=supports(V), interfaces=[llm.Interface(tags, (LOWER, UPPER), law=law)],
        solver=solver, petsc_options=options,
    )  # fmt: skip
    problem.solve()
    times = dict(problem.times)
    form = problem.method.form
    row = {
        "unknowns": problem.unknowns["u"],
        "iterations": form.system.iterations if form.name == "condensed" and not parts else 0,
        "set-up": times.pop("factorisation", 0.0),
        "solve": times.pop("solve", 0.0),
        "residual": problem.method.iteration.verdict.residual,
    }
    if parts:
        steps = (form.friction or form.system).steps
        times["steps"] = row["set-up"]
        row |= {key: sum(step[key] for step in steps) for key in steps[0]}
        times["steps"] -= row["set-up"] + row["solve"]
    bulk = times.pop("assembly of K") + times.pop("assembly of f")
    del times["form compilation"]
    return {**row, "assembly": bulk, "contact": sum(times.values())}


# ## One mesh, with the same options
def matching(comm, n):
    import numpy as np
    from dolfinx import fem, mesh

    from dolfinx_llm import compat

    nodes = (n + 1) ** 3 + (round(1.2 * n) + 1) ** 3
    m = round((nodes / 2) ** (1 / 3)) - 1
    corners = [np.zeros(3), np.array([1.0, 1.0, 2.0])]
    cells = [m, m, round(nodes / (m + 1) ** 2) - 1]
    domain = mesh.create_box(comm, corners, cells, mesh.CellType.hexahedron)
    V = compat.function_space(domain, shape=(3,))
    bcs = supports(V)
    a, L = (fem.form(form) for form in forms(V))
    began = time.perf_counter()
    K = compat.assemble_matrix(a, bcs, 1.0)
    f = compat.assemble_load(L, a, bcs, compat.prescribed(V, bcs), [])
    assembled = time.perf_counter() - began
    fixed = ~np.isnan(compat.prescribed_values(V, bcs)[: len(f)])
    _, row = solve_scaled(K, f, body_modes(V, fixed))
    return {"unknowns": K.getSize()[0], "assembly": assembled, "contact": 0.0, **row}


def body_modes(V, out):
    """Rigid modes (n_local, k) at this rank's dofs, zero where ``out`` marks them."""
    from dolfinx_llm.geometry.cells import rigid_modes

    n = V.dofmap.index_map.size_local
    x = V.tabulate_dof_coordinates()[:n]
    modes = rigid_modes(x - V.mesh.geometry.x.mean(axis=0)).reshape(len(out), -1)
    modes[out] = 0.0
    return modes


def solve_scaled(K, f, modes, options=None):
    """Solution of K x = f, K scaled to unit diagonal, and what it took; CG + GAMG by default."""
    from petsc4py import PETSc

    from dolfinx_llm.forms.condensed.krylov import near_null_space, solver_of

    began = time.perf_counter()
    x, b = K.createVecs()
    b.array_w[:] = f
    S = K.getDiagonal()
    S.sqrtabs()
    S.reciprocal()
    K.diagonalScale(S, S)
    b.pointwiseMult(b, S)
    K.setOption(PETSc.Mat.Option.SPD, True)
    near_null_space(K, S, modes)
    ksp, _, _ = solver_of(K, "matching_", options or {})  # MUMPS with more memory where needed
    ready = time.perf_counter()
    ksp.solve(b, x)
    solved = time.perf_counter()
    r = b.duplicate()
    K.mult(x, r)
    r.axpy(-1.0, b)
    x.pointwiseMult(x, S)
    row = {
        "iterations": ksp.getIterationNumber() if ksp.getType() != "preonly" else 0,
        "set-up": ready - began,
        "solve": solved - ready,
        "residual": r.norm() / b.norm(),
    }
    solution = x.array_r.copy()
    for item in (ksp, x, b, r, S):
        item.destroy()
    if not row["residual"] < 1e-9:
        raise RuntimeError(f"the solve failed: relative residual {row['residual']:.1e}")
    return solution, row


# ## The table
def case(method, n):
    """One method at one size, in this process; rank 0 prints a line of JSON."""
    import resource

    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    if method == "matching CG + GAMG":
        row = matching(comm, n)
    else:
        solver = "saddle" if method == "saddle" else "condensed"
        options = DIRECT if "Cholesky" in method else None
        law = method.split()[0]
        if law == "friction":  # also where a factorisation is quicker
            options = {"pc_type": "gamg"}
        row = contact(comm, n, solver, options, law)
    row["memory_gb"] = comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 1024**2
    if comm.rank == 0:
        print(json.dumps(row))


def run(method, n, ranks):
    command = [sys.executable, __file__, "--case", method, str(n)]
    command = ["mpirun", "-n", str(ranks), *command] if ranks > 1 else command
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if done.returncode or not lines:
        raise RuntimeError(f"{' '.join(command)}\n{done.stdout}\n{done.stderr}")
    return json.loads(lines[-1])


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--largest", type=int, default=60_000, help="unknowns")
    parser.add_argument("--repeat", type=int, default=3, help="runs, of which the median is shown")
    parser.add_argument("--ranks", type=int, default=1)
    parser.add_argument("--only", default="", metavar="WORD", help="in the methods' names")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    parser.add_argument("--case", nargs=2, metavar=("METHOD", "N"), help=argparse.SUPPRESS)
    args = parser.parse_args(arguments)
    if args.case:
        return case(args.case[0], int(args.case[1]))
    columns = ("iterations", "assembly", "contact", "set-up", "solve", "memory_gb")
    print(f"{'':<22}{'unknowns':>10}" + "".join(f"{c:>12}" for c in columns) + f"{'residual':>12}")
    rows = []
    for size, n in SIZES.items():
        if size > args.largest:
            break
        methods = [m for m in METHODS if size <= LARGEST.get(m, size) and args.only in m]
        found = {method: [] for method in methods}
        for k in range(args.repeat):  # one after the other, so that all see the same machine
            for method in methods:
                if k == 0 or method not in LARGEST or size < 100_000:
                    found[method].append(run(method, n, args.ranks))
        for method, runs in found.items():
            row = {k: statistics.median(r[k] for r in runs) for k in runs[0]}
            rows.append({"method": method, "n": n, **row})
            figures = "".join(f"{row[c]:12.4g}" for c in columns)
            print(f"{method:<22}{row['unknowns']:10}{figures}{row['residual']:12.1e}", flush=True)
    if args.json:
        args.json.write_text(json.dumps(rows, indent=2) + "\n")
    if args.plot:
        picture(rows, args.plot / "solvers.png")
    return rows


def picture(rows, path):
    """Seconds of set-up and solves, and iterations, over unknowns."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    for k, method in enumerate(METHODS):
        colour = f"C{k}"
        own = [row for row in rows if row["method"] == method]
        if not own:
            continue
        unknowns = [row["unknowns"] for row in own]
        seconds = [row["contact"] + row["set-up"] + row["solve"] for row in own]
        axes[0].loglog(unknowns, seconds, ".-", color=colour, label=method)
        if any(row["iterations"] for row in own):
            iterations = [row["iterations"] for row in own]
            axes[1].semilogx(unknowns, iterations, ".-", color=colour)
    axes[0].set(xlabel="unknowns", ylabel="seconds without assembly of the bodies")
    axes[1].set(xlabel="unknowns", ylabel="Krylov iterations of all solves", ylim=(0, None))
    axes[0].legend(fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
