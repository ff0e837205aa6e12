"""Friction on an obstacle by the condensed form where a rank owns clamped nodes alone: rank 0
prints, as JSON, the resultants of load steps from stick into slip."""

import json

import numpy as np
import ufl
from contact_scenes import BELOW, hold_all, rectangle, stress
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

DRAGS = [(0.0, 0.01), (0.001, 0.01), (0.003, 0.011), (0.05, 0.011)]


def resultants(comm):
    """Of one cell, which one rank owns, and of a body that is clamped all over."""
    bodies = [rectangle(comm, *of, "quadrilateral") for of in (((1, 1), (0, 0), (1, 1)),)]
    bodies += [rectangle(comm, (4, 4), (2, 0), (3, 1), "quadrilateral")]
    spaces = [compat.function_space(domain, shape=(2,)) for domain, _ in bodies]
    forms = [(ufl.TrialFunction(V), ufl.TestFunction(V)) for V in spaces]
    floor = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    problem = llm.ContactProblem(
        [ufl.inner(stress(u), ufl.grad(w)) * ufl.dx for u, w in forms],
        [ufl.inner(fem.Constant(V.mesh, np.zeros(2)), w) * ufl.dx
         for V, (_, w) in zip(spaces, forms, strict=True)],
        bcs=hold_all(spaces[0], lambda p: p[1] > 0.5, np.zeros_like)
        + hold_all(spaces[1], lambda p: p[0] > 1.5, np.zeros_like),
        interfaces=[llm.Interface(bodies[0][1], (BELOW, floor), law=llm.Coulomb(0.5))],
        solver="condensed", petsc_options={"pc_type": "gamg"},
    )  # fmt: skip
    found = []
    for floor.displacement in DRAGS:
        problem.solve()
        found.append(problem.results[0].resultant.tolist())
    return found


if __name__ == "__main__":
    found = resultants(MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps({"resultants": found}))
