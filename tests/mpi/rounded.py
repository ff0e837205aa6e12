"""What ranks choose, tell and agree on where each has rounded for itself."""

import json

from mpi4py import MPI

from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import agree, chosen, told

comm = MPI.COMM_WORLD
own = 0.1 + 1e-15 * comm.rank


def fails():
    raise ValueError(f"on rank {comm.rank}")


def refused(value) -> bool:
    try:
        agree(comm, "it", value)
    except ContactInputError:
        return True
    return False


def error(choose) -> str:
    try:
        chosen(comm, choose)
    except ValueError as found:
        return str(found)
    return ""


found = {
    "told": told(comm, own),
    "chosen": chosen(comm, lambda: (comm.rank, own)),
    "error": error(fails),
    "rounded": refused([("load", [[own, 1e3]], 7)]),
    "small beside large": refused([own, own * 1e-14 * (1 + comm.rank)]),
    "another number": refused([("load", [[own + 1e-9 * comm.rank, 1.0]], 7)]),
    "another integer": refused((own, comm.rank)),
    "another length": refused([own] * (1 + comm.rank)),
    "another word": refused({"solver": f"of {comm.rank}"}),
    "another kind": refused([own] if comm.rank else (own,)),
}
every = comm.gather(found)
if comm.rank == 0:
    print(json.dumps({"every": every}))
