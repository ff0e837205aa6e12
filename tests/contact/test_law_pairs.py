"""Every pair of laws as two interfaces of one problem, pressed, dragged, lifted and pressed again:
in 2D and 3D, in forms by turns; on two ranks every fourth pair."""

import numpy as np
import pytest
from conftest import run_mpi_json
from law_scenes import PAIRS, Lifted
from mpi4py import MPI

from dolfinx_llm.forms import choice

FORMS = "flexibility", "saddle", "condensed"


@pytest.mark.parametrize("ranks, gdim, first, every", [(1, 2, 0, 1), (1, 3, 1, 1), (2, 2, 2, 4)])
def test_every_pair(ranks, gdim, first, every):
    """The forms take turns, another one of each pair in each run."""
    forms = FORMS[first:] + FORMS[:first]
    found = run_mpi_json("law_pairs.py", ranks, gdim, every, *forms, seconds=900.0)
    assert len(found) == len(PAIRS[::every])
    wrong = [
        (pair, name, value)
        for pair, worst in found.items()
        for name, value in worst.items()
        if not value < 1e-9
    ]
    assert not wrong


def scene(gdim, name, form, monkeypatch):
    monkeypatch.setattr(choice, "FLEXIBLE", 0 if form == "saddle" else 10**6)
    return Lifted(MPI.COMM_SELF, gdim, name, "auto" if form == "flexibility" else form)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("gdim", [2, 3])
@pytest.mark.parametrize("name", ["smooth", "rough", "rigid smooth", "rigid rough", "rigid zero"])
def test_press_lift_and_press_again(name, gdim, form, monkeypatch):
    """A body that is not yet there, or is lifted off, is free of stress; pressed again it is where
    it was: straight down there is no other way to slip."""
    lifted, answers = scene(gdim, name, form, monkeypatch), []
    for down, along in ((0.02, 0.01), (0.08, 0.0), (-0.1, 0.02), (0.0, -0.01), (0.08, 0.0)):
        u = lifted.move(down, along)
        worst = lifted.violations()
        assert max(worst.values()) < 1e-9, worst
        answers.append(np.concatenate([f.x.array for f in u]))
        result = lifted.problem.results[0]
        if down < 0.05:
            moved = u[0].x.array.reshape(-1, gdim)
            assert np.abs(moved - moved[0]).max() < 1e-12
            assert not any(side.status.any() or side.force.any() for side in result.sides)
        else:
            assert result.resultant[-1] != 0.0
    if "rough" not in name:
        assert np.abs(answers[4] - answers[1]).max() < 1e-11
    lifted.problem.destroy()
