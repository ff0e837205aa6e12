"""What increments leave missed of the laws is said."""

from types import SimpleNamespace

import numpy as np
import pytest

from dolfinx_llm.finite.doubts import UNSAID, missed

pytestmark = pytest.mark.quick

NAMES = SimpleNamespace(
    sides=SimpleNamespace(surfaces=[SimpleNamespace(name=name) for name in ("tag 2", "tag 5")])
)


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e3])
def test_more_than_any_rest_leaves(size):
    """Of facets of one size, in any unit of length."""
    rest = np.array([0.0, -2e-9, 1e-12]) * size
    (said,) = missed(NAMES, SimpleNamespace(rest=rest), size)
    assert said.startswith("tag 2 on tag 5: what contact and friction ask for")
    assert "missed by 2e-09 of a facet" in said and "not unique: leave one side free" in said


def test_what_any_rest_leaves():
    """Or where there are no laws."""
    for rest in (np.zeros(0), np.array([0.9, -0.9]) * UNSAID):
        assert missed(NAMES, SimpleNamespace(rest=rest), 1.0) == []
