"""Reads a state of another number of ranks, and goes on by a step: saved.py FILE DRAG"""

import json
import sys

import numpy as np
from friction_block import Dragged
from mpi4py import MPI


def figures(problem):
    """What tells states from each other, the same on every rank."""
    result = problem.results[0]
    sides = [[side.force, side.slip, side.gap] for side in result.sides]
    counts = [u.function_space.dofmap.index_map.size_local * 2 for u in problem.u]
    norms = [np.sum(u.x.array[:n] ** 2) for u, n in zip(problem.u, counts, strict=True)]
    norms = problem.comm.allreduce(np.array(norms))
    return [result.resultant, result.pressure, norms, *(part for side in sides for part in side)]


if __name__ == "__main__":
    scene = Dragged(0.3, (6, 9))
    scene.problem.load(sys.argv[1])
    scene.step(float(sys.argv[2]))
    found = [part.tolist() for part in figures(scene.problem)]
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps({"figures": found}))
