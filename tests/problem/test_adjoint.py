"""Sensitivities by the adjoint problem, against differences of solves."""

import numpy as np
import pytest
import ufl
from contact_scenes import ABOVE, BELOW, hold_all, rectangle
from dolfinx import fem
from mpi4py import MPI
from own_law import Soft

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM, NU = MPI.COMM_SELF, 0.3


class Scene:
    """A block pressed, tilted and dragged on another; ``J`` of its displacement depends on the
    modulus and the load of each."""

    def __init__(self, law, solver="auto", degree=1):
        low = rectangle(COMM, (6, 3), (-1.0, 0.0), (1.0, 1.0), "quadrilateral")
        high = rectangle(COMM, (5, 3), (-0.5, 1.0), (0.5, 2.0), "triangle")
        sides = (low[1], ABOVE), (high[1], BELOW)
        self.spaces = [compat.function_space(d, "Lagrange", degree, (2,)) for d, _ in (low, high)]
        self.E = [fem.Constant(V.mesh, E) for V, E in zip(self.spaces, (1.0, 1.5))]
        self.load = [fem.Constant(V.mesh, 1e-3) for V in self.spaces]
        trial, self.test = ([make(V) for V in self.spaces] for make in
                            (ufl.TrialFunction, ufl.TestFunction))  # fmt: skip
        bcs = hold_all(self.spaces[0], lambda p: p[1] < 1e-9, lambda p: 0.0 * p)
        bcs += hold_all(
            self.spaces[1],
            lambda p: p[1] > 2.0 - 1e-9,
            lambda p: np.stack([0.003 + 0 * p[0], -0.02 + 0.02 * p[0], 0 * p[0]]),
        )
        self.problem = llm.ContactProblem(
            [self.a(i, u, w) for i, (u, w) in enumerate(zip(trial, self.test))],
            [self.L(i, w) for i, w in enumerate(self.test)],
            bcs=bcs,
            interfaces=llm.Interface(None, sides, law=law),
            solver=solver,
        )

    def a(self, i, u, w):
        eps = ufl.sym(ufl.grad(u))
        stress = (eps + NU / (1 - 2 * NU) * ufl.tr(eps) * ufl.Identity(2)) / (1 + NU)
        return self.E[i] * ufl.inner(stress, ufl.grad(w)) * ufl.dx

    def L(self, i, w):
        return self.load[i] * (w[0] - w[1]) * ufl.dx

    def J(self, i, u):
        x = ufl.SpatialCoordinate(self.spaces[i].mesh)
        return (x[1] * u[0] + 20.0 * u[1] ** 2) * ufl.dx

    def value(self, increments=1):
        """J of a first load step from rest."""
        self.problem.reset()
        u = self.problem.solve(increments)
        return sum(fem.assemble_scalar(fem.form(self.J(i, f))) for i, f in enumerate(u))

    def adjoint(self):
        """Of J."""
        pairs = enumerate(zip(self.problem.u, self.test))
        return self.problem.adjoint([ufl.derivative(self.J(i, f), f, w) for i, (f, w) in pairs])


LONG = pytest.mark.long


@pytest.mark.parametrize(
    ("law", "solver", "degree"),
    [
        (llm.Coulomb(0.3), "auto", 1),
        pytest.param(llm.Coulomb(0.3), "saddle", 1, marks=LONG),
        (llm.Coulomb(0.3), "condensed", 1),
        pytest.param(llm.Coulomb(0.3), "auto", 2, marks=LONG),
        pytest.param(llm.Frictionless(), "auto", 1, marks=LONG),
        (llm.Frictionless(), "condensed", 1),
        pytest.param(llm.Tied(), "condensed", 1, marks=LONG),
        (llm.Tied(), "auto", 1),
    ],
    ids=str,
)
def test_adjoint_is_the_derivative(law, solver, degree):
    """By moduli and loads, all at once, to 1e-6; with friction where nodes stick and slip."""
    scene = Scene(law, solver, degree)
    with pytest.raises(llm.ContactError, match="no state to linearise"):
        scene.problem.adjoint([scene.L(i, w) for i, w in enumerate(scene.test)])
    scene.value()
    if law.slips and degree == 1:
        last = scene.problem.history[-1]
        assert last["stick"] and last["slip"], last
    u, p = scene.problem.u, scene.adjoint()
    parameters, rates = [*scene.load, *scene.E], []
    for i in (0, 1):
        rates.append(fem.assemble_scalar(fem.form(scene.L(i, p[i]))))
    for i in (0, 1):
        rates.append(-fem.assemble_scalar(fem.form(scene.a(i, u[i], p[i]))))
    kept, parts = [float(q.value) for q in parameters], np.array([0.7, -0.4, 0.02, -0.05])
    values = []
    for by in (2e-3, -2e-3):  # of each parameter, in parts
        for q, value, part in zip(parameters, kept, parts):
            q.value = value * (1.0 + by * part)
        values.append(scene.value())
    # p gives value times derivative, since a and L are linear in E and load.
    assert parts @ rates == pytest.approx((values[0] - values[1]) / 4e-3, rel=1e-6)


def test_what_depends_on_the_way_there():
    """Slip that earlier steps or parts have left depends on the parameters, too: refused."""
    scene = Scene(llm.Coulomb(0.3))
    scene.value()
    assert scene.problem.history[-1]["slip"]
    one = scene.adjoint()[0].x.array.copy()
    scene.problem.solve()
    with pytest.raises(llm.ContactError, match="of one load step from rest.*go"):
        scene.adjoint()
    scene.value(increments=2)
    with pytest.raises(llm.ContactError, match="taken in one part"):
        scene.adjoint()
    scene.value()
    assert scene.adjoint()[0].x.array == pytest.approx(one, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("law", [llm.Frictionless(), llm.Coulomb(30.0), Soft(p0=1e-3, h=0.01)])
def test_what_does_not(law):
    """Parts in which nothing slips, and laws that keep nothing."""
    scene, found = Scene(law), []
    for increments in (1, 3):
        scene.value(increments)
        found.append(np.concatenate([p.x.array for p in scene.adjoint()]))
    assert found[1] == pytest.approx(found[0], rel=1e-7, abs=1e-9 * np.abs(found[0]).max())


def test_after_a_failure(monkeypatch):
    """Of a load step that failed there is no state."""
    scene = Scene(llm.Coulomb(0.3))
    scene.value()
    monkeypatch.setattr("dolfinx_llm.contact.search.search.MAXIMUM", 1)
    scene.load[0].value = 0.1
    with pytest.raises(llm.ContactError, match="did not converge"):
        scene.problem.solve()
    with pytest.raises(llm.ContactError, match="no state to linearise"):
        scene.adjoint()
