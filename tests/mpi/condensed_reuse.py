"""Load steps without friction in the condensed form: rank 0 prints, as JSON, what each built anew
and by how much its answer differs from that of the surfaces' flexibility."""

import json

import numpy as np
import scenes
import solve_scenes
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm

LOADS = {"pressed": (-60.0, 0.0), "twice": (-120.0, 0.0), "bent": (-60.0, 150.0)}


def blocks(V, tags, solver, options=None, law=llm.Frictionless()):  # noqa: B008
    """Blocks that are pressed and bent by the returned constants."""
    a, _ = scenes.forms(V)
    x, press, bend = ufl.SpatialCoordinate(V.mesh), *(fem.Constant(V.mesh, 0.0) for _ in "12")
    force = ufl.as_vector([0.1 * press * x[1], 0.0 * press, press + bend * (x[0] - 0.5)])
    L = ufl.inner(force, ufl.TestFunction(V)) * ufl.dx
    held = *solve_scenes.CLAMPED, *((k, scenes.on(2, 2.0)) for k in (0, 1))
    interface = llm.Interface(tags, (2, 3), law=law)
    bcs = scenes.hold(V, held)
    problem = llm.ContactProblem(
        a, L, bcs=bcs, interfaces=[interface], solver=solver, petsc_options=options
    )
    return problem, (press, bend)


def follow(problem, constants):
    """u, pairs in contact and linear solves of each load."""
    for name, values in LOADS.items():
        for constant, value in zip(constants, values, strict=True):
            constant.value = value
        u = problem.solve().x.array.copy()
        yield name, u, [entry["active"] for entry in problem.history]


def largest(comm, values):
    return max(comm.allgather(np.abs(values).max(initial=0.0)))


def compare(comm, options=None):
    scene, out = scenes.two_blocks(comm, 6, 5), {}
    problem, constants = blocks(*scene, "condensed", options)
    known, before = follow(*blocks(*scene, "auto")), 0
    for (name, u, _), (_, v, active) in zip(known, follow(problem, constants)):
        system = problem.method.form.friction or problem.method.form.system
        out[name] = {
            "error": largest(comm, u - v) / largest(comm, u),
            "residual": problem.method.iteration.verdict.residual,
            "active": active,
            "iterations": [step["iterations"] for step in system.steps[before:]],
            "set-ups": system.set_ups,
        }
        before = len(system.steps)
    return out


if __name__ == "__main__":
    found = compare(MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))
