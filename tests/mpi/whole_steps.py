"""Random scenes by steps on the whole system, in one part: rank 0 prints, as JSON, by how much u
differs from that of the surfaces' flexibility, and the worst violation of a condition."""

import json
import sys

import numpy as np
from contact_scenes import random_pressed, violations
from mpi4py import MPI

from dolfinx_llm.contact import load_steps
from dolfinx_llm.forms import choice as solvers


def follow(comm, seed, solver, limit):
    """u of all motions and the worst violation."""
    solvers.FLEXIBLE = limit
    scene, motions = random_pressed(comm, seed, solver=solver)
    u, worst = [], 0.0
    for motion in motions:
        u += [f.x.array.copy() for f in scene.move(motion)]
        worst = max(worst, *violations(scene.problem).values())
    form = scene.problem.form
    scene.problem.destroy()
    return np.concatenate(u), worst, form


def compare(comm, seed):
    """Per form the difference of u, over its size, and the worst violation."""
    load_steps.SMALLEST = 1.0
    known, _, form = follow(comm, seed, "saddle", 10**6)
    assert form == "flexibility"
    size, found = max(comm.allgather(np.abs(known).max())), {}
    for solver in ("saddle", "condensed"):
        u, worst, form = follow(comm, seed, solver, 0)
        assert form == solver
        error = max(comm.allgather(np.abs(u - known).max())) / size
        found[solver] = {"error": float(error), "violation": float(worst)}
    return found


if __name__ == "__main__":
    found = {seed: compare(MPI.COMM_WORLD, int(seed)) for seed in sys.argv[1:]}
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))
