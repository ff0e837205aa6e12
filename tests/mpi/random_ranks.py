"""Random scenes on several ranks, after "mixed" in mixed spaces: displacement and forces of every
load step as JSON."""

import json
import logging
import sys

import random_scenes as scenes
from mpi4py import MPI

import dolfinx_llm as llm

logging.disable(logging.CRITICAL)
comm, seeds = MPI.COMM_WORLD, sys.argv[1:]
variant = scenes.Variant(mixed=seeds[0] == "mixed")
out = {}
for seed in map(int, seeds[variant.mixed :]):
    scene = scenes.draw(seed)
    try:
        answers = scenes.solve(scene, variant, comm)
        out[seed] = [{"u": a.u.tolist(), "force": [f.tolist() for f in a.force]} for a in answers]
    except llm.ContactError as error:
        out[seed] = str(error)
if comm.rank == 0:
    print(json.dumps(out))
