"""Solve small sizes of some contact demos on all ranks; rank 0 prints what they found."""

import json
import sys

import cattaneo_mindlin
import friction_block
import hertz2d
import hertz3d
import lift_off
import numpy as np
from mpi4py import MPI

comm = MPI.COMM_WORLD


def found(problem):
    """Forces over the largest one, displacements and gaps of closed pairs, and states.

    Where contact is open the frame is held by the proximal term only, and gaps to it are known to
    rounding over 1e-10 of the surface's stiffness.
    """
    result = problem.results[0]
    force = max(np.abs(side.force).max() for side in result.sides)
    size = max(np.abs(side.u).max() for side in result.sides)
    out = {"pressure": (result.pressure / result.pressure.max()).tolist()}
    for k, side in enumerate(result.sides):
        out[f"force {k}"] = (side.force.ravel() / force).tolist()
        out[f"gap {k}"] = np.where(side.status > 0, side.gap / size, 0.0).tolist()
        out[f"displacement {k}"] = (side.u.ravel() / size).tolist()
        out[f"status {k}"] = side.status.astype(float).tolist()
    return out


def solved(problem):
    problem.solve()
    return problem


def stepped(scene, *steps):
    for step in steps:
        scene.step(step)
    return scene.problem


def slid(scene):
    scene.run(1)
    return scene.problem


PROBLEMS = {
    "hertz2d": lambda: solved(hertz2d.problem("cylinders", (4, 6), growth=0.3)),
    "hertz3d": lambda: solved(hertz3d.problem("block", (2, 3), growth=2.0)),
    "cattaneo": lambda: slid(cattaneo_mindlin.Discs((4, 6))),
    "dragged": lambda: stepped(friction_block.Dragged(0.3, (6, 9)), 0.0, 0.002),
    "tower": lambda: stepped(lift_off.Tower((6, 9)), 0.25),
}
out = {name: found(PROBLEMS[name]()) for name in sys.argv[1:]}
for values in out.values():
    for name, value in values.items():
        spread = np.ptp(comm.allgather(np.asarray(value)), axis=0)
        assert not spread.any(), name
if comm.rank == 0:
    print(json.dumps(out))
