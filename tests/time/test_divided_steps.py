"""Steps in time that are divided lead bodies as the same parts do that are taken one by one."""

import numpy as np
import pytest
import ufl
from conftest import run_mpi_json
from contact_scenes import ABOVE, BELOW, rectangle
from dolfinx import fem
from led_scenes import DT, LEADERS, Led
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

QUICK = ("support", "second order"), ("gap", "second order"), ("pressure", "nonlinear")
NOT_THERE = ("pressure", "linear"), ("pressure", "second order"), ("gap", "nonlinear")


def marked(led, kind):
    """A scene; those that take long are a sample's rest."""
    quick = kind == "linear" or (led, kind) in QUICK
    return pytest.param(led, kind, marks=[] if quick else [pytest.mark.long])


SCENES = [
    marked(led, kind)
    for led in LEADERS
    for kind in ("linear", "second order", "nonlinear")
    if (led, kind) not in NOT_THERE
]


def steps(led, divided, **options):
    """A step, and one in parts of a quarter, a quarter and a half: divided, or by hand."""
    scene = Led(led, **options)
    scene.lead(0.0)
    scene.s.start()
    scene.lead(DT)
    scene.s.step()
    if divided:
        scene.divides(0.25 * DT)
    for part in [1.0] if divided else [0.25] * 4:
        scene.s.dt = part * DT
        scene.lead(scene.s.t + scene.s.dt)
        given = dict(vars(scene.one))
        scene.s.step()
        assert all(value is given[name] for name, value in vars(scene.one).items())
    found = scene.found()
    scene.s.destroy()
    return scene.times, found


@pytest.mark.parametrize(("led", "kind"), SCENES)
def test_parts_are_those_taken_by_hand(led, kind):
    """The first part took all of the way."""
    options = {"nonlinear": kind == "nonlinear", "order": 1 + (kind == "second order")}
    (times, found), (others, known) = (steps(led, d, **options) for d in (True, False))
    assert len(times) == 5 and np.allclose(times, others, rtol=1e-12)
    for one, other in zip(found, known, strict=True):
        assert np.abs(other).max() > 1e-6
        assert np.abs(one - other).max() <= 1e-12 * np.abs(other).max()


def test_saved_and_on_two_ranks(tmp_path):
    """What a part begins with is in the file, and the same on any number of ranks."""
    scene = Led("plane")
    scene.lead(0.0)
    scene.s.start()
    scene.lead(DT)
    scene.s.step()
    scene.s.save(tmp_path / "led.npz")
    scene.divides(0.5 * DT)
    scene.lead(2.0 * DT)
    scene.s.step()
    known = np.array([r.resultant for r in scene.s.problem.results])
    for ranks in (1, 2):
        found = run_mpi_json("divided_ranks.py", ranks, tmp_path / "led.npz")["resultants"]
        assert np.abs(found - known).max() <= 1e-10 * np.abs(known).max(), ranks


def test_a_plane_that_hits_a_bar():
    """Its work is the energy of the bar, and dividing steps where it meets the bar brings that
    nearer to the energy by small steps: -3 % without, -11 % where it went all of its way in the
    first part."""
    exact, whole, divided = (struck(*given) for given in ((0.00125,), (0.02,), (0.02, 1e-2)))
    assert abs(divided[0] / exact[0] - 1.0) < 0.01 < abs(whole[0] / exact[0] - 1.0)
    assert abs(divided[0] / divided[1] - 1.0) < 1e-3


def struck(dt, adaptive=None):
    """Energy of a bar at rest that a plane has hit and moves on with, and the plane's work."""
    domain, tags = rectangle(MPI.COMM_SELF, (3, 12), (0, 0), (0.25, 1), "quadrilateral")
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = 50.0 * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(w))) * ufl.dx
    L = ufl.inner(fem.Constant(domain, (0.0, 0.0)), w) * ufl.dx
    plane = llm.RigidPlane((0.0, -0.013), (0.0, 1.0))
    interface = llm.Interface(tags, (BELOW, plane), law=llm.Frictionless())
    s = llm.TimeStepper(1.0, a, L, dt=dt, interfaces=interface, adaptive=adaptive)
    (rho,) = s.density
    strain = 25.0 * ufl.inner(ufl.sym(ufl.grad(s.u)), ufl.sym(ufl.grad(s.u)))
    energy = fem.form((0.5 * rho * ufl.inner(s.v, s.v) + strain) * ufl.dx)
    for k in range(round(0.1 / dt)):
        plane.displacement = 0.0, 0.5 * (k + 1) * dt
        s.step()
    momentum = fem.assemble_scalar(fem.form(rho * s.v[1] * ufl.dx))
    return fem.assemble_scalar(energy), 0.5 * momentum


@pytest.mark.parametrize("rests", ["plane", "base"])
def test_what_rests_is_not_divided(rests):
    """A block under its weight where statics put it: what closing takes is rounding, as is what it
    moves with; a step took 64 parts."""
    body, tags = rectangle(MPI.COMM_SELF, (5, 4), (0, 0), (1, 0.5), "quadrilateral")
    base, above = rectangle(MPI.COMM_SELF, (7, 4), (-0.5, -0.5), (1.5, 0), "quadrilateral")
    spaces = [compat.function_space(domain, shape=(2,)) for domain in (body, base)]
    weight = (0.0, -10.0), (0.0, 0.0)
    a, L, sides, bcs = [], [], [(tags, BELOW)], []
    for V, load in zip(spaces, weight, strict=True):
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        a.append(1e4 * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(w))) * ufl.dx)
        L.append(ufl.inner(fem.Constant(V.mesh, load), w) * ufl.dx)
    if rests == "plane":
        a, L, sides = a[0], L[0], [*sides, llm.RigidPlane((0.0, 0.0), (0.0, 1.0))]
    else:
        low = fem.locate_dofs_geometrical(spaces[1], lambda x: np.isclose(x[1], -0.5))
        bcs, sides = [fem.dirichletbc(np.zeros(2), low, spaces[1])], [*sides, (above, ABOVE)]
    given = {"bcs": bcs, "interfaces": [llm.Interface(None, tuple(sides), law=llm.Coulomb(0.3))]}
    found = llm.ContactProblem(a, L, **given).solve()
    taken = []
    options = {"adaptive": 1e-4, "accepted": lambda stepper: taken.append(stepper.t)}
    s = llm.TimeStepper(1.0, a, L, dt=0.05, **given, **options)
    for own, u in zip([s.u] if rests == "plane" else s.u, [found] if rests == "plane" else found):
        own.x.array[:] = u.x.array
    for _ in range(3):
        s.step()
    assert len(taken) == 3
