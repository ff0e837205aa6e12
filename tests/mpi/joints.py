"""Forces of a tied wall under its weight: python joints.py GDIM."""

import json
import sys

import numpy as np
import wall_scenes as walls
from mpi4py import MPI

comm, gdim = MPI.COMM_WORLD, int(sys.argv[1])
blocks = walls.courses(3, 2, bond=0.3) if gdim == 2 else walls.cubes(2, 2, 2)
counts = np.random.default_rng(7).integers(2, 5, (len(blocks), gdim))
wall = walls.Wall(comm, blocks, counts, "triangle" if gdim == 2 else "hexahedron", turn=0.2)
out = {}
for solver in ("saddle", "condensed"):
    problem = wall.problem(weight=1.0, solver=solver)
    problem.solve()
    forces = [side.force for result in problem.results for side in result.sides]
    out[solver] = np.concatenate(forces).tolist()
    out["redundant"] = int(problem.operators.redundant.sum())
if comm.rank == 0:
    print(json.dumps(out))
