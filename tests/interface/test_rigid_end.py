"""A body tied to an obstacle that has a force, a motion, or some of each: a rigid end."""

import numpy as np
import pairs
import pytest
import ufl
from contact_scenes import ABOVE, BELOW, hold_all, rectangle
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM, E = MPI.COMM_SELF, 200.0


def column(plane, solver="auto"):
    """A column of height 4 and section 1, clamped at its foot, its end tied to a plane; ν = 0."""
    gdim = len(plane.point)
    low, high = np.zeros(gdim), np.ones(gdim)
    high[-1] = 4.0
    if gdim == 2:
        domain, tags = rectangle(COMM, (3, 8), low, high, "quadrilateral")
    else:
        domain, tags = pairs.block(COMM, (2, 2, 4), low, high, "hexahedron")
    V = compat.function_space(domain, shape=(gdim,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    return llm.ContactProblem(
        E * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * ufl.dx,
        ufl.inner(fem.Constant(domain, np.zeros(gdim)), w) * ufl.dx,
        bcs=hold_all(V, lambda p: p[gdim - 1] < 1e-9, lambda p: 0.0 * p),
        interfaces=llm.Interface(tags, (ABOVE, plane), law=llm.Tied()),
        solver=solver,
    )


def top(gdim, **motion):
    axis = np.eye(gdim)[-1]
    return llm.RigidPlane(tuple(4.0 * axis), tuple(-axis), **motion)


@pytest.mark.parametrize("gdim", [2, 3])
def test_force_or_motion(gdim):
    """Pulled and pushed aside: stretched as F l / E A; what moves it aside takes the same force."""
    aside = (0.3,) + (0.0,) * (gdim - 2)
    plane = top(gdim, force=(*aside, 5.0))
    problem = column(plane)
    for pull in (5.0, -2.0):
        plane.force = (*aside, pull)
        u, result = problem.solve(), problem.results[0]
        assert result.displacement[-1] == pytest.approx(4.0 * pull / E, rel=1e-11)
        assert result.resultant == pytest.approx([*(-np.array(aside)), -pull], abs=1e-11)
        end = u.function_space.tabulate_dof_coordinates()[:, gdim - 1] > 4.0 - 1e-9
        assert np.ptp(u.x.array.reshape(-1, gdim)[end], axis=0).max() < 1e-12
    moved = top(
        gdim, displacement=(*result.displacement[:-1], 0.0), force=(*[None] * (gdim - 1), -2.0)
    )
    other = column(moved)
    other.solve()
    assert other.results[0].resultant == pytest.approx(result.resultant, abs=1e-10)


def test_refused():
    """Nothing holds the body; the condensed form."""
    with pytest.raises(llm.ContactError, match="no forces on obstacles that bodies are tied to"):
        column(top(2, force=(0.0, 1.0)), "condensed")
    domain, tags = rectangle(COMM, (2, 2), (0.0, 0.0), (1.0, 1.0), "quadrilateral")
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    floor = llm.RigidPlane((0.0, 0.0), (0.0, 1.0), force=(None, 1.0))
    with pytest.raises(llm.ContactError, match="held by no support"):
        llm.ContactProblem(
            ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * ufl.dx,
            ufl.inner(fem.Constant(domain, (0.0, 0.0)), w) * ufl.dx,
            interfaces=llm.Interface(tags, (BELOW, floor), law=llm.Tied()),
        )
