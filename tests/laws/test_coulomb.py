"""Coulomb's law at single nodes: by hand values."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from dolfinx_llm.laws.coulomb import Coulomb, newton_rows, projection_miss, switch_rows
from dolfinx_llm.laws.rows import OPEN, SLIP, STICK, LawNodes

pytestmark = pytest.mark.quick

MU = 0.5
# T, N, δ that obey |T| <= μ N, with what they are; μ N is 5 where N is 10.
LAWFUL = {
    "stick": ([3.0, 0.0], 10.0, [0.0, 0.0], STICK),
    "slip": ([3.0, 4.0], 10.0, [0.6, 0.8], SLIP),
    "slip back": ([-5.0, 0.0], 10.0, [-2.0, 0.0], SLIP),
    "open": ([0.0, 0.0], 0.0, [1.0, -2.0], OPEN),
}


def node(T, N, delta):
    return np.array([T], dtype=float), np.array([N], dtype=float), np.array([delta], dtype=float)


def left(rows, T, N, delta):
    """C_T T + C_δ δ + C_N μ N - rhs."""
    own = np.einsum("nij,nj->ni", rows.C_T, T) + np.einsum("nij,nj->ni", rows.C_jump, delta)
    return own + rows.C_N * (MU * N)[:, None] - rows.rhs


@pytest.mark.parametrize("c", [1e-3, 1.0, 1e4])
@pytest.mark.parametrize("name", LAWFUL)
def test_what_obeys_the_law_solves_its_rows(name, c):
    *values, status = LAWFUL[name]
    T, N, delta = node(*values)
    c = np.array([c])
    assert projection_miss(T, MU * N, delta, c) <= 1e-14 * 10.0
    rows = newton_rows(T, MU * N, delta, c)
    assert rows.status.tolist() == [status]
    assert np.abs(left(rows, T, N, delta)).max() <= 1e-13 * max(10.0, *c * np.abs(delta).max())


@pytest.mark.parametrize(
    ("T", "N", "delta", "miss"),
    [
        ([6.0, 0.0], 10.0, [0.0, 0.0], 1.0),  # beyond the limit of 5 by 1
        ([3.0, 0.0], 10.0, [1.0, 0.0], 1.0),  # slips by 1 at c = 1: z = 4 is inside, T should be 4
        ([3.0, 4.0], 10.0, [-6.0, -8.0], 10.0),  # slips against its force
        ([1.0, 0.0], 0.0, [0.0, 0.0], 1.0),  # friction without normal force
        ([1.0, 0.0], -3.0, [0.0, 0.0], 1.0),
        ([0.0, 0.0], 1e12, [0.0, 0.0], 0.0),  # a large force, and nothing tangential
    ],
)
def test_miss(T, N, delta, miss):
    T, N, delta = node(T, N, delta)
    with np.errstate(all="raise"):
        newton_rows(T, MU * N, delta, np.ones(1))
    assert np.allclose(projection_miss(T, MU * N, delta, np.ones(1)), miss, atol=1e-14)


@pytest.mark.parametrize("pull", [[2.0, 1.0], [30.0, 0.0], [-6.0, 8.0], [0.0, -5.1]])
def test_newton_drags_a_spring(pull):
    """A node on a spring of stiffness 4: T = pull - 4 δ. It sticks up to |pull| = 5; beyond, T has
    the direction of the pull and length 5, and δ is what is left over 4."""
    pull, k, N = np.array([pull]), 4.0, np.array([10.0])
    T, delta, c = pull.copy(), np.zeros((1, 2)), np.array([3.0])
    for _ in range(30):
        rows = newton_rows(T, MU * N, delta, c)
        A = rows.C_jump[0] - k * rows.C_T[0]
        delta = np.linalg.solve(A, rows.rhs[0] - rows.C_T[0] @ pull[0] - rows.C_N[0] * MU * N)[None]
        T = pull - k * delta
    length = np.linalg.norm(pull)
    known = pull * min(1.0, 5.0 / length)
    assert np.allclose(T, known, rtol=0.0, atol=1e-12)
    assert np.allclose(delta, (pull - known) / k, rtol=0.0, atol=1e-12)


def test_with_little_trust_what_turns_round_sticks_first():
    """A slip against the force, 10 times what would turn that round; along it nothing changes."""
    T, s, delta = np.array([[1.0], [1.0]]), np.ones(2), np.array([[-10.0], [10.0]])
    trusted, wary = (newton_rows(T, s, delta, np.ones(2), SLIP, trust) for trust in (1e3, 1.5))
    assert trusted.status.tolist() == [SLIP, SLIP]
    assert wary.status.tolist() == [STICK, SLIP]
    assert np.allclose(wary.C_jump[0], 1.0)  # sticks as firmly as ever


def test_switch():
    """Stick to slip by the force (16), slip to stick where the slip turns against it (17)."""
    T = np.array([[4.0], [6.0], [5.0], [5.0], [1.0]])
    delta = np.array([[0.0], [0.0], [2.0], [-2.0], [0.0]])
    N = np.array([10.0, 10.0, 10.0, 10.0, -1.0])
    before = np.array([STICK, STICK, SLIP, SLIP, STICK])
    rows = switch_rows(T, MU * N, delta, np.ones(5), before)
    assert rows.status.tolist() == [STICK, SLIP, SLIP, STICK, OPEN]
    # Slip: T = μ N in the direction of the force, or of the slip.
    assert rows.C_T[1:3].ravel().tolist() == [1.0, 1.0]
    assert rows.C_N[1:3].ravel().tolist() == [-1.0, -1.0]
    assert not rows.C_jump[1:3].any() and not rows.rhs.any()


def test_those_that_others_speak_for():
    """Their slip against the speaker's vanishes; they take its status."""
    T, N = np.array([[1.0], [6.0], [0.0]]), np.array([10.0, 10.0, 10.0])
    rows = newton_rows(T, MU * N, np.zeros((3, 1)), np.ones(3))
    told = rows.tied(np.array([0, 1, 1]), np.zeros(3, dtype=bool), c=7.0)
    assert told.status.tolist() == [STICK, SLIP, SLIP]
    assert np.array_equal(told.C_T[:2], rows.C_T[:2])
    assert told.C_jump[2].tolist() == [[7.0]]
    assert not told.C_T[2].any() and not told.C_N[2].any() and not told.rhs[2].any()


def test_a_node_that_is_pulled_at_takes_from_its_speaker():
    """Forces of two nodes at the limit of both in sum, mu N: the law is met, and its rows. What
    they bear is shared out among those that are pressed."""
    one, none = np.ones(2), np.zeros((2, 1))
    nodes = LawNodes(
        np.zeros((2, 2)), one, force=np.array([[4.5], [0.0]]), N=np.array([10.0, -1.0]),
        jump=none + 1.0, before=none, c=one, status=np.full(2, SLIP),
        history={"slides": 0.0 * one}, shared=csr_matrix([[1.0, 1.0], [0.0, 0.0]]),
        given={"mu": MU * one, "dynamic": MU * one, "cohesive": 0.0 * one},
    )  # fmt: skip
    law = Coulomb(MU)
    assert law.miss(nodes)[0] <= 1e-15
    assert np.abs(law.rows(nodes).left(nodes)[0]).max() <= 1e-15
    assert law.strength(nodes).tolist() == [5.0, -0.5]


def test_rounding_does_not_choose_at_the_limit():
    """A load step begins with |T| = mu N and no slip where the last one ended in slip."""
    n = 100
    T = np.stack([np.cos(np.arange(n)), np.sin(np.arange(n))], axis=1)
    T *= 1.0 + np.spacing(1.0) * np.random.default_rng(1).integers(-4, 5, n)[:, None]
    for before in STICK, SLIP:
        rows = newton_rows(T, np.ones(n), np.zeros((n, 2)), np.ones(n), np.full(n, before))
        assert (rows.status == before).all()
