"""A patch test of second order on all ranks, by both forms; rank 0 prints what they found."""

import json

import numpy as np
import second_order as so
from mpi4py import MPI

comm = MPI.COMM_WORLD
found, forces = [], []
low, high = ((0, 0, 0), (0.137, 0.21, 1)), ((1, 1, 1), (0.871, 0.93, 2))
cholesky = {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"}
for options in ({}, {"solver": "condensed", "petsc_options": cholesky}):
    spaces, tags = so.blocks(comm, ("tetrahedron", "hexahedron"), (2, 3), low, high)
    field = so.Polynomial(2, 3)
    problem = so.patch_problem(spaces, tags, field, **options)
    found.append(so.largest_error(problem.solve(), field))
    forces.append(np.concatenate([side.force for side in problem.results[0].sides]))
apart = np.abs(forces[0] - forces[1]).max() / np.abs(forces[0]).max()
if comm.rank == 0:
    print(json.dumps({"error": max(found), "apart": apart}))
