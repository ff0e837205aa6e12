"""A drawer that jams in a slot between two planes, from rest in one step, however it is turned."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from facing_scenes import tagged
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

LONG, ARM, MU, E = 2.0, 2.0, 0.8, 1e5


@pytest.mark.parametrize("force", [0.1, longer(1.0), longer(10.0)])
@pytest.mark.parametrize("angle", [0.4, 1.3, longer(0.0), longer(2.2)])
def test_whatever_the_pose(angle, force):
    """Pulled by a force at the end of an arm: contact alone holds it, and is not known at first.
    Without damped iterations it flew away."""
    domain = mesh.create_rectangle(
        MPI.COMM_SELF, [[0.0, 0.0], [LONG, 1.0]], [20, 10], mesh.CellType.triangle
    )
    x = domain.geometry.x
    lower = mesh.locate_entities_boundary(domain, 1, lambda p: np.isclose(p[1], 0.0))
    upper = mesh.locate_entities_boundary(domain, 1, lambda p: np.isclose(p[1], 1.0))
    end = mesh.locate_entities_boundary(domain, 1, lambda p: np.isclose(p[0], LONG))
    tags = tagged(domain, [lower, upper, end])
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s], [s, c]])
    x[:, :2] = x[:, :2] @ R.T
    V = compat.function_space(domain, shape=(2,))
    u, w = fem.Function(V), ufl.TestFunction(V)
    eps = ufl.sym(ufl.grad(u))
    sigma = E / 1.3 * (eps + 0.3 / 0.4 * ufl.tr(eps) * ufl.Identity(2))
    y = ufl.dot(ufl.SpatialCoordinate(domain), ufl.as_vector(R[:, 1])) - 0.5
    # A force along the slot at a distance of ARM from its middle: linear over the end.
    pull = fem.Constant(domain, force) * (1.0 + 12.0 * ARM * y)
    ds = ufl.ds(domain=domain, subdomain_data=tags)
    F = ufl.inner(sigma, ufl.grad(w)) * ufl.dx
    F -= pull * ufl.dot(ufl.as_vector(R[:, 0]), w) * ds(3)
    planes = llm.RigidPlane((0.0, 0.0), R[:, 1]), llm.RigidPlane(R[:, 1], -R[:, 1])
    interfaces = [
        llm.Interface(tags, (tag, plane), law=llm.Coulomb(MU))
        for tag, plane in zip((1, 2), planes, strict=True)
    ]
    problem = llm.NonlinearContactProblem(F, u, interfaces=interfaces)
    problem.solve()
    low, high = (result.resultant @ R for result in problem.results)
    rounding = 1e-12 * E  # of all nodes' forces
    assert np.abs(low + high - [force, 0.0]).max() <= rounding
    assert np.abs(low[0]) <= MU * abs(low[1]) * (1.0 + 1e-9)
    assert np.abs(u.x.array).max() <= 1e-2 * force
