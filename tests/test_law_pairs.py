"""Every pair of laws as two interfaces of one problem, pressed, dragged, lifted and pressed again:
in 2D and 3D, on one rank and on two, each pair in each of the three solver forms."""

import pytest
from conftest import run_mpi_json
from law_scenes import PAIRS

FORMS = "flexibility", "saddle", "condensed"


@pytest.mark.parametrize("ranks, gdim, first", [(1, 2, 0), (1, 3, 1), (2, 2, 2)])
def test_every_pair(ranks, gdim, first):
    """The forms take turns, another one of each pair in each run."""
    forms = FORMS[first:] + FORMS[:first]
    found = run_mpi_json("law_pairs.py", ranks, gdim, *forms, seconds=900.0)
    assert len(found) == len(PAIRS)
    wrong = [
        (pair, name, value)
        for pair, worst in found.items()
        for name, value in worst.items()
        if not value < 1e-9
    ]
    assert not wrong
