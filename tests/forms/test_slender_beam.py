"""A slender beam that rests on a plane by its weight, and is lifted at one end: its bending is far
softer than what presses on the plane, and answers of its surface to forces are rounded by more than
it moves there. The solve was said to have failed."""

import contact_scenes as scenes
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

LONG, WEIGHT = 2.0, 100.0  # and weight per length


@pytest.mark.parametrize("high", [0.02, 0.005])
@pytest.mark.parametrize("solver", ["saddle", "condensed"])
def test_beam_on_a_plane(high, solver):
    """Even pressure at rest, and put down again; lifted, the resultant and moment of statics."""
    corners = [np.zeros(2), np.array([LONG, high])]
    domain = mesh.create_rectangle(MPI.COMM_SELF, corners, (100, 2), mesh.CellType.quadrilateral)
    below = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    tags = mesh.meshtags(domain, 1, np.sort(below), np.ones(len(below), dtype=np.int32))
    V = compat.function_space(domain, shape=(2,))
    u, w, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(domain)
    lift = fem.Constant(domain, 0.0)
    end = ufl.conditional(x[0] > LONG * (1.0 - 1e-6), 1.0, 0.0)
    a = ufl.inner(scenes.stress(u), ufl.grad(w)) * ufl.dx
    L = -WEIGHT / high * w[1] * ufl.dx + lift / high * end * w[1] * ufl.ds
    V0 = V.sub(0).collapse()[0]
    at = fem.locate_dofs_geometrical((V.sub(0), V0), lambda x: np.isclose(x[0], 0.0))
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    problem = llm.ContactProblem(
        a, L, bcs=[fem.dirichletbc(fem.Function(V0), at, V.sub(0))],
        interfaces=[llm.Interface(tags, (1, plane), law=llm.Frictionless())], solver=solver,
    )  # fmt: skip
    for force in (0.0, 10.0, 60.0, 0.0):
        lift.value = force
        problem.solve()
        side = problem.results[0].sides[0]
        pressed, whole = side.normal_force, WEIGHT * LONG
        assert abs(pressed.sum() + force - whole) < 1e-7 * whole
        moment = pressed @ side.x[:, 0] + LONG * force - 0.5 * LONG * whole
        assert abs(moment) < 1e-5 * LONG * whole  # what bends the beam at its support
        assert pressed.min() > -1e-6 * whole
        if not force:  # the beam bends at its free end
            even = whole / 100 * np.where(np.isclose(side.x[:, 0], 0.0), 0.5, 1.0)
            off = np.abs(pressed - even)[side.x[:, 0] < 0.75 * LONG]
            assert off.max() < 1e-7 * even.max()
    problem.destroy()
