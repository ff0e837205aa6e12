"""Bodies that pass each other, elements inside out, nodes that leave the frame: what is said."""

import json
import logging

from mpi4py import MPI
from pressed_scenes import Punch, small_strains

import dolfinx_llm as llm
from dolfinx_llm.finite import newton

newton.HALVINGS = 0
comm, told = MPI.COMM_WORLD, []
handler = logging.Handler()
handler.emit = lambda record: told.append(record.getMessage().removeprefix("[rank 0] "))
logging.getLogger("dolfinx_llm").addHandler(handler)
errors = []
for punch, down in (
    (Punch("quad", lift=0.8, comm=comm), 1.5),
    (Punch("quad", llm.Tied(), energy=small_strains, comm=comm), 2.0),
):
    try:
        punch.to(down)
    except llm.ContactError as error:
        errors.append(str(error))
punch = Punch("quad", comm=comm)
punch.to(down=0.05)
punch.to(down=0.05, along=2.0)
assert all(comm.allgather(len(errors) == 2))
assert comm.rank == 0 or not told
if comm.rank == 0:
    print(json.dumps({"errors": errors, "warnings": told}))
