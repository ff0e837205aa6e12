"""Forces that equations leave open: the nearest to those wanted that have the same effect."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.sparse import csr_matrix

from dolfinx_llm.operators.reactions import _nearest

pytestmark = pytest.mark.quick


def drawn(seed, n, q):
    """Effects of rank below n, forces, and those wanted."""
    rng = np.random.default_rng(seed)
    fixed = rng.standard_normal((n, q))
    fixed[:, -1] = fixed[:, 0] + fixed[:, 1]  # effects that say the same
    return csr_matrix(fixed), *rng.uniform(0.1, 2.0, (2, n))


@pytest.mark.parametrize("seed", range(2101, 2105))
def test_chance_does_not_matter(seed):
    """What is added to forces without effect is taken out again; what has an effect stays."""
    fixed, forces, wanted = drawn(seed, 9, 5)
    none = np.linalg.svd(fixed.toarray().T)[2][4:]
    others = forces + 10.0 * none.T @ np.ones(len(none))
    presses = np.zeros(9, dtype=bool)
    found = [_nearest(fixed, a, wanted, presses, 1e-10) for a in (forces, others)]
    np.testing.assert_allclose(found[0], found[1], atol=1e-13)
    np.testing.assert_allclose(fixed.T @ found[0], fixed.T @ forces, atol=1e-13)
    np.testing.assert_allclose(none @ (found[0] - wanted), 0.0, atol=1e-13)


@pytest.mark.parametrize("seed", range(2111, 2115))
def test_none_pulls(seed):
    """Where the nearest would pull, it is the nearest of those that press: by a general method."""
    fixed, forces, wanted = drawn(seed, 9, 5)
    presses = np.arange(9) < 7
    wanted = wanted - 3.0 * presses
    found = _nearest(fixed, forces, wanted, presses, 1e-10)
    known = minimize(
        lambda x: np.sum((x - wanted) ** 2), forces, jac=lambda x: 2.0 * (x - wanted),
        method="SLSQP", bounds=[(0.0, None) if p else (None, None) for p in presses],
        constraints={"type": "eq", "fun": lambda x: fixed[:, :4].T @ (x - forces)},
        options={"ftol": 1e-15, "maxiter": 500},
    )  # fmt: skip
    assert found[presses].min() > -1e-13 and (found[presses] < 1e-12).any()
    np.testing.assert_allclose(fixed.T @ found, fixed.T @ forces, atol=1e-12)
    np.testing.assert_allclose(found, known.x, atol=1e-6)


def test_rounding_stays():
    """Forces that their effect tells stay as they are, also a pull that is rounding."""
    fixed, presses = csr_matrix(np.eye(3)), np.ones(3, dtype=bool)
    for forces, rounding in (([1.0, 2.0, -1e-12], 1e-10), ([0.0, 0.0, -1e-25], 0.0)):
        found = _nearest(fixed, np.array(forces), np.ones(3), presses, rounding)
        np.testing.assert_allclose(found, forces, atol=1e-15)
