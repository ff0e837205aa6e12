"""A thousand steps: nothing is made anew that has not changed, and nothing is kept."""

import resource

import pytest
from friction_block import Dragged
from mpi4py import MPI
from sampling import longer

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
