"""Supports that end at the interface from both sides: what bodies pass on, not the least."""

import held
import pytest
from conftest import run_mpi_json
from mpi4py import MPI


@pytest.mark.parametrize("case", held.cases(), ids=str)
def test_patch(case):
    for name, error in held.patch(MPI.COMM_WORLD, *case).items():
        assert error <= 1e-10, name


@pytest.mark.parametrize("ranks", [2, 3])
def test_patch_on_ranks(ranks):
    found = run_mpi_json("held.py", ranks)
    words = {word for name in found for word in name.split()}
    assert len(found) >= 6 and {*held.LAWS, *held.FORMS} <= words
    for name, errors in found.items():
        assert max(errors.values()) <= 1e-10, (name, errors)
