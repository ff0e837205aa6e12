"""Supports that go between steps in time."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from friction_block import BOTTOM, body, stress
from mpi4py import MPI
from test_stepper import residual

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.operators.petsc import times

COMM = MPI.COMM_SELF


@pytest.mark.parametrize("nonlinear", [False, True])
def test_a_body_that_is_let_go(nonlinear):
    """It hangs on its top, and falls from the very start of the step in which that is let go: its
    momentum is that of its weight since. For nonlinear bodies that was refused, linear ones fell
    from the middle of the step on."""
    domain, tags = body(COMM, (-1.0, 1.0), (2.0, 1.0), (6, 4))
    V = compat.function_space(domain, shape=(2,))
    weight = fem.Constant(domain, (0.0, -10.0))
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    interface = llm.Interface(tags, (BOTTOM, plane), law=llm.Frictionless())
    top = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 2.0))
    bcs = [fem.dirichletbc(np.zeros(2), top, V)]
    given = residual(domain, V, weight)[:2]
    if not nonlinear:
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        given = ufl.inner(stress(u, 1e5, 0.3), ufl.grad(w)) * ufl.dx, ufl.inner(weight, w) * ufl.dx
    s = llm.TimeStepper(1.0, *given, dt=0.01, interfaces=interface, bcs=bcs)

    def momentum():
        return times(s._M, s.v.x.array).reshape(-1, 2).sum(axis=0)

    for _ in range(3):
        s.step()
    before = momentum()
    bcs.clear()
    for k in range(1, 4):
        s.step()
        assert np.allclose(momentum() - before, (0.0, -20.0 * 0.01 * k), rtol=1e-9, atol=1e-9)
    bcs.append(fem.dirichletbc(np.zeros(2), top, V))
    s.step()
    assert np.abs(s.u.x.array.reshape(-1, 2)[top]).max() <= 1e-14
