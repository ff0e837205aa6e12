"""Bodies that pass each other, elements inside out, nodes that leave the frame: what is said."""

import json
import logging
import sys

from mpi4py import MPI
from pressed_scenes import Punch, small_strains

import dolfinx_llm as llm
from dolfinx_llm.finite import newton

newton.HALVINGS = 0
comm, told = MPI.COMM_WORLD, []
handler = logging.Handler()
handler.emit = lambda record: told.append(record.getMessage().removeprefix("[rank 0] "))
logging.getLogger("dolfinx_llm").addHandler(handler)
errors, scene = [], sys.argv[1]
try:
    if scene == "passes":
        Punch("quad", lift=0.8, comm=comm).to(down=1.5)
    elif scene == "inside out":
        Punch("quad", llm.Tied(), energy=small_strains, comm=comm).to(down=2.0)
    else:
        punch = Punch("quad", comm=comm)
        punch.to(down=0.05)
        punch.to(down=0.05, along=2.0)
except llm.ContactError as error:
    errors.append(str(error))
assert all(comm.allgather(len(errors) == (scene != "leaves")))
assert comm.rank == 0 or not told
if comm.rank == 0:
    print(json.dumps({"errors": errors, "warnings": told}))
