"""Velocities that are given where supports hold a body, and what must not change in time."""

import numpy as np
import pytest
import ufl
from contact_scenes import rectangle, stress
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

RIGHT = 7


def bar(rho=1.0, nonlinear=False, **options):
    """A bar that is held at x = 0 and flies along its axis, far from a plane: stepper, what the
    support prescribes, its nodes, and the density."""
    domain, _ = rectangle(MPI.COMM_SELF, (12, 4), (0, 0), (3, 1), "quadrilateral")
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = ufl.inner(stress(u), ufl.grad(w)) * ufl.dx
    L = ufl.inner(fem.Constant(domain, (0.0, 0.0)), w) * ufl.dx
    facets = end_of(domain)
    moved = fem.Function(V)
    at = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0.0))
    interface = llm.Interface(facets, (RIGHT, llm.RigidPlane((9.0, 0.0), (-1.0, 0.0))),
                              law=llm.Frictionless())  # fmt: skip
    now = fem.Function(V)
    of = (ufl.action(a, now) - L, now) if nonlinear else (a, L)
    bcs = [fem.dirichletbc(moved, at)]
    density = rho(domain) if callable(rho) else rho
    s = llm.TimeStepper(density, *of, dt=0.02, bcs=bcs, interfaces=interface, **options)
    s.v.interpolate(lambda x: np.stack([0.5 + 0.0 * x[0], 0.0 * x[0]]))
    return s, moved, at, density


def end_of(domain):
    """Tags of the end at x = 3."""
    facets = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 3.0))
    return mesh.meshtags(domain, 1, np.sort(facets), np.full(len(facets), RIGHT, dtype=np.int32))


@pytest.mark.parametrize("nonlinear", [False, True])
def test_a_support_at_rest_has_no_velocity(nonlinear):
    """Given or not: it turned round in every step, for ever, and shook what lies beside it."""
    found = []
    for given in (True, False):
        s, _, at, _ = bar(nonlinear=nonlinear)
        if not given:
            s.v.x.array.reshape(-1, 2)[at] = 0.0
        for _ in range(5):
            s.step()
            assert not s.v.x.array.reshape(-1, 2)[at].any()
        found.append(s.v.x.array.copy())
        s.destroy()
    np.testing.assert_array_equal(*found)
    assert np.abs(found[0]).max() > 0.1


def test_a_support_that_stops():
    """Its velocity is 0 from the first step on in which it does not move."""
    s, moved, at, _ = bar()
    for k in (1, 2, 2, 2, 2):
        moved.x.array[::2] = 0.01 * k
        s.step()
        speed = s.v.x.array.reshape(-1, 2)[at, 0]
        np.testing.assert_allclose(speed, 0.5 if k * 0.02 >= s.t else 0.0, atol=1e-12)
    s.destroy()


@pytest.mark.parametrize("kind", ["Constant", "Function"])
def test_density_that_changes(kind):
    """Forms of inertia had the values of now, and the mass those of the start, without a word."""

    def given(domain):
        if kind == "Constant":
            return fem.Constant(domain, 1.0)
        rho = fem.Function(compat.function_space(domain))
        rho.x.array[:] = 1.0
        return rho

    s, _, _, rho = bar(given)
    s.step()
    values = rho.x.array if kind == "Function" else rho.value
    values[...] = 2.0
    for _ in range(2):
        with pytest.raises(
            llm.ContactInputError, match="rho, or positions of a mesh, have changed"
        ):
            s.step()
    s.destroy()


def test_one_body_without_density():
    """Of two meshes, also where no mass is taken off surfaces."""
    bodies = [rectangle(MPI.COMM_SELF, (2, 4), (0, y), (1, y + 1), "quadrilateral") for y in (0, 1)]
    spaces = [compat.function_space(domain, shape=(2,)) for domain, _ in bodies]
    a, L = [], []
    for V in spaces:
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        a.append(ufl.inner(stress(u), ufl.grad(w)) * ufl.dx)
        L.append(ufl.inner(fem.Constant(V.mesh, (0.0, 0.0)), w) * ufl.dx)
    (_, low), (_, high) = bodies
    interface = llm.Interface(None, ((low, 2), (high, 1)), law=llm.Tied())
    none = fem.Function(compat.function_space(bodies[1][0]))
    with pytest.raises(llm.ContactInputError, match="all masses are 0 in a mesh"):
        llm.TimeStepper([1.0, none], a, L, dt=0.1, interfaces=interface, scheme="newmark")


def test_friction_and_weight_at_the_start():
    """Of a body that flies, drawn where it starts: forces of where it came from were held by
    inertia, and their rounding was taken for an error of what the weight does."""
    domain, tags = rectangle(MPI.COMM_SELF, (2, 4), (0, 0), (1, 4), "quadrilateral")
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = ufl.inner(stress(u), ufl.grad(w)) * ufl.dx
    L = ufl.inner(fem.Constant(domain, (0.3, -1.0)), w) * ufl.dx
    plane = llm.RigidPlane((0.0, -0.01), (0.0, 1.0))
    interface = llm.Interface(tags, (1, plane), law=llm.Coulomb(0.3))
    s = llm.TimeStepper(1.0, a, L, dt=0.01, interfaces=interface)
    s.v.interpolate(lambda x: np.stack([0.2 + 0.0 * x[0], -0.5 + 0.0 * x[0]]))
    s.step()  # flies
    momenta = [s.density[0] * s.v[i] * ufl.dx(domain) for i in range(2)]
    found = [fem.assemble_scalar(fem.form(part)) for part in momenta]
    known = 4.0 * (np.array([0.2, -0.5]) + 0.01 * np.array([0.3, -1.0]))
    np.testing.assert_allclose(found, known, rtol=1e-9)
    for _ in range(3):
        s.step()
    assert s.problem.results[0].resultant[1] < 0.0
    s.destroy()
