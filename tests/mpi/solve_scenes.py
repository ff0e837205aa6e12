"""Solve several scenes on all ranks; rank 0 prints nodes, displacements, forces and frames."""

import json
import sys

import numpy as np
import paper_data
import patch3d
import scenes
import ufl
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

CLAMPED = tuple((k, scenes.on(2, 0.0)) for k in range(3))


def loaded_forms(V):
    """A body force that bends, twists and shears: nothing about the answer is linear."""
    a, _ = scenes.forms(V)
    x = ufl.SpatialCoordinate(V.mesh)
    force = ufl.as_vector([20.0 * x[1] - 5.0, 10.0 + 8.0 * x[2], -60.0 * x[0] - 10.0])
    return a, ufl.inner(force, ufl.TestFunction(V)) * ufl.dx


def loaded_blocks(comm, conditions, sides=(2, 3)):
    V, tags = scenes.two_blocks(comm)
    a, L = loaded_forms(V)
    interface = llm.Interface(tags, sides)
    return llm.ContactProblem(a, L, bcs=scenes.hold(V, conditions), interfaces=[interface])


def loaded_meshes(comm, order=(0, 1)):
    """The same two blocks on two meshes."""
    sections = [scenes.grid(n, n, jitter=0.25, seed=s) for n, s in ((4, 2001), (3, 11))]
    made = [
        scenes.stacked(comm, (section,), (z, z + 1.0), layers=(2,))
        for section, z in zip(sections, (0.0, 1.0), strict=True)
    ]
    spaces = [compat.function_space(domain, shape=(3,)) for domain, _ in made]
    sides = ((made[0][1], 2), (made[1][1], 1))
    a, L = zip(*(loaded_forms(spaces[i]) for i in order), strict=True)
    return llm.ContactProblem(
        a,
        L,
        bcs=scenes.hold(spaces[0], CLAMPED),
        interfaces=[llm.Interface(None, tuple(sides[i] for i in order))],
    )


def paper_scene(comm, kind, sides=None):
    domain, tags = paper_data.scene(comm, 1)
    V = compat.function_space(domain, shape=(3,))
    options = {} if sides is None else {"sides": sides}
    return patch3d.problem(V, tags, kind, 1, **options)


SCENES = {
    "predicted": lambda comm: paper_scene(comm, "predicted"),
    "paper": lambda comm: paper_scene(comm, "paper"),
    "optimised": lambda comm: paper_scene(comm, "optimised"),
    "clamped": lambda comm: loaded_blocks(comm, CLAMPED),
    "symmetric": lambda comm: loaded_blocks(comm, scenes.SYMMETRY),
    "two meshes": loaded_meshes,
}


def collect(contact) -> dict:
    """Everything that must not depend on the number of ranks."""
    u = contact.solve()
    nodes = [scenes.sorted_nodes(f) for f in (u if isinstance(u, list) else [u])]
    result = contact.results[0]
    found = {
        "x": np.concatenate([x for x, _ in nodes]),
        "u": np.concatenate([value for _, value in nodes]),
        "frame": result.frame.x,
        "cells": result.frame.cells,
        "v": result.frame.v,
    }
    for k, side in enumerate(result.sides):
        found |= {f"x{k}": side.x, f"force{k}": side.force, f"slip{k}": side.slip}
    return {key: value.tolist() for key, value in found.items()}


def same_on_all_ranks(comm, found: dict) -> None:
    """Results are promised to be the same on every rank: to the last bit."""
    for other in comm.allgather(found):
        assert other == found, "the ranks hold different results"


if __name__ == "__main__":
    comm = MPI.COMM_WORLD
    out = {}
    for name in sys.argv[1:]:
        out[name] = collect(SCENES[name](comm))
        same_on_all_ranks(comm, out[name])
    if comm.rank == 0:
        print(json.dumps(out))
