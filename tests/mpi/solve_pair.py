"""One random pair of blocks on two meshes; prints its forces and displacements as JSON."""

import json

import numpy as np
import pairs
from mpi4py import MPI

problem, error = pairs.random_pair(MPI.COMM_WORLD, 103)
result = problem.results[0]
if MPI.COMM_WORLD.rank == 0:
    record = {
        "error": error,
        "force": np.concatenate([side.force for side in result.sides]).tolist(),
        "u": np.concatenate([side.u for side in result.sides]).tolist(),
        "frame": (result.frame.x + result.frame.v).tolist(),
    }
    print(json.dumps(record))
