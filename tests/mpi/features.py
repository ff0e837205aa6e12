"""Random scenes of documented features, as JSON: features.py SOLVER SEED SEED ..."""

import json
import sys
import tempfile

import random_features
from mpi4py import MPI

COMM = MPI.COMM_WORLD

with tempfile.TemporaryDirectory() as own:
    folder = COMM.bcast(own)
    found = {s: random_features.run(int(s), COMM, folder, sys.argv[1]) for s in sys.argv[2:]}
    COMM.barrier()
if COMM.rank == 0:
    print(json.dumps(found))
