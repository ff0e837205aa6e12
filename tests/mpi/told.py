"""A small contact scene with the log switched on as a user would: told.py [LEVEL]"""

import logging
import sys

import contact_scenes
from mpi4py import MPI

logging.basicConfig(level=logging.WARNING, format="rank=%(rank)d %(message)s", force=True)
if len(sys.argv) > 1:
    logging.getLogger("dolfinx_llm").setLevel(sys.argv[1])
scene, motions = contact_scenes.random_pressed(MPI.COMM_WORLD, 103)
logging.getLogger("dolfinx_llm").debug("built")
scene.move(motions[0])
if MPI.COMM_WORLD.rank == 0:
    print(f"{len(scene.problem.history)} iterations")
