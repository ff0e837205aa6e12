"""Runs the tutorial, and prints what it found as JSON: tutorial_ranks.py FOLDER"""

import json
import sys

import tutorial
from mpi4py import MPI

result, shares = tutorial.main(sys.argv[1])
if MPI.COMM_WORLD.rank == 0:
    figures = {"shares": shares, "force": result.resultant.tolist()}
    print(json.dumps(figures | {"pressure": result.pressure.tolist()}))
