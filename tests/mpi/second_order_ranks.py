"""Patch tests of second order on all ranks, tied and opening; rank 0 prints what they found."""

import json

import second_order_blocks as so
from mpi4py import MPI

import dolfinx_llm as llm

comm, found = MPI.COMM_WORLD, {}
low, high = ((0, 0, 0), (0.137, 0.21, 1)), ((1, 1, 1), (0.871, 0.93, 2))
direct = {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"}
condensed = {"solver": "condensed", "petsc_options": direct}
for name, field, law, options in (
    ("tied", so.Polynomial(2, 3), llm.Tied(), {}),
    ("frictionless", so.Pressed(3), llm.Frictionless(), condensed),
):
    spaces, tags = so.blocks(comm, ("tetrahedron", "hexahedron"), (2, 3), low, high)
    problem = so.patch_problem(spaces, tags, field, {"law": law}, **options)
    found[name] = so.largest_error(problem.solve(), field)
if comm.rank == 0:
    print(json.dumps(found))
