"""λ >= 0, s = M λ + q >= 0, λ s = 0: by hand values, and against all sets of positive λ."""

import itertools

import numpy as np
import pytest

from dolfinx_llm.laws.complementarity import complementarity

pytestmark = pytest.mark.quick


def solve(M, q, start=False):
    """λ and s of the set that is found."""
    positive = complementarity(M, q, np.full(len(q), start))
    x = np.zeros(len(q))
    x[positive] = np.linalg.solve(M[np.ix_(positive, positive)], -q[positive])
    return x, M @ x + q


def all_solutions(M, q):
    """Every set that meets the conditions, one after the other."""
    for chosen in itertools.product([False, True], repeat=len(q)):
        on, x = np.array(chosen), np.zeros(len(q))
        x[on] = np.linalg.solve(M[np.ix_(on, on)], -q[on])
        if min((M @ x + q)[~on].min(initial=0.0), x[on].min(initial=0.0)) >= -1e-12:
            yield x


@pytest.mark.parametrize("start", [False, True])
@pytest.mark.parametrize(
    ("M", "q", "x", "s"),
    [
        ([[2.0]], [-4.0], [2.0], [0.0]),  # pressed
        ([[2.0]], [4.0], [0.0], [4.0]),  # apart
        ([[2.0, 1.0], [1.0, 2.0]], [-4.0, 1.0], [2.0, 0.0], [0.0, 3.0]),
        ([[2.0, 1.0], [1.0, 2.0]], [-4.0, -5.0], [1.0, 2.0], [0.0, 0.0]),
        # Not symmetric, as with friction: the first pair's force lifts the second.
        ([[1.0, 0.0], [3.0, 1.0]], [-2.0, -1.0], [2.0, 0.0], [0.0, 5.0]),
        # A force that only another one calls for.
        ([[1.0, -2.0], [0.0, 1.0]], [1.0, -1.0], [1.0, 1.0], [0.0, 0.0]),
    ],
)
def test_by_hand(M, q, x, s, start):
    found = solve(np.array(M), np.array(q), start)
    assert np.allclose(found, (x, s), rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("start", [False, True])
def test_where_exchanging_all_turns_in_circles(start):
    """Murty's matrix: exchanging one sign after the other takes 2^n steps, all at once cycles."""
    n = 6
    M = np.tril(np.full((n, n), 2.0), -1) + np.eye(n)
    x, s = solve(M, np.full(n, -1.0), start)
    assert np.allclose(x, np.eye(n)[0]) and np.allclose(s, [0.0, *[1.0] * (n - 1)])


@pytest.mark.parametrize("symmetric", [True, False])
def test_against_all_sets(symmetric):
    """There is one solution where all principal minors are positive, and it is found."""
    rng = np.random.default_rng(2003)
    for _ in range(60):
        n = int(rng.integers(1, 7))
        A = rng.standard_normal((n, n))
        M = A @ A.T + 0.1 * np.eye(n)
        if not symmetric:
            A = rng.standard_normal((n, n))
            M += A - A.T
        q = rng.standard_normal(n)
        known = list(all_solutions(M, q))
        assert len(known) == 1
        x, s = solve(M, q, start=bool(rng.random() < 0.5))
        assert np.allclose(x, known[0], rtol=0.0, atol=1e-10 * max(1.0, np.abs(known[0]).max()))
        assert s.min() >= -1e-10 * max(1.0, np.abs(M @ x).max())


@pytest.mark.parametrize("unit", [1e-12, 1e9])
def test_units(unit):
    M, q = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-4.0, 1.0])
    for scaled in ((unit * M, q), (M, unit * q), (unit * M, unit * q)):
        assert complementarity(*scaled, np.array([False, True])).tolist() == [True, False]
