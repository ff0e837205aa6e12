"""Exchanges of pairs in the linear model: block principal pivoting."""

import numpy as np
import pytest

from dolfinx_llm.finite.pairs.terms import Held
from dolfinx_llm.finite.settling import EXCHANGES, WAITS, Exchanges
from dolfinx_llm.laws.rows import CLOSED, OPEN

pytestmark = pytest.mark.quick

# All principal minors are positive. From the first pair on, with all wrong ones at once, it goes
# round in three sets of two for ever.
ROUND = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 2.0], [2.0, 0.0, 1.0]])


def solved(M, q, both=False, first=()):
    """Solves, force and gap = M force + q, both at least 0 and one of them 0, from ``first`` pairs
    on; ``both``: as two interfaces."""
    n, exchanges = len(q), Exchanges()
    parts = np.split(np.arange(n), [n // 2]) if both else [np.arange(n)]
    held = [Held(np.zeros(0), np.ones(len(p), dtype=bool), 0.0) for p in parts]
    status = [np.where(np.isin(p, first), CLOSED, OPEN) for p in parts]
    for k in range(EXCHANGES):
        on = np.flatnonzero(np.concatenate(status) != OPEN)
        force = np.zeros(n)
        force[on] = np.linalg.solve(M[np.ix_(on, on)], -q[on])
        gap = M @ force + q
        now = np.where(np.isin(np.arange(n), on), force > 0.0, gap < 0.0)
        found = exchanges.take([np.where(now[p], CLOSED, OPEN) for p in parts], status, held)
        if not found:
            return k, force, gap
        for i, values in found.items():
            status[i] = values
    return EXCHANGES, force, gap


@pytest.mark.parametrize("both", [False, True])
def test_what_all_at_once_does_not_find(both):
    """It is waited for, and a single exchange finds it."""
    k, force, gap = solved(ROUND, -np.ones(3), both, first=[0])
    assert WAITS < k < 12
    assert np.minimum(force, gap) == pytest.approx(0.0, abs=1e-14)
    assert force == pytest.approx(1.0 / 3.0)


def test_stiff_bodies_on_few_nodes():
    """12 pairs that three unknowns bear, next to singular."""
    rng, most = np.random.default_rng(3), 0
    for _ in range(50):
        B = rng.standard_normal((12, 3))
        k, force, gap = solved(B @ B.T + 1e-4 * np.eye(12), rng.standard_normal(12), both=True)
        assert np.abs(np.minimum(force, gap)).max() <= 1e-9 * max(1.0, np.abs(force).max())
        most = max(most, k)
    assert 6 < most < EXCHANGES


def test_pairs_that_come_again_with_fewer_wrong_ones():
    """With fewer wrong ones than before all change at once again: that goes on elsewhere from pairs
    of which one changed before. 8 of 1000 ended there."""
    rng = np.random.default_rng(10)
    for _ in range(1000):
        B = rng.standard_normal((10, 3))
        k, force, gap = solved(B @ B.T + 1e-4 * np.eye(10), rng.standard_normal(10))
        assert np.abs(np.minimum(force, gap)).max() <= 1e-9 * max(1.0, np.abs(force).max())
        assert k < EXCHANGES


def test_what_goes_round_for_ever():
    """Where single exchanges come to pairs that they have been at there is no solution to find."""
    M, k = np.array([[1.0, 2.0], [2.0, 1.0]]), 0
    k, *_ = solved(-M, -np.ones(2))
    assert WAITS < k < 20
