"""Mixed spaces on all ranks, tied and opening; rank 0 prints the errors, of the latter against the
plain problem that it is. Displacements are written."""

import json
from tempfile import TemporaryDirectory

import mixed
import numpy as np
import second_order_blocks as so
from mpi4py import MPI

import dolfinx_llm as llm

comm, field = MPI.COMM_WORLD, mixed.Field(2, waves=False)
spaces, tags = so.blocks(comm, ("triangle", "triangle"), (4, 6), *mixed.BOXES[2])
with mixed.problem(spaces, tags, field, 0.5) as problem:
    found = dict(zip(("u", "grad u", "p"), mixed.errors(problem.solve(), field), strict=True))
for make in (llm.ContactProblem, mixed.nonlinear):
    forces = []
    for blocks in (None, (("DG", 1, False), ("Lagrange", 2, True))):
        problem = mixed.pressed(llm.Frictionless(), blocks, comm, "saddle", make)
        problem.solve()
        forces.append([side.force for side in problem.results[0].sides])
        with TemporaryDirectory() as own:
            folder = comm.bcast(own)
            with llm.post.LoadSteps(problem, folder) as files:
                files.write()
            llm.post.write_bodies(f"{folder}/bodies.pvd", problem.u)
            comm.barrier()
        problem.destroy()
    for side, values in enumerate(zip(*forces, strict=True)):
        error = np.abs(np.subtract(*values)).max() / np.abs(values[0]).max()
        found[f"{make.__name__}, side {side}"] = float(error)
if comm.rank == 0:
    print(json.dumps(found))
