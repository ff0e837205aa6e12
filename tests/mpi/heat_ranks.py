"""Heat across interfaces on all ranks; rank 0 prints errors of temperature and balance."""

import json

import heat_scenes as heat
from mpi4py import MPI

import dolfinx_llm as llm

comm, found = MPI.COMM_WORLD, {}
for gdim in (2, 3):
    bodies = heat.blocks(comm, gdim)
    for jump, law in ((0.0, llm.Tied()), (heat.FLUX / 2.5, llm.Conductance(2.5))):
        for solver in ("saddle", "condensed"):
            scene = heat.Conducting(bodies, law, heat.Linear(gdim, jump), solver=solver)
            scene.problem.solve()
            flows = [side.force.sum() for side in scene.problem.results[0].sides]
            off = abs(sum(flows)) / (10.0 * abs(flows[0]))
            found[f"{gdim} {law} {solver}"] = max(scene.error(), off)
            scene.problem.destroy()
if comm.rank == 0:
    print(json.dumps(found))
