"""Curved scenes on all ranks; with "errors": those that must be refused."""

import json
import re
import sys

import curved_scenes as cs
import numpy as np
import scenes
import shrink_fit
from mpi4py import MPI

import dolfinx_llm as llm

TOO_FAR = ((1.0, 1.3), (1.5, 2.0))
REFUSED = {
    r"too far apart: at .* lie 0\.2.* size 0\..*Check positions": ((2, 3), TOO_FAR, {}),
    r"do not face each other: .* cosine 1\.000": ((1, 3), ((1.5, 1.7), (1.5, 2.0)), {}),
    r"needs flat sides": ((2, 3), ((1.0, 1.5), (1.5, 2.0)), {"design": "positions"}),
}


def refused(comm):
    """Messages that are missing or wrong."""
    wrong = []
    for words, (sides, radii, options) in REFUSED.items():
        V, tags = cs.rings(comm, ((22, 3), (16, 3)), radii)
        a, L = scenes.forms(V)
        try:
            llm.ContactProblem(a, L, interfaces=[llm.Interface(tags, sides, **options)])
            wrong.append(f"{words}: no error")
        except llm.ContactError as error:
            if not re.search(words, str(error), re.DOTALL):
                wrong.append(str(error))
    return {"wrong": wrong}


def solved(comm):
    """Nodes, forces and frame of the demo's shrink fit."""
    mesh, _, tags = shrink_fit.rings(comm)
    contact = shrink_fit.problem(mesh, tags)
    u = contact.solve()
    x, value = scenes.sorted_nodes(u)
    result = contact.results[0]
    found = {"x": x, "u": value, "frame": result.frame.x, "v": result.frame.v}
    for k, side in enumerate(result.sides):
        found |= {f"force {k}": side.force, f"area {k}": side.area}
    return {key: np.asarray(a).tolist() for key, a in found.items()}


if __name__ == "__main__":
    comm = MPI.COMM_WORLD
    out = refused(comm) if sys.argv[1:] == ["errors"] else solved(comm)
    everywhere = comm.allgather(out)
    assert all(other == out for other in everywhere) or sys.argv[1:] != ["errors"]
    if comm.rank == 0:
        print(json.dumps(out))
