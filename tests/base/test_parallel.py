"""What is the same on all ranks, whatever each of them rounds."""

import numpy as np
import pytest
from conftest import run_mpi_json
from mpi4py import MPI
from pressed_scenes import Punch

from dolfinx_llm.base.parallel import copied


@pytest.mark.parametrize("ranks", [2, 3])
def test_ranks_that_round_otherwise(ranks):
    """Rank 0 chooses, also an error; arguments may differ by rounding and no more."""
    every = run_mpi_json("rounded.py", ranks)["every"]
    assert len(every) == ranks
    assert all(found == every[0] for found in every)
    found = every[0]
    assert found["told"] == 0.1
    assert found["chosen"] == [0, 0.1]
    assert found["error"] == "on rank 0"
    refused = {name for name, is_so in found.items() if is_so is True}
    assert refused == {name for name in found if name.startswith("another")}


def test_copies_are_the_users():
    """Arrays of their own, which may be written to where those before may not; what stands in
    several places still does."""
    x = np.broadcast_to(np.arange(3.0), (2, 3))
    one, other = copied(MPI.COMM_WORLD, [x, x])
    assert one is other and np.array_equal(one, x)
    one[:] = 7.0
    assert x.max() == 2.0


def test_what_is_covered_by_rounding_alone():
    """On one of two ranks: at finite deformation nodes leave the frame's edge on both together, and
    forces are those on one rank. One of them waited for the other."""
    found = run_mpi_json("slivers.py", 2, seconds=100)
    assert found["same"]
    punch = Punch()
    for along in (0.35, 0.62):
        known = punch.to(0.02, along).resultant
    assert np.allclose(found["force"], known, rtol=1e-9)
