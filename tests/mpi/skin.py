"""Polygons that ``plot.bodies`` gathers of the 3D patch test, and the area of its surface."""

import json

import numpy as np
import paper_data
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_llm import compat
from dolfinx_llm.geometry.cells import vector_areas
from dolfinx_llm.output.bodies import skin

comm = MPI.COMM_WORLD
domain, _ = paper_data.scene(comm, 2)
u = fem.Function(compat.function_space(domain, shape=(3,)))
found = skin(u, fem.Function(compat.function_space(domain, "DG", 0)))
polygons = found.x
assert len(polygons) == len(found.values)
cells = np.arange(len(polygons) * 4).reshape(-1, 4)
area = np.linalg.norm(vector_areas(polygons.reshape(-1, 3), cells), axis=1).sum()
surface = fem.assemble_scalar(fem.form(fem.Constant(domain, 1.0) * ufl.ds))
report = {
    "polygons": comm.allreduce(len(polygons)),
    "area": comm.allreduce(area),
    "surface": comm.allreduce(surface),
}
if comm.rank == 0:
    print(json.dumps(report))
