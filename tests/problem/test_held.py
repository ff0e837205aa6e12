"""Supports that end at the interface from both sides: what bodies pass on, not the least."""

import held
import pytest
from conftest import run_mpi_json
from mpi4py import MPI

from dolfinx_llm.forms import choice


@pytest.fixture(autouse=True)
def flexible(monkeypatch):
    monkeypatch.setattr(choice, "FLEXIBLE", choice.FLEXIBLE)


@pytest.mark.parametrize("case", held.cases(), ids=str)
def test_patch(case):
    for name, error in held.patch(MPI.COMM_WORLD, *case).items():
        assert error <= 1e-10, name


@pytest.mark.parametrize("n", [2, 3])
def test_patch_on_ranks(n):
    found = run_mpi_json("held.py", n, *held.LAWS)
    assert len(found) == len(list(held.cases()))
    for name, errors in found.items():
        assert max(errors.values()) <= 1e-10, (name, errors)
