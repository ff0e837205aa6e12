"""Impact of nonlinear bodies: energy, and what ties carry at the start."""

from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem
from friction_block import BOTTOM, TOP, body, stress
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat


def hyperelastic_bar(elements, courant, amplitude=0.2, law=None, **options):
    """The bar of the demo, neo-Hookean, and its energy."""
    import impact_bar

    drawn = impact_bar.Bar(elements, comm=MPI.COMM_SELF)
    V = drawn.stepper.u.function_space
    u, w = fem.Function(V), ufl.TestFunction(V)
    deformed = ufl.Identity(2) + ufl.grad(u)
    J = ufl.det(deformed)
    psi = 0.25 * (ufl.tr(deformed.T * deformed) - 2.0 - 2.0 * ufl.ln(J))
    psi += 0.125 * (J * J - 1.0 - 2.0 * ufl.ln(J))
    F = ufl.derivative(psi * ufl.dx, u, w)
    interface = drawn.interface if law is None else replace(drawn.interface, law=law)
    s = llm.TimeStepper(
        1.0, F, u, dt=courant / elements, bcs=drawn.bcs, interfaces=interface, **options
    )
    u.interpolate(lambda x: np.stack([(1.0 - x[0]) * amplitude, 0.0 * x[0]]))
    s.start()
    (rho,) = s.density
    return s, fem.form((psi + 0.5 * rho * ufl.inner(s.v, s.v)) * ufl.dx)


def bounces(elements, courant, time, **options):
    """Energies, growth of energy in a step at most, and its loss, over the first; closings."""
    s, energy = hyperelastic_bar(elements, courant, **options)
    found, pressed = [fem.assemble_scalar(energy)], [False]
    while s.t < time - 1e-9:
        s.step()
        found.append(fem.assemble_scalar(energy))
        pressed.append(abs(s.problem.results[0].resultant[0]) > 1e-9)
    closings = int((np.diff(np.array(pressed, dtype=int)) == 1).sum())
    change = np.diff(found) / found[0]
    return change.max(), 1.0 - found[-1] / found[0], closings


def test_energy_of_an_impact():
    """It grows by nothing, and little is lost where the steps are divided in which the bar meets
    and leaves the obstacle; that starts and ends one contact, not more."""
    growth, loss, closings = bounces(8, 0.25, 2.0, adaptive=1e-4)
    assert growth <= 1e-8 and closings == 1
    assert 0.0 < loss < 2e-4


class Ours(llm.Coulomb):
    """Friction as a law of one's own."""


def test_steps_are_divided_under_laws_of_ones_own(tmp_path):
    """What a law keeps is taken back with a step, and saved."""
    meant = 28  # it touches in the 26th
    taken, pressed = [], []
    options = {"adaptive": 1e-4, "accepted": lambda stepper: taken.append(stepper.t)}
    s, _ = hyperelastic_bar(8, 0.25, law=Ours(0.1), **options)
    for _ in range(meant):
        s.step()
        pressed.append(abs(s.problem.results[0].resultant[0]) > 1e-9)
    assert len(taken) > meant and s.t == pytest.approx(meant * 0.25 / 8)
    assert any(pressed) and not pressed[0]
    s.save(tmp_path / "state.npz")
    other, _ = hyperelastic_bar(8, 0.25, law=Ours(0.1), adaptive=1e-4)
    other.load(tmp_path / "state.npz")
    for stepper in (s, other):
        stepper.step()
    np.testing.assert_allclose(other.v.x.array, s.v.x.array, atol=1e-12)


class Parting(llm.Law):
    """What its flags say: no friction."""

    components, opens = "normal", True


def test_a_law_of_flags_alone():
    known, found = (hyperelastic_bar(8, 0.25, law=a)[0] for a in (llm.Frictionless(), Parting()))
    for _ in range(28):
        known.step()
        found.step()
    assert known.problem.results[0].resultant[0] != 0.0
    np.testing.assert_array_equal(found.u.x.array, known.u.x.array)


@pytest.mark.long
def test_ten_bounces():
    """Without dividing steps 16 % are lost."""
    growth, loss, closings = bounces(8, 0.25, 31.0, adaptive=1e-4)
    assert growth <= 1e-8 and closings >= 10
    assert 0.0 < loss < 0.01


@pytest.mark.long
def test_loss_falls_with_the_step():
    """With its square, where no step is divided."""
    losses = [bounces(10, courant, 5.0)[1] for courant in (0.5, 0.25, 0.125)]
    assert losses[0] > 3.0 * losses[1] > 9.0 * losses[2] > 0.0


@pytest.mark.parametrize("linear", [True, *longer(False).values])
def test_ties_carry_their_force_from_the_start(linear):
    """Two blocks, tied, one held and the other pulled, start at rest in balance: nothing moves, and
    the tie carries what it carried, without a swing."""
    bodies = [
        body(MPI.COMM_SELF, (0.0, 0.0), (1.0, 0.8), (3, 3)),
        body(MPI.COMM_SELF, (0.0, -0.8), (1.0, 0.8), (4, 3)),
    ]
    spaces = [compat.function_space(domain, shape=(2,)) for domain, _ in bodies]
    solved = [fem.Function(V) for V in spaces]
    trials = solved if not linear else [ufl.TrialFunction(V) for V in spaces]
    w = [ufl.TestFunction(V) for V in spaces]
    a = [ufl.inner(stress(u, 10.0, 0.3), ufl.grad(v)) * ufl.dx for u, v in zip(trials, w)]
    pull = [fem.Constant(V.mesh, (0.1 * f, 0.3 * f)) for V, f in zip(spaces, (1.0, 0.0))]
    L = [ufl.inner(f, v) * ufl.dx for f, v in zip(pull, w)]
    held = fem.locate_dofs_geometrical(spaces[1], lambda x: np.isclose(x[1], -0.8))
    bcs = [fem.dirichletbc(np.zeros(2), held, spaces[1])]
    sides = (bodies[0][1], BOTTOM), (bodies[1][1], TOP)
    tie = [llm.Interface(None, sides, law=llm.Tied())]
    if linear:
        forms, kind = (a, L), llm.ContactProblem
    else:
        forms, kind = ([x - y for x, y in zip(a, L)], solved), llm.NonlinearContactProblem
    rests = kind(*forms, bcs=bcs, interfaces=tie)
    at_rest = [u.x.array.copy() for u in rests.solve()]
    force = rests.results[0].sides[0].force
    s = llm.TimeStepper(1.0, *forms, dt=0.05, bcs=bcs, interfaces=tie)
    for u, values in zip(s.u, at_rest, strict=True):
        u.x.array[:] = values
    largest = max(np.abs(values).max() for values in at_rest)
    for _ in range(4):
        s.step()
        found = s.problem.results[0].sides[0].force
        np.testing.assert_allclose(found, force, atol=1e-5 * np.abs(force).max())
        for u, values in zip(s.u, at_rest, strict=True):
            np.testing.assert_allclose(u.x.array, values, atol=1e-7 * largest)


def colliding(comm, law, gravity):
    """Hyperelastic blocks, the upper one comes down on the other; energy with that of their
    weight, and forms of momenta and mass."""
    bodies = [
        body(comm, (-0.7, 0.03), (1.0, 0.8), (6, 5)),
        body(comm, (-1.0, -1.0), (1.9, 1.0), (9, 6)),
    ]
    forms, displacements, energies = [], [], []
    for (domain, _), E, rho in zip(bodies, (10.0, 15.0), (1.0, 2.0), strict=True):
        V = compat.function_space(domain, shape=(2,))
        u, dx = fem.Function(V), ufl.dx(domain, metadata={"quadrature_degree": 2})
        F, mu, lmbda = ufl.Identity(2) + ufl.grad(u), E / 2.6, 0.3 * E / (1.3 * 0.4)
        log = ufl.ln(ufl.det(F))
        psi = 0.5 * mu * (ufl.tr(F.T * F) - 2.0 - 2.0 * log) + 0.5 * lmbda * log**2
        psi -= ufl.inner(rho * fem.Constant(domain, (0.0, -gravity)), u)
        forms.append(ufl.derivative(psi * dx, u, ufl.TestFunction(V)))
        displacements.append(u)
        energies.append(psi * dx)
    sides = (bodies[0][1], BOTTOM), (bodies[1][1], TOP)
    interface = llm.Interface(None, sides, law=law)
    s = llm.TimeStepper((1.0, 2.0), forms, displacements, dt=0.04, interfaces=interface)
    s.v[0].interpolate(lambda x: np.stack([0.03 + 0.0 * x[0], -0.1 + 0.0 * x[0]]))
    momenta, energy = [], []
    of = zip(bodies, s.density, (1.0, 2.0), s.u, s.v, energies, strict=True)
    for (domain, _), rho, drawn, u, v, psi in of:
        x, dx = ufl.SpatialCoordinate(domain) + u, ufl.dx(domain)
        terms = rho * v[0], rho * v[1], rho * (x[0] * v[1] - x[1] * v[0]), drawn * x[0], rho
        momenta.append([fem.form(term * dx) for term in terms])
        energy.append(fem.form(0.5 * rho * ufl.inner(v, v) * dx + psi))

    def now():
        total = [sum(fem.assemble_scalar(f) for f in parts) for parts in zip(*momenta)]
        return np.array(total), sum(fem.assemble_scalar(form) for form in energy)

    return s, now


@pytest.mark.parametrize(
    ("law", "gravity"),
    [(llm.Frictionless(), 0.0), longer(llm.Coulomb(0.3), 0.0), longer(llm.Coulomb(0.3), 1.0)],
    ids=str,
)
def test_bodies_that_collide(law, gravity):
    """Momenta are those of their weight, also angular, and energy does not grow. Under a weight the
    first step has forces of a start at which bodies have moved by 1e-7."""
    s, now = colliding(MPI.COMM_SELF, law, gravity)
    s.step() if gravity else s.start()
    began = s.t
    (first, energy), pressed = now(), 0
    size, last, before = np.abs(first[:3]).max(), energy, first
    turn = first[2]
    for _ in range(20):
        s.step()
        momenta, found = now()
        turn -= 0.5 * s.dt * gravity * (before[3] + momenta[3])
        falls = first[1] - gravity * first[4] * (s.t - began)
        assert np.abs(momenta[:3] - [first[0], falls, turn]).max() <= 1e-11 * size
        assert found <= last + 1e-11 * abs(energy)
        pressed += abs(s.problem.results[0].resultant[1]) > 1e-12
        last, before = found, momenta
    assert pressed > 8 and last < energy
    s.destroy()
