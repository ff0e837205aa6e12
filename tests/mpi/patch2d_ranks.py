"""Solve the 2D patch test on all ranks; rank 0 prints its errors and frame."""

import json

import patch2d
from mpi4py import MPI

comm = MPI.COMM_WORLD
out = {}
for kind in ("quad", "tri"):
    for separate in (False, True):
        contact = patch2d.problem(patch2d.bodies(comm, kind, 1, separate))
        u, result = contact.solve(), contact.results[0]
        forces = [side.normal_force for side in result.sides]
        found = patch2d.errors(u, forces, [side.area for side in result.sides])
        found["frame"] = result.frame.x.tolist()
        assert len({json.dumps(other) for other in comm.allgather(found)}) == 1
        out[f"{kind} {separate}"] = found
if comm.rank == 0:
    print(json.dumps(out))
