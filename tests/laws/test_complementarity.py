"""λ >= 0, s = M λ + q >= 0, λ s = 0: by hand values, and against all sets of positive λ."""

import itertools

import numpy as np
import pytest

from dolfinx_llm.laws.complementarity import _descend, _descent, _lemke, complementarity

pytestmark = pytest.mark.quick


def solve(M, q, start=False):
    """λ and s of the set that is found."""
    positive = complementarity(M, q, np.full(len(q), start))
    x = np.zeros(len(q))
    x[positive] = np.linalg.solve(M[np.ix_(positive, positive)], -q[positive])
    return x, M @ x + q


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


@pytest.mark.parametrize("unit", [1e-12, 1e9])
def test_units(unit):
    M, q = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-4.0, 1.0])
    for scaled in ((unit * M, q), (M, unit * q), (unit * M, unit * q)):
        assert complementarity(*scaled, np.array([False, True])).tolist() == [True, False]


def by_trial(M, q):
    """The one set of positive λ with λ >= 0 and s >= 0, by trying all."""
    found = []
    for choice in itertools.product([False, True], repeat=len(q)):
        on = np.array(choice)
        x = np.zeros(len(q))
        x[on] = np.linalg.solve(M[np.ix_(on, on)], -q[on])
        if (x >= 0.0).all() and ((M @ x + q)[~on] >= 0.0).all():
            found.append(on)
    assert len(found) == 1
    return found[0]


@pytest.mark.parametrize("seed", range(100, 120))
@pytest.mark.parametrize("symmetric", [True, False])
def test_complementarity(seed, symmetric):
    """Block exchange, and the two methods that stand behind it, from any start."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 9))
    A, B = rng.standard_normal((2, n, n))
    M = A @ A.T + 0.1 * np.eye(n)  # positive definite
    if not symmetric:
        M += 2.0 * (B - B.T)  # and still so: all principal minors are positive
    q, start = rng.standard_normal(n), rng.random(n) < 0.5
    expected = by_trial(M, q)
    np.testing.assert_array_equal(complementarity(M, q, start), expected)
    np.testing.assert_array_equal(_lemke(M, q), expected)
    if symmetric:
        np.testing.assert_array_equal(_descent(M, q, start), expected)


def test_lemke_without_solution():
    """λ = 0 gives s < 0, and no λ helps."""
    assert _lemke(np.array([[0.0]]), np.array([-1.0])) is None
    assert not _lemke(np.eye(2), np.array([1.0, 2.0])).any()


def test_descent_from_a_force_that_stays_zero():
    """A force that is 0 and is to stay 0 leaves at once; 0/0 told nothing, and descent hung."""
    M, q = np.eye(3), np.array([0.0, -1.0, 1.0])
    with np.errstate(all="raise"):  # 0/0 ends the test where it would not end
        x, positive = _descend(M, q, np.array([0.0, 0.5, 0.0]), np.ones(3, dtype=bool))
    assert positive.tolist() == [False, True, False] and x.tolist() == [0.0, 1.0, 0.0]
