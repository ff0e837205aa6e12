"""What bodies remember: called once for each part of a load step, and taken back with it."""

import json

import numpy as np
import pytest
import ufl
import viscoelastic_seal
from conftest import TESTS, run_mpi
from dolfinx import fem, mesh
from friction_block import BOTTOM, body, stress
from hertz2d import hold
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM = MPI.COMM_SELF


@pytest.mark.parametrize(
    "cells", [mesh.CellType.triangle, longer(mesh.CellType.quadrilateral)], ids=str
)
def test_evolution_takes_all_new_values_from_the_old_ones(cells):
    """At points of quadrature, in cells and at nodes; two Functions change places."""
    domain = mesh.create_unit_square(COMM, 3, 2, cells)
    Q, T = compat.quadrature_space(domain, 2), compat.quadrature_space(domain, 2, (2, 2))
    C, V = compat.function_space(domain, "DG", 0), compat.function_space(domain, shape=(2,))
    a, b, t, c, u = (fem.Function(W) for W in (Q, Q, T, C, V))
    x = ufl.SpatialCoordinate(domain)
    dx = ufl.dx(domain, metadata={"quadrature_degree": 2})
    llm.Evolution({a: x[0] ** 2, b: 2.0 + x[1], c: x[0], u: x})()
    moved = ufl.as_matrix([[a, x[0]], [x[1], b]])
    swap = llm.Evolution({a: b, b: a, t: moved, u: 2.0 * u + x, c: c + 1.0})
    swap(None)

    def differ(one, two):
        return fem.assemble_scalar(fem.form(ufl.inner(one - two, one - two) * dx))

    assert differ(a, 2.0 + x[1]) <= 1e-28 and differ(b, x[0] ** 2) <= 1e-28
    assert differ(t, ufl.as_matrix([[x[0] ** 2, x[0]], [x[1], 2.0 + x[1]]])) <= 1e-28
    assert differ(u, 3.0 * x) <= 1e-28
    mean = fem.assemble_scalar(fem.form(c * ufl.dx))
    assert abs(mean - 1.5) <= 1e-14 and swap.state == [a, b, t, u, c]


def test_parts_of_a_step_in_time_are_steps_in_time():
    """Three increments of a step are three steps of a third; dt is as given afterwards."""
    whole, parts = viscoelastic_seal.Seal(comm=COMM), viscoelastic_seal.Seal(comm=COMM)
    for seal in (whole, parts):
        seal.go(0.06, 0.2)
    for c in (0.08, 0.1, 0.12):
        last = parts.go(c, 0.3)
    seen, memory = [], whole.memory

    def accepted(problem):
        assert problem is whole.contact
        force = 2.0 * problem.results[1].sides[0].normal_force.sum()
        seen.append((float(whole.dt.value), force, float(np.abs(problem.u.x.array).max())))
        memory(problem)

    whole.dt.value = 0.9
    for way, plate in zip((0.5, -0.5), whole.plates, strict=True):
        plate.displacement = (0.0, way * 0.12 * viscoelastic_seal.DIAMETER)
    whole.contact.solve(3, accepted=accepted, state=memory.state, dt=whole.dt)
    assert float(whole.dt.value) == 0.9
    assert [dt for dt, _, _ in seen] == pytest.approx([0.3] * 3, rel=1e-12)
    forces = [row[1] for row in parts.rows[1:]]
    # Loads of the parts are of the whole step, so that what it relaxes differs a little.
    assert [force for _, force, _ in seen] == pytest.approx(forces, rel=1e-6)
    assert seen[-1][1] == pytest.approx(last, rel=1e-6)
    for a, b in zip(memory.state, parts.memory.state, strict=True):
        size = np.abs(b.x.array).max()
        assert np.abs(a.x.array - b.x.array).max() <= 1e-6 * size


class Softens:
    """A block on a plane, pressed from above, whose modulus the user's call changes."""

    def __init__(self):
        domain, tags = body(COMM, (0.0, 0.0), (1.0, 1.0), (3, 3))
        V = compat.function_space(domain, shape=(2,))
        self.u, w = fem.Function(V), ufl.TestFunction(V)
        self.E = fem.Function(compat.function_space(domain, "DG", 0))
        self.E.x.array[:] = 10.0
        self.top, side = hold(V, 1, lambda x: np.isclose(x[1], 1.0)), V.sub(0)
        plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
        held = hold(V, 0, lambda x: np.isclose(x[0], 0.0))
        assert side is not None
        self.problem = llm.NonlinearContactProblem(
            ufl.inner(stress(self.u, self.E, 0.3), ufl.grad(w)) * ufl.dx,
            self.u,
            bcs=[self.top, held],
            interfaces=[llm.Interface(tags, (BOTTOM, plane), law=llm.Frictionless())],
        )

    def press(self, depth, *increments, **memory):
        self.top.g.x.array[:] = -depth
        self.problem.solve(*increments, **memory)
        return self.problem.results[0].sides[0].normal_force.sum()


@pytest.mark.parametrize("handed", [True, False])
def test_a_step_that_fails_later_on(handed):
    """With its Functions handed over all of it is given up; without, what was found is kept."""
    scene, seen = Softens(), []
    first = scene.press(0.01)
    before = scene.u.x.array.copy()

    def accepted(problem):
        seen.append(problem.u.x.array.copy())
        scene.E.x.array[:] = 8.0 if len(seen) < 2 else np.nan

    state = {"state": scene.E} if handed else {}
    with pytest.raises(llm.ContactError, match="Newton's iteration fails at 0.5"):
        scene.press(0.03, 4, accepted=accepted, **state)
    assert len(seen) == 2  # the third part fails
    np.testing.assert_array_equal(scene.u.x.array, before if handed else seen[-1])
    found = scene.problem.results[0].sides[0].normal_force.sum()
    if handed:
        assert found == first and (scene.E.x.array == 10.0).all()
        assert scene.press(0.02) == pytest.approx(2.0 * first, rel=1e-10)
    else:
        assert np.isnan(scene.E.x.array).all() and found > 1.5 * first


def test_what_the_user_raises_takes_the_step_back():
    scene = Softens()
    scene.press(0.01)
    before = scene.u.x.array.copy()

    def accepted(problem):
        scene.E.x.array[:] = 3.0
        raise RuntimeError("mine")

    with pytest.raises(RuntimeError, match="mine"):
        scene.press(0.02, accepted=accepted, state=[scene.E])
    np.testing.assert_array_equal(scene.u.x.array, before)
    assert (scene.E.x.array == 10.0).all()


def creeping(increments):
    """A linear block that creeps on a plane: force, per step of 0.5 tau, and calls."""
    domain, tags = body(COMM, (0.0, 0.0), (1.0, 1.0), (3, 3))
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    Z, x = compat.quadrature_space(domain, 2, (2, 2)), 0.5
    viscous, before = fem.Function(Z), fem.Function(Z)
    now, dx = fem.Function(V), ufl.dx(domain, metadata={"quadrature_degree": 2})
    fades, grows = float(np.exp(-x)), 0.6 * (1.0 - float(np.exp(-x))) / x
    a = (0.4 + grows) * ufl.inner(stress(u, 1.0, 0.3), ufl.grad(w)) * dx
    L = -ufl.inner(fades * viscous - grows * before, ufl.grad(w)) * dx
    elastic = stress(now, 1.0, 0.3)
    evolution = llm.Evolution(
        {viscous: fades * viscous + grows * (elastic - before), before: elastic}
    )
    held = hold(V, 0, lambda x: np.isclose(x[0], 0.0))
    top = hold(V, 1, lambda x: np.isclose(x[1], 1.0))
    top.g.x.array[:] = -0.01
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    interface = llm.Interface(tags, (BOTTOM, plane), law=llm.Coulomb(0.2))
    problem = llm.ContactProblem(a, L, bcs=[held, top], interfaces=[interface])
    forces, calls = [], []

    def accepted(given):
        calls.append(given)
        now.x.array[:] = given.u.x.array
        evolution()

    for _ in range(4):
        problem.solve(increments, accepted=accepted, state=evolution.state)
        forces.append(problem.results[0].sides[0].normal_force.sum())
    assert calls == [problem] * 4
    return np.array(forces)


@pytest.mark.parametrize("increments", [1, 3])
def test_linear_bodies_remember_once_a_step(increments):
    """Held, a creeping block presses with g(t); its first step is a ramp of 0.5 tau."""
    forces = creeping(increments)
    t = 0.5 * np.arange(4)
    ramp = 0.6 * (1.0 - np.exp(-0.5)) / 0.5
    expected = (0.4 + ramp * np.exp(-t)) / (0.4 + ramp)
    np.testing.assert_allclose(forces / forces[0], expected, rtol=1e-9)


def test_demo_of_a_viscoelastic_seal(tmp_path):
    """Also its picture and its series."""
    arguments = ["--steps", "5", "--plot", str(tmp_path), "--output", str(tmp_path)]
    found = viscoelastic_seal.main(arguments)
    assert found["relaxation"] <= 1e-5 and abs(found["last"] - 1.0) <= 1e-3
    assert 0.5 < found["open"] < 6.0
    for name in ("viscoelastic_seal.png", "bodies_0.pvd", "interface_1/side_0.pvd"):
        assert (tmp_path / name).stat().st_size > 0


@pytest.mark.long
@pytest.mark.parametrize("ranks", [1, 2])
def test_demo_of_an_indentation(ranks, tmp_path):
    """Force in every step and print against one piece."""
    report, options = tmp_path / "found.json", ["--elements", "4", "3"]
    run_mpi(TESTS.parent / "demos" / "indentation.py", ranks, *options, "--json", report)
    found = json.loads(report.read_text())
    assert np.abs(np.array(found["over one piece"]) - 1.0).max() <= 0.01
    assert abs(found["print over one piece"] - 1.0) <= 0.01
    assert 0.03 < found["print"] < 0.06 and found["force"] > 2.0
    assert 0.0 < found["let up"] < 0.9 * found["force"] and abs(found["away"]) <= 1e-9
