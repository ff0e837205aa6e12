"""Every pair of laws as two interfaces of one problem, pressed, dragged, lifted and pressed again;
every law in 2D and 3D, in every form, on one rank and on two."""

import itertools

import law_pairs
import numpy as np
import pytest
from conftest import run_mpi_json
from law_scenes import Lifted
from mpi4py import MPI
from sampling import covering, longer, some_of

from dolfinx_llm.forms import choice

FORMS = law_pairs.FORMS


@pytest.mark.parametrize(
    ("ranks", "part"), [(1, "first"), (2, "few"), longer(2, "first"), longer(1, "others")]
)
def test_every_pair(ranks, part):
    found = run_mpi_json("law_pairs.py", ranks, part)
    assert len(found) == len(law_pairs.cases(ranks, part)) >= 2
    wrong = [
        (pair, name, value)
        for pair, worst in found.items()
        for name, value in worst.items()
        if not value < 1e-9
    ]
    assert not wrong


def scene(gdim, name, form, monkeypatch):
    monkeypatch.setattr(choice, "FLEXIBLE", 0 if form == "saddle" else 10**6)
    return Lifted(MPI.COMM_SELF, gdim, name, "saddle" if form == "flexibility" else form)


NAMES = ["smooth", "rough", "rigid smooth", "rigid rough", "rigid zero"]


# In 3D the one takes as long as all others.
KEPT = covering(NAMES, (2, 3), FORMS)[::2]
KEPT[KEPT.index(("smooth", 3, "condensed"))] = ("smooth", 2, "condensed")


@pytest.mark.parametrize(
    ("name", "gdim", "form"), some_of(itertools.product(NAMES, (2, 3), FORMS), KEPT)
)
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
