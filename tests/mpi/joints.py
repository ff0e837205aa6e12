"""Forces of walls: tied and under weight, python joints.py GDIM DEGREE, else with friction."""

import json
import sys

import numpy as np
import ufl
import wall_scenes as walls
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm.geometry.surface import extract_surface


def all_forces(problem):
    """(n, gdim) of all sides."""
    return np.concatenate([side.force for result in problem.results for side in result.sides])


def rubbing(comm, solver):
    """Courses with T joints under weight and a side load."""
    wall = walls.Wall(comm, walls.courses(2, 2), np.random.default_rng(5).integers(2, 5, (5, 2)))
    load = fem.Constant(wall.domain, np.array([0.2, -1.0]))
    problem = llm.ContactProblem(
        wall.forms()[0],
        ufl.inner(load, ufl.TestFunction(wall.V)) * ufl.dx,
        bcs=wall.base(),
        interfaces=wall.interfaces(llm.Coulomb(0.6)),
        solver=solver,
    )
    problem.solve()
    return problem


def rubbing_forces(comm):
    """By both forms."""
    return {form: all_forces(rubbing(comm, form)).tolist() for form in ("saddle", "condensed")}


def forces(comm, gdim, degree=1):
    """By both forms, and how many rows repeat others."""
    blocks = walls.courses(2, 2, bond=0.3) if gdim == 2 else walls.cubes(2, 2, 2)
    counts = np.random.default_rng(7).integers(2, 5, (len(blocks), gdim))
    wall = walls.Wall(
        comm, blocks, counts, "triangle" if gdim == 2 else "hexahedron", turn=0.2, degree=degree
    )
    out = {}
    for solver in ("saddle", "condensed"):
        problem = wall.problem(weight=1.0, solver=solver)
        problem.solve()
        out[solver] = all_forces(problem).tolist()
        out["redundant"] = int(problem.operators.redundant.sum())
    found = llm.find_interfaces(None, wall.V)
    out["found"] = [interface.name for interface in found]
    sides = [(space, *side) for i in found for space, side in zip((wall.V,) * 2, i.tagged_sides())]
    out["facets"] = [len(extract_surface(*side).facets) for side in sides]
    return out


if __name__ == "__main__":
    comm, numbers = MPI.COMM_WORLD, [int(word) for word in sys.argv[1:]]
    found = forces(comm, *numbers) if numbers else rubbing_forces(comm)
    if comm.rank == 0:
        print(json.dumps(found))
