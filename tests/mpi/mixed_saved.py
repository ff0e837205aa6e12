"""Bodies in mixed spaces read a state of another number of ranks, and go on by a step:
mixed_saved.py FILE KIND. Rank 0 prints forces of both sides, and a norm of u and p."""

import json
import sys

import mixed
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm

BLOCKS = ("Lagrange", 1, False), ("Lagrange", 2, True)
KINDS = {"linear": llm.ContactProblem, "nonlinear": mixed.nonlinear}
WAYS = 0.02, -0.05, 0.02


class Block:
    """A block dragged to and fro, (p, u) of first and second order; the last way turns back."""

    def __init__(self, kind, comm):
        self.given = []
        law, make = llm.Coulomb(0.4), KINDS[kind]
        self.problem = mixed.pressed(law, BLOCKS, comm, make=make, given=self.given)

    def drag(self, way):
        self.given[1].x.array[:] = way
        self.problem.solve()
        return self.figures()

    def figures(self):
        """The same on every rank."""
        w = self.problem.u
        p, u = ufl.split(w)
        comm = w.function_space.mesh.comm
        norms = [fem.assemble_scalar(fem.form(ufl.inner(v, v) * ufl.dx)) for v in (p, u)]
        sides = [side.force for side in self.problem.results[0].sides]
        return [*sides, comm.allreduce(np.array(norms))]


if __name__ == "__main__":
    block = Block(sys.argv[2], MPI.COMM_WORLD)
    block.problem.load(sys.argv[1])
    found = [part.tolist() for part in block.drag(WAYS[-1])]
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps({"figures": found}))
