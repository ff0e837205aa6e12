"""A dragged block carried over to another mesh: its friction there, and a step later, as JSON."""

import json

import friction_block
from mpi4py import MPI

import dolfinx_llm as llm

old, new = (friction_block.Dragged(0.3, elements) for elements in ((6, 9), (8, 11)))
for way in (0.0, 0.0005):
    old.top.g.x.array[:] = way
    old.problem.solve()
llm.transfer(old.problem, new.problem)
found = [new.problem.results[0].resultant.tolist()]
new.top.g.x.array[:] = 0.0008
new.problem.solve()
found.append(new.problem.results[0].resultant.tolist())
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps({"found": found}))
