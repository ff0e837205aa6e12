"""The finite patch test of the demo, and bodies with friction; rank 0 prints errors and forces."""

import json
import sys

import finite_patch
import patch2d
import turned_strips
from mpi4py import MPI
from pressed_scenes import Punch

import dolfinx_llm as llm
from dolfinx_llm.problem import nonlinear_system

if "condensed" in sys.argv:
    nonlinear_system.FROM_UNKNOWNS = {2: 0, 3: 0}
comm = MPI.COMM_WORLD
kind = sys.argv[1] if len(sys.argv) > 1 else "quad"
degree = 2 if "second" in sys.argv else 1
boxes = finite_patch.BOXES[2 if kind == "quad" else 3]
contact = finite_patch.problem(patch2d.bodies(comm, kind, boxes=boxes), degree=degree)
contact.solve()
stretch, pressure = finite_patch.errors(contact, finite_patch.stretches(300.0))
forces = [side.force.tolist() for side in contact.results[0].sides]
assert len({json.dumps(f) for f in comm.allgather(forces)}) == 1
force = [c for side in forces for node in side for c in node]
if kind == "quad":  # strips that stick and slip under friction
    strips = turned_strips.Strips(llm.Coulomb(0.2))
    strips.step(0.0)
    sheared = strips.step(turned_strips.SHIFT)[0]
    assert min(strips.counts()[:2]) > 0
    force += sheared.ravel().tolist()
elif "condensed" not in sys.argv:  # whose patch alone is compared
    punch = Punch(kind, llm.Coulomb(0.3), comm=comm, degree=degree)
    side = punch.to(down=0.05, along=0.01).sides[1]
    assert {1, 2} <= set(side.status)
    force += side.force.ravel().tolist()
if comm.rank == 0:
    print(json.dumps({"stretch": stretch, "pressure": pressure, "force": force}))
