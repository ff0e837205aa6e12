"""λ' = max(0, λ + k (y + g - L w')), Lᵀ λ' = Lᵀ λ, against the conditions of complementarity."""

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.sparse import csr_matrix

from dolfinx_llm.laws.forecast import Forecast

pytestmark = pytest.mark.quick


@pytest.mark.parametrize("seed", [1602, 1603])
def test_complementarity(seed):
    """With compliance 1 / k the rows that press are those of the quadratic programme, and from its
    solution the same come back whatever k is. Some rows are closed for good, some out of reach."""
    rng = np.random.default_rng(seed)
    n, m = 60, 9
    x, nodes = rng.uniform(0.0, m - 1.0, n), np.arange(m)
    L = (
        np.maximum(1.0 - np.abs(x[:, None] - nodes), 0.0)
        * np.where(np.arange(n) % 2, 1, -1)[:, None]
    )
    k, press = rng.uniform(0.5, 3.0, n), rng.uniform(size=n) < 0.9
    k[:4], press[:4] = 0.0, True
    position = -np.sign(L.sum(axis=1)) * 0.1 * (x - 4.0) + rng.normal(size=n)
    free = np.zeros(m)
    found = Forecast(csr_matrix(L), k, press, free, free).pressing(np.zeros(n), position)
    held = found | (~press & (k > 0.0))
    assert not found[k == 0.0].any()
    A = np.block([[np.diag(1.0 / k[held]), L[held]], [L[held].T, -1e-12 * np.eye(m)]])
    answer = np.linalg.solve(A, np.concatenate([position[held], np.zeros(m)]))
    force = np.zeros(n)
    force[held] = answer[: held.sum()]
    assert (force[found] > -1e-7).all()
    assert _frame(L, position - force / np.where(k > 0.0, k, 1.0), held, press & (k > 0.0))
    moved = position - force / np.where(k > 0.0, k, 1.0)
    other = Forecast(csr_matrix(L), 7.0 * k, press, free, free).pressing(force, moved)
    assert (other | (force < 1e-6))[found].all()


def _frame(L, position, on, press):
    """Whether some w meets the rows in contact, and no other that could press overlaps."""
    rows = [L[press], -L[on]]
    least = [position[press], -position[on]]
    A, b = -np.concatenate(rows), 1e-7 - np.concatenate(least)
    return linprog(np.zeros(L.shape[1]), A_ub=A, b_ub=b, bounds=(None, None)).status == 0


def test_no_frame():
    """Against an obstacle each pair is on its own."""
    k, none = np.array([1.0, 2.0, 1.0]), np.zeros(0)
    forecast = Forecast(csr_matrix((3, 0)), k, np.ones(3, dtype=bool), none, none)
    position = np.array([-2.0, -2.0, 1.0])
    assert forecast.pressing(np.array([1.0, 5.0, 0.0]), position).tolist() == [False, True, True]
