"""Steps in time of a body of one cell, of which all ranks but one have nothing.

Prints, as JSON, how many ranks have no dofs, the velocity after some steps of free fall along a
plane without friction, and the force on the plane.
"""

import json

import contact_scenes
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

comm = MPI.COMM_WORLD
domain, tags = contact_scenes.rectangle(comm, (1, 1), (0.0, 0.0), (1.0, 2.0), "quadrilateral")
V = compat.function_space(domain, shape=(2,))
u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
a = 100.0 * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * ufl.dx
L = ufl.inner(fem.Constant(domain, (3.0, -10.0)), w) * ufl.dx
plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
interface = llm.Interface(tags, (contact_scenes.BELOW, plane), law=llm.Frictionless())
s = llm.TimeStepper(1.0, a, L, dt=0.1, scheme="newmark", interfaces=interface)
for _ in range(3):
    s.step()
n = s.problem.bulk.dofs.sizes[0]
along = comm.allreduce(s.v.x.array[:n:2].sum()) / 4.0
idle = comm.allreduce(int(n == 0))
if comm.rank == 0:
    force = float(np.abs(s.problem.results[0].resultant[0]))
    print(json.dumps({"idle": idle, "along": along, "friction": force, "t": s.t}))
