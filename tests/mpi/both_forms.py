"""Scenes solved in both forms on all ranks; rank 0 prints by how much they differ as JSON."""

import json
import sys
from dataclasses import replace

import curved_scenes as cs
import numpy as np
import pairs
import scenes
import shrink_fit
import solve_scenes
from mpi4py import MPI

import dolfinx_llm as llm

DIRECT = {"ksp_type": "preonly", "pc_type": "cholesky"}


def random_pair(seed):
    return lambda comm: pairs.random_pair(comm, seed)[0]


def tetrahedra(comm):
    low, high = (-1.0, -1.0, 0.0), (1.0, 1.0, 1.0)
    blocks = [
        pairs.block(comm, (4, 3, 2), low, high, "tetrahedron"),
        pairs.block(comm, (3, 5, 2), (-0.6, -0.7, 1.0), (0.8, 0.9, 2.0), "tetrahedron"),
    ]
    return pairs.stack(blocks, low, high)[0]


def shared_nodes(comm):
    """Two blocks on a base whose nodes under their joint are in both interfaces."""
    low, high = (0.0, 0.0, 0.0), (2.0, 1.0, 1.0)
    blocks = [
        pairs.block(comm, (5, 4, 2), low, high, "hexahedron"),
        pairs.block(comm, (3, 4, 2), (0.0, 0.0, 1.0), (0.9, 1.0, 2.0), "hexahedron"),
        pairs.block(comm, (4, 3, 3), (0.9, 0.0, 1.0), (2.0, 1.0, 2.0), "tetrahedron"),
    ]
    ties = [(0, pairs.ABOVE, 1, pairs.BELOW), (0, pairs.ABOVE, 2, pairs.BELOW)]
    return pairs.stack(blocks, low, high, ties=ties)[0]


def shrink(dim):
    def scene(comm):
        mesh, _, tags = shrink_fit.rings(comm, dim=dim)
        return shrink_fit.problem(mesh, tags)

    return scene


def rings(comm):
    """Curved and tied, a quarter: symmetry planes through both sides, a shear prescribed."""
    V, tags = cs.rings(comm, ((12, 3), (9, 3)))

    def twist(p):
        return np.array([0.01 * p[1] + 0.02 * p[0], 0.01 * p[0], 0.0 * p[0]])

    outer = lambda p: np.isclose(np.hypot(p[0], p[1]), 2.0)  # noqa: E731
    return cs.ring_problem(V, tags, (*cs.QUARTER, (0, outer), (1, outer)), twist)


def prescribed_edge(comm):
    """Displacements prescribed all round the contact."""

    def shear(p):
        return np.array([0.02 * p[2] + 0.01 * p[0] * p[1], 0.01 * p[1], -0.03 * p[2]])

    V, tags = scenes.two_blocks(comm, 4, 5)
    planes = [scenes.on(k, level) for k in (0, 1) for level in (0.0, 1.0)]
    planes += [scenes.on(2, 0.0), scenes.on(2, 2.0)]
    conditions = [(k, where) for k in range(3) for where in planes]
    bcs = scenes.hold(V, conditions, shear)
    a, L = solve_scenes.loaded_forms(V)
    return llm.ContactProblem(a, L, bcs=bcs, interfaces=[llm.Interface(tags, (2, 3))])


SCENES = {
    **{k: scene for k, scene in solve_scenes.SCENES.items() if k != "optimised"},
    "random 104": random_pair(104),
    "tetrahedra": tetrahedra,
    "shared nodes": shared_nodes,
    "shrink fit 2D": shrink(2),
    "shrink fit 3D": shrink(3),
    "rings": rings,
    "prescribed edge": prescribed_edge,
}


def solve(problem, form, options=None):
    """u at this rank's nodes, forces and frames, solved anew in a form."""
    problem.method.renew(replace(problem.method.setting, form=form, options=options))
    u = problem.solve()
    sides = [side for result in problem.results for side in result.sides]
    return {
        "u": np.concatenate([f.x.array for f in (u if isinstance(u, list) else [u])]),
        "λ": np.concatenate([side.force.ravel() for side in sides]),
        "v": np.concatenate([result.frame.v.ravel() for result in problem.results]),
    }


def differences(problem, options) -> dict:
    """Largest difference of each field between the forms, over its largest value."""
    known, found = solve(problem, "saddle"), solve(problem, "condensed", options)
    largest = {}
    for key in known:
        size = max(problem.comm.allgather(np.abs(known[key]).max(initial=0.0)))
        gap = max(problem.comm.allgather(np.abs(known[key] - found[key]).max(initial=0.0)))
        largest[key] = float(gap / size)
    return largest


if __name__ == "__main__":
    comm = MPI.COMM_WORLD
    out = {}
    for name in sys.argv[1:]:
        problem = SCENES[name](comm)
        out[name] = differences(problem, DIRECT)
        out[f"{name}, CG"] = differences(problem, None)
        problem.destroy()
    if comm.rank == 0:
        print(json.dumps(out))
