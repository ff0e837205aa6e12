"""Supports that end at the interface from both sides: what bodies pass on, not the least."""

import held
import pytest
from conftest import run_mpi_json
from sampling import longer


@pytest.mark.parametrize("ranks", [1, 2, longer(3)])
def test_patch(ranks):
    """Every pair of walls, law, form, order of the sides and number of ranks."""
    found = run_mpi_json("held.py", ranks)
    assert len(found) == len(held.cases(ranks)) > 2
    for name, errors in found.items():
        assert max(errors.values()) <= 1e-10, (name, errors)
