"""Reads steps in time of another number of ranks, and goes on: saved_steps.py FILE TIME"""

import json
import sys

import impact_bar
from mpi4py import MPI

if __name__ == "__main__":
    bar = impact_bar.Bar(10)
    bar.stepper.load(sys.argv[1])
    last = bar.run(float(sys.argv[2]))[-1].tolist()
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps({"last": last}))
