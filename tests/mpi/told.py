"""A small contact scene with the log switched on as a user would: told.py [LEVEL [gathered]]

Where it is gathered rank 0 prints what all ranks told, else it goes to stderr.
"""

import io
import logging
import sys

import contact_scenes
from mpi4py import MPI

from dolfinx_llm import plot  # noqa: F401  (whose import prints nothing either)

comm, log = MPI.COMM_WORLD, logging.getLogger("dolfinx_llm")
told = io.StringIO() if "gathered" in sys.argv else sys.stderr
form = "%(levelname)s rank=%(rank)d %(message)s"
logging.basicConfig(level=logging.WARNING, format=form, stream=told, force=True)
if len(sys.argv) > 1:
    log.setLevel(sys.argv[1])
scene, motions = contact_scenes.random_pressed(comm, 103)
log.debug("built")
scene.move(motions[0])
log.setLevel(logging.NOTSET)
texts = comm.gather("" if told is sys.stderr else told.getvalue())
if comm.rank == 0:
    print(*texts, f"{len(scene.problem.history)} iterations", sep="\n")
