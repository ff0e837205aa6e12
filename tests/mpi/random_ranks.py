"""Random scenes on several ranks: displacement and forces of every load step as JSON."""

import json
import logging
import sys

import random_scenes as scenes
from mpi4py import MPI

import dolfinx_llm as llm

logging.disable(logging.CRITICAL)
comm = MPI.COMM_WORLD
out = {}
for seed in map(int, sys.argv[1:]):
    scene = scenes.draw(seed)
    try:
        answers = scenes.solve(scene, comm=comm)
        out[seed] = [{"u": a.u.tolist(), "force": [f.tolist() for f in a.force]} for a in answers]
    except llm.ContactError as error:
        out[seed] = str(error)
if comm.rank == 0:
    print(json.dumps(out))
