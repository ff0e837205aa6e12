"""Run scripts that rank 0 is told by lines on stdin, so that an exception on one rank ends all.

A line is JSON: the mark that ends the output, the script, its arguments.
"""

import faulthandler
import gc
import json
import logging
import os
import runpy
import signal
import sys
import time
import traceback

from mpi4py import MPI
from petsc4py import PETSc

import dolfinx_llm  # noqa: F401  (before the first script: what that sets is put back)
from dolfinx_llm.base.disposable import Remains

comm = MPI.COMM_WORLD


def run(command):
    """One script, in a state like that of a fresh process."""
    argv, sys.argv = sys.argv, command
    ours = [m for name, m in sys.modules.items() if name.split(".")[0] == "dolfinx_llm"]
    names = [(m, dict(vars(m))) for m in ours]
    root = logging.root
    log = root.handlers[:], root.level, root.manager.disable
    try:
        runpy.run_path(command[0], run_name="__main__")
    except SystemExit as end:
        if end.code:
            raise
    finally:
        for m, before in names:  # constants that the script has set
            vars(m).update(before)
        root.handlers[:], root.level, root.manager.disable = log
        sys.argv = argv
    gc.collect()
    Remains.dropped, Remains.told = 0, False  # what the script has left
    if hasattr(PETSc, "garbage_cleanup"):
        PETSc.garbage_cleanup()


def told():
    """The next command, known to all ranks; those that wait sleep, since waiting in MPI takes a
    core."""
    if comm.rank == 0:
        command = json.loads(sys.stdin.readline() or "[]")
        for rank in range(1, comm.size):
            comm.send(command, rank)
        return command
    while not comm.iprobe(source=0):
        time.sleep(0.005)
    return comm.recv(source=0)


def main():
    """Read, run, mark; the end of stdin is the end. Ranks that hang are ended and say where."""
    faulthandler.register(signal.SIGTERM, chain=True)
    if comm.rank:  # its lines would break into those of rank 0
        os.dup2(2, 1)
    while True:
        command = told()
        if not command:
            return
        mark, *command = command
        run(command)
        sys.stdout.flush()
        comm.barrier()
        if comm.rank == 0:
            print(mark, flush=True)


if __name__ == "__main__":
    try:
        main()
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
        comm.Abort(1)
