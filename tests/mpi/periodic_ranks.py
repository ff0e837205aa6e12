"""Homogeneous periodic cells on all ranks; rank 0 prints what is left to move."""

import json

import numpy as np
from mpi4py import MPI
from periodic_cells import cell

import dolfinx_llm as llm

comm, found = MPI.COMM_WORLD, []
for gdim, kind in ((2, "triangle"), (3, "hexahedron")):
    for solver in ("saddle", "condensed"):
        problem, _, mean, _ = cell(comm, gdim, kind, 4, llm.Tied(), solver=solver)
        mean.value[:] = np.random.default_rng(7).normal(size=(gdim, gdim))
        largest = np.abs(problem.solve().x.array).max(initial=0.0)
        found.append(comm.allreduce(float(largest), op=MPI.MAX))
        problem.destroy()
if comm.rank == 0:
    print(json.dumps({"moved": found}))
