"""Memory of problems that nobody needs any more."""

import gc
import resource
import weakref

import changed
import pytest
import scenes
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm

COMM = MPI.COMM_WORLD
WARM, COUNT = 5, 15
MOST = 0.15  # MB that a problem may leave; it was 0.6 to 0.7


def growth(work):
    """MB per call by which the largest memory grows, after a few calls."""
    for _ in range(WARM):
        work()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(COUNT):
        work()
    return (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024.0 / COUNT


@pytest.mark.parametrize(
    ("law", "form"),
    [("tied", "saddle"), longer("tied", "condensed"), longer("friction", "flexibility")],
)
def test_problems_that_are_dropped(law, form):
    data = changed.Data(COMM)
    assert growth(lambda: data.problem(law, form).solve()) <= MOST


def test_problems_that_cannot_be_made():
    data = changed.Data(COMM)
    data.bcs = scenes.hold(data.V, [(0, scenes.on(2, 0.0))])
    data.density.x.array[:] = 0.0

    def refused():
        with pytest.raises(llm.ContactError, match="held by no support"):
            data.problem("tied", "saddle")

    assert growth(refused) <= MOST


@pytest.mark.parametrize(("law", "form"), [("tied", "saddle"), ("frictionless", "condensed")])
def test_no_cycle_keeps_a_problem(law, form):
    """Freed when the last name goes, not when cycles are looked for."""
    gc.disable()
    try:
        problem = changed.Data(COMM).problem(law, form)
        problem.solve()
        parts = problem, problem.operators, problem.bulk, problem.method, problem.method.form
        parts = [weakref.ref(part) for part in parts]
        del problem
        assert [part() for part in parts] == [None] * 5
    finally:
        gc.enable()


def test_end_of_a_block():
    data = changed.Data(COMM)
    with data.problem("tied", "saddle") as problem:
        K = problem.K
        problem.solve()
    assert K.handle == 0
    with pytest.raises(llm.ContactError, match="destroyed"):
        problem.solve()
