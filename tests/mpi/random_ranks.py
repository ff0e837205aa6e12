"""Random scenes on several ranks, after "mixed" in mixed spaces, after "time" in time: displacement
and forces of every step as JSON."""

import json
import logging
import sys

import random_scenes as scenes
import random_time
from mpi4py import MPI

import dolfinx_llm as llm

logging.disable(logging.CRITICAL)
comm, kind = MPI.COMM_WORLD, sys.argv[1]
variant = scenes.Variant(mixed=kind == "mixed")
of, out = random_time if kind == "time" else scenes, {}
for seed in map(int, sys.argv[1 + (not kind.isdigit()) :]):
    scene = of.draw(seed)
    try:
        answers = of.solve(scene, variant, comm=comm)
        out[seed] = [{"u": a.u.tolist(), "force": [f.tolist() for f in a.force]} for a in answers]
    except llm.ContactError as error:
        out[seed] = str(error)
if comm.rank == 0:
    print(json.dumps(out))
