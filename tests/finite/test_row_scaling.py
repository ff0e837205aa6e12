"""Rows of contact at finite deformation are made as large as those of equilibrium."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from dolfinx_llm.finite.linear.coupling import _scaling

pytestmark = pytest.mark.quick


def test_rows_that_have_come_to_nothing():
    """In an iteration that goes astray entries may be smaller than what has an inverse."""
    left = csr_matrix([[4.0, 0.0], [1e-318, 0.0], [1e-318, 0.0]])
    own = csr_matrix([[0.0, 1.0], [0.0, 0.5], [0.0, 1e-318]])
    with np.errstate(all="raise", under="ignore"):
        found = _scaling(SimpleNamespace(left=left, own=own), np.ones(2), 2.0)
    assert found.diagonal().tolist() == [0.5, 2.0, 1.0]
