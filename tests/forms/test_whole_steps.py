"""Steps of contact laws on the whole system: in one part, and as the surfaces' flexibility."""

import hertz2d
import numpy as np
import pytest
import whole_steps
from conftest import run_mpi_json
from mpi4py import MPI
from sampling import longer, some_of

from dolfinx_llm.contact import load_steps

COMM = MPI.COMM_SELF
SEEDS = (402, 403, 407, 410, 412, 414, 416, 418, 422, 423, 435, 454)


def check(found):
    for solver, outcome in found.items():
        assert outcome["error"] <= 1e-9, solver
        assert outcome["violation"] <= 1e-10, solver


@pytest.fixture
def settings(monkeypatch):
    """Puts back what the scenes change."""
    monkeypatch.setattr(load_steps, "SMALLEST", load_steps.SMALLEST)


@pytest.mark.parametrize("seed", some_of(SEEDS, SEEDS[:1]))
def test_random_scenes(seed, settings):
    check(whole_steps.compare(COMM, seed))


@pytest.mark.long  # of every law and form: contact/test_law_pairs
def test_ranks():
    found = run_mpi_json("whole_steps.py", 2, 423)
    assert len(found) == 1
    for outcome in found.values():
        check(outcome)


@pytest.mark.parametrize("elements", [(8, 12), longer((12, 17))])
def test_hertz(elements):
    """With weights of the pressure, which the condensed form could not settle pair by pair."""
    a, p0 = hertz2d.hertz("cylinders")
    answers = []
    for solver in ("auto", "condensed"):
        problem = hertz2d.problem("cylinders", elements, design="weights", solver=solver, comm=COMM)
        u = np.concatenate([f.x.array for f in problem.solve()])
        answers.append((u, np.concatenate([s.normal_force for s in problem.results[0].sides])))
        assert len(problem.history) <= 8
        assert hertz2d.figures(problem, a, p0)["frame"]["L2 error"] <= 0.03
    assert problem.form == "condensed"
    for one, other in zip(*answers, strict=True):
        assert np.abs(one - other).max() <= 1e-9 * np.abs(one).max()
