"""Forces of a tied wall under its weight: python joints.py GDIM DEGREE."""

import json
import sys

import numpy as np
import wall_scenes as walls
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm.geometry.surface import extract_surface


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
        sides = [side for result in problem.results for side in result.sides]
        out[solver] = np.concatenate([side.force for side in sides]).tolist()
        out["redundant"] = int(problem.operators.redundant.sum())
    found = llm.find_interfaces(None, wall.V)
    out["found"] = [interface.name for interface in found]
    sides = [(space, *side) for i in found for space, side in zip((wall.V,) * 2, i.tagged_sides())]
    out["facets"] = [len(extract_surface(*side).facets) for side in sides]
    return out


if __name__ == "__main__":
    found = forces(MPI.COMM_WORLD, *map(int, sys.argv[1:]))
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))
