"""Nonlinear bodies on a frame that stays where it was drawn: the user's own Newton iteration over
the linear problem, which asks of the bodies no more than K and f."""

import finite_patch
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from sampling import longer
from scenes import SYMMETRY, hold, on, two_blocks
from scipy.optimize import brentq

import dolfinx_llm as llm

COMM = MPI.COMM_WORLD
PRESSED = 0.8  # height over the drawn one


@pytest.mark.parametrize(
    ("solver", "law"),
    [
        ("saddle", llm.Tied()),
        longer("saddle", llm.Frictionless()),
        longer("condensed", llm.Tied()),
        ("condensed", llm.Frictionless()),
    ],
    ids=str,
)
def test_newton_over_the_linear_problem(law, solver):
    """Squeezed by a fifth: K(u) u+ = K(u) u - F(u) ends in uniform stretches, quadratically."""
    V, tags = two_blocks(COMM, 3, 2, layers=(1, 1))
    u, (mu, lam) = fem.Function(V), finite_patch.lame(1000.0, 0.4)
    F = finite_patch.residual(u, mu, lam)
    J = ufl.derivative(F, u, ufl.TrialFunction(V))
    bcs = hold(V, SYMMETRY) + hold(V, [(2, on(2, 2.0))], lambda p: (PRESSED - 1.0) * p)
    problem = llm.ContactProblem(
        J, ufl.action(J, u) - F, bcs=bcs, solver=solver,
        interfaces=[llm.Interface(tags, (2, 3), law=law)],
    )  # fmt: skip
    changes = []
    while not changes or changes[-1] > 1e-12:
        assert len(changes) < 8
        found = problem.solve()
        changes.append(np.abs(found.x.array - u.x.array).max())
        u.x.array[:] = found.x.array
    a = brentq(lambda a: mu * (a * a - 1.0) + lam * np.log(a * a * PRESSED), 0.5, 2.0)
    exact = V.tabulate_dof_coordinates() * [a - 1.0, a - 1.0, PRESSED - 1.0]
    assert np.abs(u.x.array.reshape(-1, 3) - exact).max() < 1e-11
    ends = [c for c in changes if 1e-12 < c < 0.1]
    assert len(ends) >= 3
    assert all(after < 3.0 * c * c for c, after in zip(ends, ends[1:], strict=False))
