"""A block on a base, or on a plane, that is pressed and dragged over it from step to step."""

import numpy as np
import ufl
from contact_scenes import ABOVE, BELOW, rectangle, stress
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

PRESSED = 0.01


class Slider:
    """A block pressed onto a base, or onto a plane, and dragged over it from step to step."""

    def __init__(self, law, finite=False, rigid=False, cells=4):
        comm = MPI.COMM_SELF
        body = rectangle(comm, (cells, 2), (-1.0, 0.0), (1.0, 1.0), "quadrilateral")
        base = rectangle(comm, (6, 2), (-1.5, -1.0), (1.5, 0.0), "quadrilateral")
        bodies = [body] if rigid else [body, base]
        spaces = [compat.function_space(domain, shape=(2,)) for domain, _ in bodies]
        self.law = law(body[0]) if callable(law) else law
        self.top, self.along = fem.Function(spaces[0]), 0.0
        held = [(spaces[0], self.top, 1.0), *((V, fem.Function(V), -1.0) for V in spaces[1:])]
        self.bcs = [
            fem.dirichletbc(
                value, fem.locate_dofs_geometrical(V, lambda x, y=y: np.isclose(x[1], y))
            )
            for V, value, y in held
        ]
        if rigid:
            sides = ((body[1], BELOW), llm.RigidPlane((0.0, 0.0), (0.0, 1.0)))
        else:
            sides = ((body[1], BELOW), (base[1], ABOVE))
        interface = llm.Interface(None, sides, law=self.law)
        tests = [ufl.TestFunction(V) for V in spaces]
        u = [fem.Function(V) if finite else ufl.TrialFunction(V) for V in spaces]
        a = [ufl.inner(stress(v), ufl.grad(w)) * ufl.dx for v, w in zip(u, tests, strict=True)]
        if finite:
            self.problem = llm.NonlinearContactProblem(a, u, bcs=self.bcs, interfaces=[interface])
        else:
            zero = [
                ufl.inner(fem.Constant(V.mesh, np.zeros(2)), w) * ufl.dx
                for V, w in zip(spaces, tests, strict=True)
            ]
            self.problem = llm.ContactProblem(a, zero, bcs=self.bcs, interfaces=[interface])

    def move(self, along, down=PRESSED, *increments, **memory):
        """Solve with the top there."""
        self.top.x.array.reshape(-1, 2)[:] = along, -down
        self.problem.solve(*increments, **memory)

    def dragged(self):
        """Friction over the normal force, once all slips."""
        self.along += 0.1
        self.move(self.along)
        T, N = np.abs(self.problem.results[0].resultant)
        return T / N
