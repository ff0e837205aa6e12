"""Random scenes on several ranks, after "mixed" in mixed spaces, after "time" in time, after
"tools" and "finite-tools" with all of the last body moved, after "second" of second order:
displacement and forces of every step as JSON."""

import json
import logging
import sys

import random_finite
import random_scenes as scenes
import random_time
from mpi4py import MPI

import dolfinx_llm as llm

logging.disable(logging.CRITICAL)
comm, kinds = MPI.COMM_WORLD, {word for word in sys.argv[1:] if not word.isdigit()}
variant = scenes.Variant(mixed="mixed" in kinds)
of = random_time if "time" in kinds else random_finite if "finite-tools" in kinds else scenes
out = {}
for seed in map(int, filter(str.isdigit, sys.argv[1:])):
    scene = of.draw(seed, "second" in kinds)
    scene.tool = bool(kinds & {"tools", "finite-tools"})
    try:
        answers = of.solve(scene, variant, comm=comm)
        out[seed] = [{"u": a.u.tolist(), "force": [f.tolist() for f in a.force]} for a in answers]
    except llm.ContactError as error:
        out[seed] = str(error)
if comm.rank == 0:
    print(json.dumps(out))
