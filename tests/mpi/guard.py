"""Run a script so that an exception on one rank ends all ranks."""

import runpy
import sys
import traceback

from mpi4py import MPI

sys.argv = sys.argv[1:]
try:
    runpy.run_path(sys.argv[0], run_name="__main__")
except BaseException as error:
    if not (isinstance(error, SystemExit) and not error.code):
        traceback.print_exc()
        sys.stderr.flush()
        MPI.COMM_WORLD.Abort(1)
