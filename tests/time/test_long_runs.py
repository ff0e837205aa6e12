"""A thousand steps: nothing is made anew that has not changed, and nothing is kept."""

import resource
import time

import pytest
import ufl
from dolfinx import fem
from friction_block import BOTTOM, Dragged, body, stress
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.forms import direct

MOST = 0.5  # MB by which the largest memory may grow after the first steps


@pytest.fixture
def factorised(monkeypatch):
    """Counts what is factorised."""
    counts, original = [], direct.factorised

    def counted(*args):
        counts.append(args[1])
        return original(*args)

    monkeypatch.setattr(direct, "factorised", counted)
    return counts


def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def repeated(step, count):
    """MB by which memory grows over so many steps, after some to warm up."""
    for _ in range(count // 5):
        step()
    before = peak()
    for _ in range(count):
        step()
    return peak() - before


@pytest.mark.parametrize("count", [50, longer(1000)])
def test_steps_in_time(factorised, count):
    """A bar that bounces: its matrix at the start and that of the steps."""
    import impact_bar

    bar = impact_bar.Bar(20, comm=MPI.COMM_SELF)
    bar.stepper.step()
    assert len(factorised) == 2
    assert repeated(bar.stepper.step, count) <= MOST
    assert len(factorised) == 2


@pytest.mark.parametrize("count", [10, longer(1000)])
def test_load_steps(factorised, count):
    """A block dragged to and fro with friction: factorised once."""
    scene, ways = Dragged(0.3, (4, 5)), []

    def step():
        ways.append(0.0005 * (-1) ** len(ways))
        scene.step(ways[-1])

    assert repeated(step, count) <= MOST
    assert len(factorised) == 1


@pytest.mark.parametrize("cells", [8, longer(55), longer(112)])
def test_a_step_over_a_back_substitution(cells, monkeypatch):
    """A block that lies on a plane and swings: two back-substitutions a step, for the load and for
    the displacement, now and then one more that refines; what all of it takes of one's time is
    printed, 5 asked."""
    domain, tags = body(MPI.COMM_SELF, (-1.0, 0.0), (2.0, 2.0), (cells, cells))
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = ufl.inner(stress(u, 1e3, 0.3), ufl.grad(w)) * ufl.dx
    L = ufl.inner(fem.Constant(domain, (0.0, -10.0)), w) * ufl.dx
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    on_plane = llm.Interface(tags, (BOTTOM, plane), law=llm.Frictionless())
    s = llm.TimeStepper(1.0, a, L, dt=0.01, interfaces=on_plane)
    seconds, original = [], direct.DirectSolver.once

    def timed(solver, b):
        began = time.process_time()
        found = original(solver, b)
        seconds.append(time.process_time() - began)
        return found

    monkeypatch.setattr(direct.DirectSolver, "once", timed)
    monkeypatch.setattr(direct.DirectSolver, "solve", None)
    for _ in range(3):
        s.step()
    seconds.clear()
    began, count = time.process_time(), 20
    for _ in range(count):
        s.step()
        assert s.problem.history[-1]["active"] == cells + 1 and len(s.problem.history) == 1
    ratio = len(seconds) * (time.process_time() - began) / count / sum(seconds)
    print(f"{s.problem.unknowns['u']} unknowns: {ratio:.2f} back-substitutions a step")
    assert 2 * count <= len(seconds) <= 2.5 * count
    s.destroy()
