"""A tilted bar of second order touches a plate with a corner, and nothing has moved yet."""

import numpy as np
import pytest
import ufl
from contact_scenes import ABOVE, BELOW, rectangle, stress
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

pytestmark = pytest.mark.quick
COMM, TILT = MPI.COMM_SELF, 0.2  # [rad]


def test_a_corner_that_nothing_presses():
    """What the frame is left with is rounding of positions, and no solve that failed: that was an
    error, so that load steps could not begin at rest."""
    c, s = np.cos(TILT), np.sin(TILT)

    def tilted(x):
        return np.column_stack([c * x[:, 0] + s * x[:, 1], c * x[:, 1] - s * x[:, 0]])

    bar = rectangle(COMM, (8, 2), (-2.0, 0.0), (0.0, 0.5), "quadrilateral", move=tilted)
    plate = rectangle(COMM, (25, 5), (-2.9, -1.0), (2.1, 0.0), "quadrilateral")
    spaces = [compat.function_space(d, degree=2, shape=(2,)) for d, _ in (bar, plate)]
    ends = [fem.Function(V) for V in spaces]
    held = (
        (lambda x: np.isclose(s * x[0] + c * x[1], 0.5)),
        (lambda x: np.isclose(x[1], -1.0)),
    )
    bcs = [
        fem.dirichletbc(end, fem.locate_dofs_geometrical(V, where))
        for V, end, where in zip(spaces, ends, held, strict=True)
    ]
    a, L = [], []
    for V in spaces:
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        a.append(1000.0 * ufl.inner(stress(u), ufl.grad(w)) * ufl.dx)
        L.append(ufl.inner(fem.Constant(V.mesh, (0.0, 0.0)), w) * ufl.dx)
    sides = (bar[1], BELOW), (plate[1], ABOVE)
    interface = llm.Interface(None, sides, law=llm.Frictionless())
    problem = llm.ContactProblem(a, L, bcs=bcs, interfaces=[interface])
    forces = []
    for down in (0.0, 0.01):
        ends[0].x.array[1::2] = -down
        problem.solve()
        forces.append(abs(problem.results[0].resultant[1]))
    assert forces[0] <= 1e-5 * forces[1] and forces[1] > 0.0
