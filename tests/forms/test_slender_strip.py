"""A strip 200 times as long as high that is lifted off a plane by its end, without friction."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from facing_scenes import tagged
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

LENGTH, WEIGHT, E = 200.0, 0.02, 2e5


@pytest.mark.parametrize("lifted", [20.0, 80.0])
def test_forms_that_lose_digits_hand_over(lifted, caplog):
    """The flexibility's own loses 2e-8 of the forces, which was an error; the condensed one does
    not. Lifted over l by w l / 2, its end is at w l⁴ / 24 E I."""
    n = int(LENGTH)
    domain = mesh.create_rectangle(
        MPI.COMM_SELF, [[0.0, 0.0], [LENGTH, 1.0]], [n, 1], mesh.CellType.quadrilateral
    )
    V = compat.function_space(domain, degree=2, shape=(2,))
    sides = [
        mesh.locate_entities_boundary(domain, 1, lambda p, k=k, x=x: np.isclose(p[k], x))
        for k, x in ((1, 0.0), (0, LENGTH), (0, 0.0))
    ]
    tags = tagged(domain, sides)
    ds, dx = ufl.Measure("ds", domain=domain, subdomain_data=tags), ufl.dx(degree=4)
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = E * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * dx + 1e-3 * u[0] * w[0] * ds(3)
    lift = fem.Constant(domain, WEIGHT * lifted / 2.0)
    L = -WEIGHT * w[1] * dx + lift * w[1] * ds(2)
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    interface = llm.Interface(tags, (1, plane), law=llm.Frictionless())
    problem = llm.ContactProblem(a, L, interfaces=[interface])
    with caplog.at_level("WARNING", logger="dolfinx_llm"):
        u = problem.solve()
    assert "load steps go on by condensed" in caplog.text
    tip = u.x.array[1::2].max() / (WEIGHT * lifted**4 / 24.0 / (E / 12.0))
    assert abs(tip - 1.0) <= 5e-3
    assert abs(problem.results[0].resultant[1] + WEIGHT * (LENGTH - lifted / 2.0)) <= 1e-6
