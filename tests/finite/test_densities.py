"""Tractions at the nodes of second-order surfaces where bodies stand now."""

import numpy as np
import pytest

from dolfinx_llm.finite.densities import densities
from dolfinx_llm.geometry.surface import Surface


@pytest.mark.quick
def test_a_body_on_its_corner():
    """Nothing of a steep end is covered by the floor: its corner has force per area."""
    x = np.column_stack([np.zeros(5), np.linspace(1.0, 0.0, 5)])
    end = Surface(
        x=x,
        facets=np.array([[0, 2], [2, 4]]),
        dofs=np.arange(5),
        owner=np.zeros(5, dtype=np.int64),
        name="end",
        elements=np.array([[0, 2, 1], [2, 4, 3]]),
    )
    floor = Surface(
        x=np.array([[-1.0, 0.0], [1.0, 0.0]]),
        facets=np.array([[1, 0]]),
        dofs=np.arange(2),
        owner=np.zeros(2, dtype=np.int64),
        name="floor",
    )
    area = np.array([1.0, 4.0, 2.0, 4.0, 1.0]) / 12.0
    force = np.zeros((5, 2))
    force[-1] = 0.0, -3.0
    down = np.tile([0.0, -1.0], (5, 1))
    found = densities(
        (floor, end),
        (floor.x, x),
        (np.ones(2), area),
        (np.array([[0.0, 1.5], [0.0, 1.5]]), force),
        (-down[:2], down),
        (np.array([[0.0, 1.5], [0.0, 1.5]]), force / area[:, None]),
        presses=True,
    )
    assert found[0] is None
    np.testing.assert_array_equal(found[1], force / area[:, None])
