"""Patch tests around an axis on all ranks; rank 0 prints the errors."""

import json

import numpy as np
from around_axis import Cylinders
from mpi4py import MPI

import dolfinx_llm as llm

comm, found = MPI.COMM_WORLD, {}
scene = Cylinders(comm, (5, 4), 0.6)
around = {"thickness": lambda x: 2.0 * np.pi * x[:, 0]}
del scene.bcs[0]  # a floor bears it
floor = scene.tags[0], (1, llm.RigidPlane((0.0, 0.0), (0.0, 1.0)))
on_floor = llm.Interface(*floor, law=llm.Frictionless(), **around)
problem, stretch = scene.linear(llm.Coulomb(0.3), more=[on_floor], **around)
found["linear"] = scene.off(problem.solve(), stretch) / 2e-3
problem.destroy()
scene = Cylinders(comm, (5, 4), 0.6, degree=2, cell="triangle")
problem, stretch = scene.finite(llm.Frictionless(), **around)
for load in scene.load:
    load.value = 150.0
problem.solve()
for load in scene.load:
    load.value = 300.0
problem.solve()
found["finite"] = scene.off(problem.u, stretch)
problem.destroy()
if comm.rank == 0:
    print(json.dumps({name: float(value) for name, value in found.items()}))
