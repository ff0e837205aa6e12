"""Moments on rigid ends, prescribed means and submeshes on all ranks; rank 0 prints answers."""

import json

import numpy as np
import ufl
from contact_scenes import ABOVE, hold_all, rectangle
from dolfinx import fem
from mpi4py import MPI
from submeshes import MAPPED, Halves

import dolfinx_llm as llm
from dolfinx_llm import compat

comm, found = MPI.COMM_WORLD, {}
END = llm.RigidPlane((0.5, 3.0), (0.0, -1.0), force=(0.3, -2.0), moment=0.7, pivot=(0.2, 3.1))
for name, end in ("moment", END), ("mean", llm.MeanDisplacement((0.02, -0.01))):
    domain, tags = rectangle(comm, (3, 6), (0.0, 0.0), (1.0, 3.0), "quadrilateral")
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    problem = llm.ContactProblem(
        200.0 * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * ufl.dx,
        ufl.inner(fem.Constant(domain, np.zeros(2)), w) * ufl.dx,
        bcs=hold_all(V, lambda p: p[1] < 1e-9, lambda p: 0.0 * p),
        interfaces=llm.Interface(tags, (ABOVE, end), law=llm.Tied()),
    )
    problem.solve()
    result = problem.results[0]
    found[name] = [
        *result.displacement,
        *result.resultant,
        *np.atleast_1d(result.moment((0.2, 3.1))),
    ]
    if name == "moment":
        found[name] += [*result.rotation]
    problem.destroy()
if MAPPED:
    for where in "both", "parent":
        problem = Halves(where, comm=comm).problem()
        work = [fem.assemble_scalar(fem.form(ufl.inner(u, u) * ufl.dx)) for u in problem.solve()]
        result = problem.results[0]
        found[f"submeshes {where}"] = [*comm.allreduce(np.array(work)), *result.resultant]
        problem.destroy()
if comm.rank == 0:
    print(json.dumps(found))
