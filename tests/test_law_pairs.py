"""Every pair of laws as two interfaces of one problem, pressed, dragged, lifted and pressed again:
in all solver forms, in 2D and 3D, on one rank and on two."""

import pytest
from conftest import run_mpi_json
from law_scenes import PAIRS

FORMS = "flexibility", "saddle", "condensed"


def check(found):
    assert len(found) == len(PAIRS)
    wrong = {
        pair: {name: value for name, value in worst.items() if not value < 1e-9}
        for pair, worst in found.items()
    }
    assert not {pair: values for pair, values in wrong.items() if values}


@pytest.mark.parametrize("form", FORMS)
def test_in_every_form(form):
    check(run_mpi_json("law_pairs.py", 1, 2, form, seconds=600.0))


@pytest.mark.parametrize("ranks, gdim", [(1, 3), (2, 2)])
def test_forms_by_turns(ranks, gdim):
    check(run_mpi_json("law_pairs.py", ranks, gdim, *FORMS, seconds=600.0))


def test_forms_by_turns_in_3d_on_two_ranks():
    """Another form for each pair."""
    check(run_mpi_json("law_pairs.py", 2, 3, *FORMS[::-1], seconds=600.0))
