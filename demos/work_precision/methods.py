"""The methods of ``error_vs_time.py``: one scene solved by one of them, timed by stage."""

import json
import resource
import sys
import time
from importlib import metadata

import dolfinx
import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc
from solvers import DIRECT, body_modes, solve_scaled
from work_precision.evaluation import median_run
from work_precision.plan import (
    CHOLESKY,
    GAMG,
    LAW,
    MATCHING,
    MPC,
    MULTIGRID,
    NODE_TO_SEGMENT,
    POSITIONS,
    STAGES,
    UNDESIGNED,
)
from work_precision.scenes import SCENES

import dolfinx_llm as llm
from dolfinx_llm import compat

try:
    import dolfinx_mpc
except ImportError:
    dolfinx_mpc = None

SHORT = 1.0  # [s] of wall time: for so long what is quick is repeated
OPTIONS = {CHOLESKY: DIRECT, GAMG: None}
OF_PROBLEM = {  # stages of ContactProblem.times by the names of the table
    "surfaces": "surfaces", "patch forces": "patch forces", "frame": "design", "design": "design",
    "location": "location", "operators": "operators", "support check": "operators",
    "assembly of K": "bulk assembly", "assembly of f": "bulk assembly", "factorisation": "set-up",
    "solve": "solve", "results": "solve", "iteration of contact laws": "law",
}  # fmt: skip


def solver_options(solver):
    options = {"Cholesky": DIRECT, MULTIGRID.split()[1]: {"pc_type": "gamg"}}
    chosen = options.get(solver.split()[-1]) if solver != GAMG else None
    return {"solver": solver.split()[0], "petsc_options": chosen}


def with_frame(scene, problem):
    """The method of this package; forms are compiled once for all runs, and not counted."""
    u = scene.solve(problem)
    row = dict.fromkeys(STAGES, 0.0)
    for stage in problem.times.keys() & OF_PROBLEM.keys():
        row[OF_PROBLEM[stage]] += problem.times[stage]
    unknowns = problem.unknowns
    row["unknowns"] = sum(unknowns.values())
    if problem.form == "condensed":
        row["unknowns"] = unknowns["u"] - unknowns["lambda"] + unknowns["v"]
    form = problem.method.form
    system = getattr(form, "friction", None) or getattr(form, "system", None)
    iterations = system.iterations if system is not None else len(problem.history)
    row |= {"iterations": iterations, "form": problem.form, **scene.errors(u, problem)}
    problem.destroy()
    return row


def node_to_segment(scene, V, tags, slave):
    """The frame that the problem brings along is left out of the account."""
    problem = scene.problem(V, tags, UNDESIGNED, solver="saddle")
    clock = [time.perf_counter()]
    ties = llm.classical.NodeToSegment(problem, slave=slave)
    clock.append(time.perf_counter())
    problem.bulk.load()
    clock.append(time.perf_counter())
    for _ in range(2):  # the second is without the factorisation
        u = ties.solve()
        clock.append(time.perf_counter())
    located, load, first, second = np.diff(clock)
    row = {
        **dict.fromkeys(STAGES, 0.0), "bulk assembly": problem.times["assembly of K"] + load,
        "surfaces": problem.times["surfaces"], "location": located,
        "set-up": first - second, "solve": second - load,
        "unknowns": problem.unknowns["u"] + ties.multiplier.size, "iterations": 0,
    }  # fmt: skip
    row |= scene.errors(u, pressure=slave_pressure(ties, problem.geometries[0].pairs[slave], slave))
    ties.destroy()
    problem.destroy()
    return row


def slave_pressure(ties, pairs, slave):
    """Nodes, areas and pressures of the slave's nodes that are in contact."""
    at = {tuple(x): k for k, x in enumerate(ties.x.round(9))}
    tied, node = np.array([(at[x], k) for k, x in enumerate(map(tuple, pairs.x.round(9)))
                           if x in at]).T  # fmt: skip
    force = ties.force[tied, 2] * (1.0 if slave else -1.0)
    return pairs.x[node], pairs.forces[node], force / pairs.forces[node]


def one_mesh(scene, V, a, L, bcs, solver, nodal=(), constraint=None):
    """Bodies that share their nodes, or are tied by a finalised ``MultiPointConstraint``."""
    a, L = fem.form(a), fem.form(L)
    began = time.perf_counter()
    space, n = V, V.dofmap.index_map.size_local * 3
    out = ~np.isnan(compat.prescribed_values(V, bcs)[:n])
    if constraint is None:
        K = compat.assemble_matrix(a, bcs, 1.0)
        f = compat.assemble_load(L, a, bcs, compat.prescribed(V, bcs), nodal)
    else:
        K, f = constrained_system(constraint, V, a, L, bcs, nodal)
        space = constraint.function_space
        out[constraint.slaves[: constraint.num_local_slaves]] = True
    assembled = time.perf_counter() - began
    x, took = solve_scaled(K, f, body_modes(V, out), OPTIONS[solver])
    u = fem.Function(space)
    u.x.array[:n] = x
    u.x.scatter_forward()
    if constraint is not None:
        constraint.backsubstitution(getattr(u, "vector", u))  # 0.5 wants the vector
    K.destroy()
    unknowns = V.dofmap.index_map.size_global * 3
    row = {**dict.fromkeys(STAGES, 0.0), "bulk assembly": assembled, "unknowns": unknowns}
    return {**row, **took, **scene.errors(u)}


def constrained_system(constraint, V, a, L, bcs, nodal):
    """Matrix and load of dolfinx_mpc; nodal loads act on no slave node."""
    K = dolfinx_mpc.assemble_matrix(a, constraint, bcs=bcs)
    b = dolfinx_mpc.assemble_vector(L, constraint)
    dolfinx_mpc.apply_lifting(b, [a], [bcs], constraint)
    b.ghostUpdate(addv=PETSc.InsertMode.ADD_VALUES, mode=PETSc.ScatterMode.REVERSE)
    n = V.dofmap.index_map.size_local * 3
    f = b.array_r[:n] + sum((load.x.array[:n] for load in nodal), np.zeros(n))
    b.destroy()
    fixed = compat.prescribed_values(V, bcs)[:n]
    return K, np.where(np.isnan(fixed), f, fixed)


def multi_point(scene, V, tags, slip, slave, solver):
    """dolfinx_mpc's tied or slip condition; the time of both is that of "location"."""
    a, L, bcs, nodal = scene.forms(V, tags)
    bcs = bcs + (scene.slip_supports(V) if slip else [])
    began = time.perf_counter()
    constraint = dolfinx_mpc.MultiPointConstraint(V)
    sides = scene.sides[slave], scene.sides[1 - slave]
    if slip:
        normal = fem.Function(V)
        normal.x.array[2::3] = 1.0
        constraint.create_contact_slip_condition(tags, *sides, normal)
    else:
        constraint.create_contact_inelastic_condition(tags, *sides)
    constraint.finalize()
    located = time.perf_counter() - began
    row = one_mesh(scene, V, a, L, bcs, solver, nodal, constraint)
    return {**row, "location": located}


# ## One case
def scene_of(name):
    """A scene by name; those of opening and friction need gmsh."""
    if name in SCENES:
        return SCENES[name]
    from work_precision import law_scenes

    return law_scenes.SCENES[name]


def solve(comm, name, method, solver, n):
    """A row of the table: figures of one method and solver on one scene of size n."""
    scene, began, cpu = scene_of(name), time.perf_counter(), time.process_time()
    if name == "Hertz" or method == LAW:
        problem = scene.problem(comm, n, method, **solver_options(solver))
        # What the problem does not time itself is the mesh.
        meshed = time.perf_counter() - began - sum(problem.times.values())
        row = with_frame(scene, problem)
    elif method == MATCHING:
        V, *forms = scene.matching(comm, n)
        meshed = time.perf_counter() - began
        row = one_mesh(scene, V, *forms, solver)
    else:
        V, tags = scene.bodies(comm, n)
        meshed = time.perf_counter() - began
        if method.startswith(NODE_TO_SEGMENT):
            row = node_to_segment(scene, V, tags, int(method[-1]))
        elif method.startswith(MPC):
            row = multi_point(scene, V, tags, "slip" in method, int(method[-1]), solver)
        else:
            row = with_frame(scene, scene.problem(V, tags, method, **solver_options(solver)))
    row["mesh"] = meshed
    row["wall"], row["cpu"] = time.perf_counter() - began, time.process_time() - cpu
    row["cpu"] = comm.allreduce(row["cpu"])
    row["memory"] = comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 1024**2
    row["seconds"] = sum(row[stage] for stage in STAGES if stage != "mesh")
    # Other work on the machine stretches wall times, not these.
    row["cpu_seconds"] = row["seconds"] * row["cpu"] / (row["wall"] * comm.size)
    return {"scene": name, "method": method, "solver": solver, "n": n, **row}


def versions(comm):
    """What the figures depend on."""
    packages = {d.metadata["Name"]: d.version for d in metadata.distributions()}
    found = {name: packages[name] for name in ("numpy", "scipy") if name in packages}
    found |= {"dolfinx": dolfinx.__version__}
    found |= {"dolfinx_mpc": packages.get("dolfinx_mpc", "there")} if dolfinx_mpc else {}
    petsc = ".".join(map(str, PETSc.Sys.getVersion()))
    return {"ranks": comm.size, "python": sys.version.split()[0], "PETSc": petsc, **found}


def repeated(comm, *case):
    """The same, the median of several solves where one is over at once."""
    rows, began = [], time.perf_counter()
    while not rows or comm.bcast(len(rows) < 9 and time.perf_counter() - began < SHORT):
        rows.append(solve(comm, *case))
    return median_run(rows)


def run(name, cases):
    """Print a line of JSON per (method, solver, sizes) and size, on rank 0."""
    comm = MPI.COMM_WORLD

    def say(line):
        if comm.rank == 0:
            print(json.dumps(line), flush=True)

    say({"about": versions(comm)})
    for method, solver, sizes in cases:
        if dolfinx_mpc is None and method.startswith(MPC):
            continue
        # The first solve loads libraries and forms; a search for positions is too long for that.
        solve(comm, name, UNDESIGNED if method == POSITIONS else method, solver, min(sizes))
        for n in sizes:
            try:
                say(repeated(comm, name, method, solver, n))
            except llm.ContactError as error:  # raised on all ranks together
                case = {"scene": name, "method": method, "solver": solver, "n": n}
                say({**case, "failed": str(error)})
