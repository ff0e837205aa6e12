"""What an increment carries through an obstacle."""

import finite_patch
import numpy as np
import pytest
from contact_scenes import ABOVE, hold_all, rectangle
from dolfinx import fem
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

RADIUS = 0.25


@pytest.mark.parametrize(("down", "order"), [longer(0.35, 1), (0.4, 1), (0.35, 2)])
def test_obstacle_that_would_pass_is_met(down, order):
    """Pressed in by more than its radius in one increment, as in sixteen: its centre came
    below nodes, which then had turned their backs on it, and no force was left."""
    ends, rng = ((-1.0, -1.0), (1.0, 0.0)), np.random.default_rng(1)
    domain, tags = rectangle(MPI.COMM_WORLD, (16 // order, 8 // order), *ends, "triangle", 0.2, rng)
    V, found = compat.function_space(domain, degree=order, shape=(2,)), []
    for increments in (1, 16):
        u = fem.Function(V)
        disc = llm.RigidSphere((0.013, RADIUS), RADIUS)
        problem = llm.NonlinearContactProblem(
            finite_patch.residual(u, 4.0, 6.0, order),
            u,
            bcs=hold_all(V, lambda p: p[1] < -0.999, np.zeros_like),
            interfaces=llm.Interface(tags, (ABOVE, disc), law=llm.Frictionless()),
        )
        disc.displacement = (0.0, -down)
        problem.solve(increments=increments)
        result = problem.results[0]
        away = np.linalg.norm(result.sides[0].x - [0.013, RADIUS - down], axis=1) - RADIUS
        assert away.min() > -1e-8
        found.append(result.resultant)
    assert found[1][1] > 1.0
    assert np.abs(found[0] - found[1]).max() < 1e-7 * np.abs(found[1]).max()
