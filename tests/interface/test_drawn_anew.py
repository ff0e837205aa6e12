"""Obstacles that are drawn anew between two solves: as if the problem had been made of them."""

import numpy as np
import pytest
import ufl
from contact_scenes import ABOVE, BELOW, rectangle, stress
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat


def block(obstacle, law, tag=BELOW, finite=False):
    """Held at its other end."""
    domain, tags = rectangle(MPI.COMM_SELF, (6, 4), (-1, 0), (1, 1), "quadrilateral")
    V = compat.function_space(domain, shape=(2,))
    w, zero = ufl.TestFunction(V), fem.Constant(domain, np.zeros(2))
    held = 1.0 if tag == BELOW else 0.0
    dofs = fem.locate_dofs_geometrical(V, lambda p: np.isclose(p[1], held))
    options = {
        "bcs": [fem.dirichletbc(fem.Function(V), dofs)],
        "interfaces": [llm.Interface(tags, (tag, obstacle), law=law)],
    }
    if finite:
        u = fem.Function(V)
        return llm.NonlinearContactProblem(ufl.inner(stress(u), ufl.grad(w)) * ufl.dx, u, **options)
    a = ufl.inner(stress(ufl.TrialFunction(V)), ufl.grad(w)) * ufl.dx
    return llm.ContactProblem(a, ufl.inner(zero, w) * ufl.dx, **options)


def end():
    return llm.RigidPlane((0.0, 1.0), (0.0, -1.0), force=(0.0, 0.1), moment=0.02)


class Hill(llm.Obstacle):
    """An obstacle of one's own, y = height (1 - x²)."""

    height = 0.001

    def clearance(self, x):
        into = np.column_stack([-2.0 * self.height * x[:, 0], -np.ones(len(x))])
        length = np.linalg.norm(into, axis=1)
        away = x[:, 1] - self.height * (1.0 - x[:, 0] ** 2)
        return away / length, into / length[:, None]


def ground(height):
    """Out of two segments, as wide as the block and more."""
    return llm.Frame([[-2.0, height], [0.0, 1.5 * height], [2.0, height]], [[0, 1], [1, 2]])


CASES = {
    "mesh": (lambda: llm.RigidSurface(ground(0.001)), ground(0.002), BELOW),
    "point": (lambda: llm.RigidPlane((0.0, 0.001), (0.0, 1.0)), np.array([0.0, 0.002]), BELOW),
    "radius": (lambda: llm.RigidSphere((0.0, -2.0), 2.001), 2.002, BELOW),
    "height": (Hill, 0.002, BELOW),
    "pivot": (end, (-1.5, 1.0), ABOVE),
}


@pytest.mark.parametrize("finite", [False, True])
@pytest.mark.parametrize("name", CASES)
def test_obstacles(name, finite):
    make, value, tag = CASES[name]
    law = llm.Tied() if tag == ABOVE else llm.Frictionless()
    obstacle, known = make(), make()
    problem = block(obstacle, law, tag, finite)
    problem.solve()
    before = problem.results[0].sides[0].u
    setattr(obstacle, name, value)
    problem.solve()
    setattr(known, name, value)
    other = block(known, law, tag, finite)
    other.solve()
    found, expected = (p.results[0].sides[0] for p in (problem, other))
    size = np.abs(expected.u).max()
    assert np.abs(before - expected.u).max() > 0.1 * size
    assert np.abs(found.u - expected.u).max() <= 1e-8 * size
    assert np.abs(found.force - expected.force).max() <= 1e-8 * np.abs(expected.force).max()


def test_what_is_moved_is_not_drawn_anew():
    """A displacement, a turn about its own middle: friction goes on, nothing is built again."""
    ball = llm.RigidSphere((0.0, -2.0), 2.001)
    problem = block(ball, llm.Coulomb(0.3))
    problem.solve()
    built, w = problem.geometries, problem.method.iteration
    ball.displacement, ball.rotation, ball.pivot = (0.0, 0.001), 0.001, (0.0, -2.0)
    problem.solve()
    assert problem.geometries is built and problem.method.iteration is w


def test_an_obstacle_that_cannot_be():
    """It is refused; put right, what there was goes on."""
    plane = llm.RigidPlane((0.0, 0.001), (0.0, 1.0))
    problem = block(plane, llm.Coulomb(0.3))
    problem.solve()
    force = problem.results[0].resultant
    for wrong in ((0.0, -1.0), (np.nan, 1.0)):
        plane.normal = np.array(wrong)
        with pytest.raises(llm.ContactError):
            problem.solve()
        assert problem.pushed.any() and problem.B.norm() > 0.0
    plane.normal = np.array([0.0, 1.0])
    problem.solve()
    np.testing.assert_allclose(problem.results[0].resultant, force, atol=1e-9 * abs(force[1]))
