"""Which pairs stick and which slip next, as an iterate of finite deformation tells."""

import numpy as np
import pytest

from dolfinx_llm.finite.settling import differ
from dolfinx_llm.laws.rows import SLIP, STICK

pytestmark = pytest.mark.quick


def test_linear_model_is_asked_again_where_slip_turns_round():
    before = np.array([SLIP, STICK])
    assert differ(np.array([STICK, STICK]), before, None)
    assert not differ(np.array([SLIP, STICK]), before, None)
    assert not differ(np.array([SLIP, SLIP]), np.array([SLIP, SLIP]), None)
