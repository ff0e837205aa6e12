"""What is changed between two load steps at finite deformation counts in the second."""

import numpy as np
import pytest
from pressed_scenes import Punch

import dolfinx_llm as llm


def test_a_mesh_that_was_moved():
    """A punch that is drawn deeper is pressed as one that is moved there, and slides from there."""
    drawn, moved = (Punch(law=llm.Coulomb(0.3)) for _ in range(2))
    drawn.to(0.01)
    x = drawn.u[1].function_space.mesh.geometry.x
    x[:, 1] -= 0.02
    drawn.u[1].x.array[:] = drawn.u[0].x.array[:] = 0.0
    for along in (0.0, 0.01, 0.1):
        found = drawn.to(0.01, along).resultant
        known = moved.to(0.03, along).resultant
        assert np.allclose(found, known, rtol=1e-8)
    assert len(drawn.problem.history) == len(moved.problem.history)
    assert np.abs(drawn.u[1].x.array[1::2].min() + 0.01) < 1e-9
    x[0, 0] = np.nan
    for _ in range(2):
        with pytest.raises(llm.ContactInputError, match="positions of 1 node"):
            drawn.problem.solve()
