"""The hairpin of ``folding.py`` on any number of ranks."""

import contextlib
import io
import json

import folding
from mpi4py import MPI

with contextlib.redirect_stdout(io.StringIO()):
    found = folding.main(["--steps", "3"])
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps(found))
