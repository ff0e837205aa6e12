"""Reads steps in time, and goes on by one that is divided: divided_ranks.py FILE

Prints, as JSON, the forces of the interfaces.
"""

import json
import sys

from led_scenes import DT, Led
from mpi4py import MPI

scene = Led("plane", comm=MPI.COMM_WORLD)
scene.s.load(sys.argv[1])
scene.divides(0.5 * DT)
scene.lead(2.0 * DT)
scene.s.step()
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps({"resultants": [r.resultant.tolist() for r in scene.s.problem.results]}))
