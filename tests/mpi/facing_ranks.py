"""Whole surfaces tagged, on any number of ranks: sorted displacements, forces, notes."""

import json

import numpy as np
import test_facing as scenes_of
from mpi4py import MPI
from scenes import sorted_nodes

import dolfinx_llm as llm


def outcome(problem):
    out = {f"u {k}": sorted_nodes(f)[1].tolist() for k, f in enumerate(problem.u)}
    for k, (model, result) in enumerate(zip(problem.models, problem.results, strict=True)):
        out[f"force {k}"] = np.concatenate([s.force for s in result.sides]).tolist()
        out[f"notes {k}"] = [len(note) for note in model.notes]
        out[f"facets {k}"] = [len(side.facets) for side in model.sides]
    problem.destroy()
    return out


if __name__ == "__main__":
    comm, found = MPI.COMM_WORLD, {}
    for name, problem in {
        "roller": scenes_of.on_block(comm, llm.Coulomb(0.3), block=True)[0],
        "3D": scenes_of.on_block(comm, llm.Frictionless(), block=True, depth=0.5, n=24)[0],
        "O-ring": scenes_of.squeezed(comm, llm.Frictionless(), seed=5)[0],
    }.items():
        found |= {f"{name} {key}": value for key, value in outcome(problem).items()}
    if comm.rank == 0:
        print(json.dumps(found))
