"""A tilted bar of second order touches a plate with a corner, and nothing has moved yet."""

import pytest
import ufl
from contact_scenes import stress
from dolfinx import fem
from tilted_bar import TiltedBar

import dolfinx_llm as llm

pytestmark = pytest.mark.quick


def test_a_corner_that_nothing_presses():
    """What the frame is left with is rounding of positions, and no solve that failed: that was an
    error, so that load steps could not begin at rest."""
    bar, a, L = TiltedBar(0.2, degree=2), [], []
    for V in bar.spaces:
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        a.append(1000.0 * ufl.inner(stress(u), ufl.grad(w)) * ufl.dx)
        L.append(ufl.inner(fem.Constant(V.mesh, (0.0, 0.0)), w) * ufl.dx)
    interface = llm.Interface(None, bar.sides, law=llm.Frictionless())
    problem = llm.ContactProblem(a, L, bcs=bar.bcs, interfaces=[interface])
    forces = bar.pressed(problem, (0.0, 0.01))
    assert forces[0] <= 1e-5 * forces[1] and forces[1] > 0.0
