"""One rank waits for a message that never comes."""

import time

from mpi4py import MPI

if MPI.COMM_WORLD.rank == 1:
    while not MPI.COMM_WORLD.iprobe(source=0):
        time.sleep(0.1)
MPI.COMM_WORLD.barrier()
