"""Steps in time start, with friction, from bodies drawn in touch."""

import numpy as np
import pytest
from test_supports_between_steps import Pair

import dolfinx_llm as llm


@pytest.mark.parametrize("kind", ["linear", "finite"])
def test_in_touch_under_weight(kind):
    """Gaps of 1e-10 opened pairs, as the inertia that holds bodies at first counted as stiffness of
    their surfaces: the start took many iterations, or failed, on no more than five pairs."""
    pair = Pair(kind, llm.Coulomb(0.3), False)
    pair.stepper.start()
    assert len(pair.stepper.problem.history) < 10
    result = pair.stepper.problem.results[0]
    forces = [side.force.sum(axis=0) for side in result.sides]
    assert np.abs(forces[0] + forces[1]).max() < 1e-9 * np.abs(forces[0]).max()
    along, across = np.abs(result.resultant)
    assert 0.0 < along <= 0.3 * across * (1.0 + 1e-6)
