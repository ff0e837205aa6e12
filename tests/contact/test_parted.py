"""Frames between bodies that have come apart."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from dolfinx_llm.contact.parted import _farthest

pytestmark = pytest.mark.quick


@pytest.mark.parametrize("unit", [1e-12, 1e-8, 1.0, 1e9])
def test_in_any_units(unit):
    """Two nodes between a body below, up to 0.2, and one from 1 and 0.6 on: midway."""
    N = np.array([[1.0, 0.0], [0.0, 1.0], [0.5, 0.5]])
    low, high = np.array([0.2, 0.1, 0.2]), np.array([1.0, 0.6, 0.8])
    L, position = csr_matrix(np.vstack([N, -N])), np.concatenate([low, -high])
    found = _farthest(L, position * unit, unit)
    least = (L @ found - position * unit).min() / unit
    assert least == pytest.approx(0.25, rel=1e-6)
    assert _farthest(L, -position * unit, unit) is None
