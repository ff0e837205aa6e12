"""Second-order bodies that may meet others, whose unknowns are control values, are set off in steps
of time by nodal forces: the first step's impulse is that of the loads as well."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

DT, GRAVITY = 0.01, -10.0


def stepper(scheme, n=4, gravity=GRAVITY, **options):
    """A square of mass 1, bent as drawn, that falls towards a floor far below."""
    domain = mesh.create_unit_square(MPI.COMM_SELF, 3, n, mesh.CellType.quadrilateral)
    below = mesh.locate_entities_boundary(domain, 1, lambda p: np.isclose(p[1], 0.0))
    tags = mesh.meshtags(domain, 1, np.sort(below), np.full(len(below), 3, dtype=np.int32))
    V = compat.function_space(domain, degree=2, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    eps, weight = ufl.sym(ufl.grad(u)), fem.Constant(domain, np.array([0.0, gravity]))
    interface = llm.Interface(tags, (3, llm.RigidPlane((0, -9), (0, 1))), law=llm.Frictionless())
    return llm.TimeStepper(
        1.0,
        1000.0 * ufl.inner(eps, ufl.grad(w)) * ufl.dx,
        ufl.inner(weight, w) * ufl.dx,
        dt=DT,
        interfaces=[interface],
        scheme=scheme,
        **options,
    )


@pytest.mark.parametrize("scheme", ["massless", "newmark"])
def test_first_impulse(scheme):
    body = stepper(scheme)
    body.u.interpolate(lambda p: 0.01 * np.array([p[0] * p[1], p[0] ** 2]))
    momentum = [body.density[0] * body.v[k] * ufl.dx for k in (0, 1)]
    found = []
    for _ in range(3):
        body.step()
        found.append([fem.assemble_scalar(fem.form(p)) for p in momentum])
    expected = np.outer(DT * np.arange(1, 4), [0.0, GRAVITY])
    assert np.abs(found - expected).max() < 1e-6 * DT * abs(GRAVITY)


def test_first_step_of_a_bent_body():
    """Without mass taken off, the first step is the trapezoidal rule's for K u + M a = f."""
    body = stepper("newmark")
    body.u.interpolate(lambda p: 0.01 * np.array([p[0] * p[1], p[0] ** 2]))
    V, before = body.u.function_space, body.u.x.array.copy()
    body.step()
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    K = assembled(1000.0 * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * ufl.dx)
    M = assembled(ufl.inner(u, w) * ufl.dx)
    weight = ufl.inner(fem.Constant(V.mesh, np.array([0.0, GRAVITY])), w) * ufl.dx
    f = compat.assemble_force((compat.form("f", weight),), (1.0,), V)
    mean = 0.5 * (before + body.u.x.array)
    miss = M @ body.v.x.array / DT + K @ mean - f
    assert np.abs(miss).max() < 1e-9 * np.abs(K @ mean).max()


def test_start_away_from_the_drawing():
    """A support that reaches the surface which may part holds the body where that has been moved
    to, and nothing bends it there; it was by a quarter of the motion."""
    bcs = []
    body = stepper("massless", gravity=0.0, bcs=bcs)
    V = body.u.function_space
    moved = fem.Function(V)
    moved.x.array[:] = body.u.x.array[:] = 0.01
    dofs = fem.locate_dofs_geometrical(V, lambda p: np.isclose(p[0], 0.0))
    bcs.append(fem.dirichletbc(moved, dofs))
    body.start()
    assert np.abs(body.u.x.array - 0.01).max() <= 1e-9


def assembled(form):
    matrix = compat.assemble_matrix(compat.form("a", form), [], 1.0)
    return matrix[:, :]
