"""Whole surfaces tagged, on any number of ranks: sorted displacements, forces, notes."""

import json
import sys

import facing_scenes as scenes_of
import numpy as np
from mpi4py import MPI
from scenes import sorted_nodes

import dolfinx_llm as llm


def outcome(problem):
    out = {f"u {k}": sorted_nodes(f)[1].tolist() for k, f in enumerate(problem.u)}
    for k, (geometry, result) in enumerate(zip(problem.geometries, problem.results, strict=True)):
        out[f"force {k}"] = np.concatenate([s.force for s in result.sides]).tolist()
        out[f"notes {k}"] = [len(note) for note in geometry.notes]
        out[f"facets {k}"] = [len(side.facets) for side in geometry.sides]
    problem.destroy()
    return out


SCENES = {
    "roller": lambda comm: scenes_of.on_block(comm, llm.Coulomb(0.3), block=True),
    "3D": lambda comm: scenes_of.on_block(comm, llm.Frictionless(), block=True, depth=0.5, n=24),
    "O-ring": lambda comm: scenes_of.squeezed(comm, llm.Frictionless(), seed=5),
}

if __name__ == "__main__":
    comm, found = MPI.COMM_WORLD, {}
    for name in sys.argv[1:]:
        found |= {f"{name} {key}": value for key, value in outcome(SCENES[name](comm)[0]).items()}
    if comm.rank == 0:
        print(json.dumps(found))
