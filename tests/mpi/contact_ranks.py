"""Contact with opening and friction on any number of ranks: sorted displacements and forces."""

import json

import numpy as np
from contact_scenes import random_pressed
from mpi4py import MPI
from scenes import sorted_nodes

from dolfinx_llm.forms import choice as solvers

CONDENSED = 113, 0, "condensed"


def outcome(comm, seed, limit, solver="auto"):
    solvers.FLEXIBLE = limit
    scene, motions = random_pressed(comm, seed, solver=solver)
    out = {}
    for k, motion in enumerate(motions):
        u = scene.move(motion)
        result = scene.problem.results[0]
        name = f"{seed} {limit} {solver} {k} "
        out[name + "u"] = np.concatenate([sorted_nodes(f)[1] for f in u]).tolist()
        out[name + "force"] = np.concatenate([s.force for s in result.sides]).tolist()
        out[name + "status"] = np.concatenate([s.status for s in result.sides]).tolist()
        out[name + "gap"] = np.concatenate([s.gap for s in result.sides]).tolist()
    scene.problem.destroy()
    return out


if __name__ == "__main__":
    found = {}
    for case in ((103, 10**6), (104, 10**6), (113, 10**6), (104, 0), (113, 0), CONDENSED):
        found |= outcome(MPI.COMM_WORLD, *case)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))
