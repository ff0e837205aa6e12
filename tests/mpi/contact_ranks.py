"""Contact with opening and friction on any number of ranks: sorted displacements and forces."""

import json
import sys

import numpy as np
from contact_scenes import Pressed, random_pressed, rectangle
from dolfinx import fem
from mpi4py import MPI
from rigid_scenes import Block
from scenes import sorted_nodes

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.forms import choice as solvers

CONDENSED = 113, 0, "condensed"


def outcome(comm, seed, limit, solver="saddle"):
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
        out[name + "deformed"] = result.deformed.tolist()
        out[name + "gap"] = np.concatenate([s.gap for s in result.sides]).tolist()
    scene.problem.destroy()
    return out


def pressed_outcome(comm, kind, law, form):
    """A ball under a force that is also turned."""
    gdim = 2 if kind == "triangle" else 3
    force = (8.0,) * (gdim - 1) + (90.0,)
    middle = (0.0,) * (gdim - 1) + (-2.05,)
    ball = llm.RigidSphere(middle, 2.0, force=force, pivot=np.zeros(gdim))
    block = Block(kind, lambda R: ball, law, form, comm=comm)
    found = {}
    for turn in (0.0, 0.02):
        result = block.solve(rotation=turn if gdim == 2 else (turn, 0.0, -turn))
        side = result.sides[0]
        for name in ("u", "force", "status"):
            found[f"{kind} {law} {form} {turn} {name}"] = getattr(side, name).tolist()
        found[f"{kind} {law} {form} {turn} place"] = result.displacement.tolist()
    block.problem.destroy()
    return found


def varying_outcome(comm):
    """Friction that varies, as a Function of the upper or the lower mesh."""
    out = {}
    for side in (0, 1):
        rng = np.random.default_rng(5)
        low = rectangle(comm, (7, 4), (-1.0, 0.0), (1.0, 1.0), "quadrilateral", 0.2, rng)
        high = rectangle(comm, (5, 4), (-0.6, 1.0), (0.6, 2.0), "triangle", 0.2, rng)
        mu = fem.Function(compat.function_space((low, high)[side][0]))
        mu.interpolate(lambda x: 0.2 + 0.1 * x[0] ** 2)
        law = llm.Coulomb(mu)
        scene = Pressed((low, high), law, lambda p: p[1] > 2.0 - 1e-9, lambda p: p[1] < 1e-9)
        for drag in (0.0, 0.05):
            scene.move(lambda p, drag=drag: np.array([drag + 0.0 * p[0], -0.03 + 0.0 * p[0]]))
        out[f"varying {side}"] = scene.problem.results[0].frame_friction.tolist()
        scene.problem.destroy()
    return out


# The third part, which every run has, is an obstacle alone: of others see random_ranks.
SEEDS = [[(104, 0), (104, 10**6)], [(103, 10**6), (113, 0), (113, 10**6), CONDENSED], []]
OBSTACLES = [("hexahedron", "flexibility"), ("triangle", "condensed"), ("triangle", "saddle")]

if __name__ == "__main__":
    found, part = {}, int(sys.argv[1])
    for case in SEEDS[part]:
        found |= outcome(MPI.COMM_WORLD, *case)
    kind, form = OBSTACLES[part]
    found |= pressed_outcome(MPI.COMM_WORLD, kind, llm.Coulomb(0.3), form)
    found |= varying_outcome(MPI.COMM_WORLD) if part == 0 else {}
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))
