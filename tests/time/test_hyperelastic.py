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
    """What a law keeps is taken back with a step; it cannot be saved."""
    meant = 40
    taken, pressed = [], []
    options = {"adaptive": 1e-4, "accepted": lambda stepper: taken.append(stepper.t)}
    s, _ = hyperelastic_bar(8, 0.25, law=Ours(0.1), **options)
    for _ in range(meant):
        s.step()
        pressed.append(abs(s.problem.results[0].resultant[0]) > 1e-9)
    assert len(taken) > meant and s.t == pytest.approx(meant * 0.25 / 8)
    assert any(pressed) and not pressed[0]
    with pytest.raises(llm.ContactInputError, match="laws of your own"):
        s.save(tmp_path / "state.npz")


class Parting(llm.Law):
    """What its flags say: no friction."""

    components, opens = "normal", True


def test_a_law_of_flags_alone():
    known, found = (hyperelastic_bar(8, 0.25, law=a)[0] for a in (llm.Frictionless(), Parting()))
    for _ in range(40):
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
