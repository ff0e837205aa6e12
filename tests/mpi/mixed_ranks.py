"""Mixed spaces on all ranks, tied and opening; rank 0 prints the errors, of the latter against the
plain problem that it is."""

import json

import mixed
import numpy as np
import second_order_blocks as so
from mpi4py import MPI

import dolfinx_llm as llm

comm, field = MPI.COMM_WORLD, mixed.Field(2, waves=False)
spaces, tags = so.blocks(comm, ("triangle", "triangle"), (4, 6), *mixed.BOXES[2])
with mixed.problem(spaces, tags, field, 0.5) as problem:
    found = dict(zip(("u", "grad u", "p"), mixed.errors(problem.solve(), field), strict=True))
forces = []
for blocks in (None, (("DG", 1, False), ("Lagrange", 2, True))):
    with mixed.pressed(llm.Frictionless(), blocks, comm, "saddle") as problem:
        problem.solve()
        forces.append([side.force for side in problem.results[0].sides])
for side, values in enumerate(zip(*forces, strict=True)):
    found[f"side {side}"] = float(np.abs(np.subtract(*values)).max() / np.abs(values[0]).max())
if comm.rank == 0:
    print(json.dumps(found))
