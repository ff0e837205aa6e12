"""The finite patch test of the demo; rank 0 prints errors and forces."""

import json
import sys

import finite_patch
import patch2d
from mpi4py import MPI

comm = MPI.COMM_WORLD
kind = sys.argv[1] if len(sys.argv) > 1 else "quad"
boxes = finite_patch.BOXES[2 if kind == "quad" else 3]
contact = finite_patch.problem(patch2d.bodies(comm, kind, boxes=boxes))
contact.solve()
stretch, pressure = finite_patch.errors(contact, finite_patch.stretches(300.0))
forces = [side.force.tolist() for side in contact.results[0].sides]
assert len({json.dumps(f) for f in comm.allgather(forces)}) == 1
force = [c for side in forces for node in side for c in node]
if comm.rank == 0:
    print(json.dumps({"stretch": stretch, "pressure": pressure, "force": force}))
