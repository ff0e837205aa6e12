"""Supports that go, and come back, between load steps at finite deformation; of a law and solver.

Prints, as JSON, what differs from the same with the supports of the end.
"""

import json
import sys

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from pressed_scenes import Punch

import dolfinx_llm as llm

LAWS = {"tied": llm.Tied(), "friction": llm.Coulomb(0.5)}


def along_free(punch):
    """The punch's top is held down alone: its conditions are of one component."""
    V, value = punch.u[1].function_space, punch.ends[1].value
    W, _ = V.sub(1).collapse()
    down = fem.Function(W)
    down.x.array[:] = value[1]
    dofs = fem.locate_dofs_geometrical((V.sub(1), W), lambda p: np.isclose(p[1], 1.5))
    return fem.dirichletbc(down, dofs, V.sub(1))


def found(comm, law, solver):
    """Forces of an end that is dragged and then left to itself: of its supports along the surface
    and across, over the normal force; and of one that never was dragged, where that is the same."""
    punch, still = (Punch(law=LAWS[law], comm=comm, solver=solver) for _ in range(2))
    dragged = punch.to(0.05, 0.02).resultant
    clamp = punch.bcs[1]
    punch.bcs[1] = along_free(punch)
    free = punch.to(0.05, 0.02).resultant
    again = punch.to(0.05, 0.02, 2).resultant
    still.ends[1].value[1] = -0.05
    still.bcs[1] = along_free(still)
    known = still.to(0.05).resultant
    place = comm.allreduce(float(punch.u[1].x.array[::2].max(initial=-1.0)), op=MPI.MAX)
    punch.bcs[1] = clamp
    back = punch.to(0.05, 0.02).resultant
    return {
        "dragged": abs(dragged[0] / dragged[1]),
        "free": abs(free[0] / free[1]),
        "again": float(np.abs(again - free).max() / abs(free[1])),
        "known": float(np.abs(known - free).max() / abs(free[1])),
        "back": float(np.abs(back - dragged).max() / abs(free[1])),
        "place": place,
    }


if __name__ == "__main__":
    law, solver = sys.argv[1:]
    result = found(MPI.COMM_WORLD, law, solver)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(result))
