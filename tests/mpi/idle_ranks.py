"""Bodies of one cell, of which all ranks but one have nothing: steps in time along a plane without
friction ("sliding") and of a nonlinear body that flies ("flying"), a load step by multigrid
("pressed").

Prints, as JSON, how many ranks have no dofs, and the mean velocity, or displacement, and the force
along the plane.
"""

import json
import sys

import contact_scenes
import finite_patch
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

comm, scene = MPI.COMM_WORLD, sys.argv[1]
domain, tags = contact_scenes.rectangle(comm, (1, 1), (0.0, 0.0), (1.0, 2.0), "quadrilateral")
V = compat.function_space(domain, shape=(2,))
u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
a = 100.0 * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * ufl.dx
load = ufl.inner(fem.Constant(domain, (3.0, -10.0)), w) * ufl.dx
plane = llm.RigidPlane((0.0, -9.0 if scene == "flying" else 0.0), (0.0, 1.0))
law = llm.Tied() if scene == "pressed" else llm.Frictionless()
interface = llm.Interface(tags, (contact_scenes.BELOW, plane), law=law)
bent = fem.Function(V)
F = finite_patch.residual(bent, 40.0, 60.0) - load
if scene == "pressed":
    problem = llm.NonlinearContactProblem(F, bent, interfaces=[interface], solver="condensed")
    problem.solve()
    found = problem.u
else:
    form = (a, load) if scene == "sliding" else (F, bent)
    s = llm.TimeStepper(1.0, *form, dt=0.1, scheme="newmark", interfaces=interface)
    for _ in range(3):
        s.step()
    problem, found = s.problem, s.v
n = problem.bulk.dofs.sizes[0]
along = comm.allreduce(found.x.array[:n:2].sum()) / 4.0
idle = comm.allreduce(int(n == 0))
if comm.rank == 0:
    force = float(np.abs(problem.results[0].resultant[0]))
    print(json.dumps({"idle": idle, "along": along, "friction": force}))
