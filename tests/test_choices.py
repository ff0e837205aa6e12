"""What users choose from, laws and obstacles: wrong values are refused; and the choice of contact,
held against trying all sets."""

import itertools
import re

import numpy as np
import pytest

import dolfinx_llm as llm
from dolfinx_llm.laws.complementarity import _descent, _lemke, complementarity

pytestmark = pytest.mark.quick

WRONG = [
    (lambda: llm.Coulomb(-0.1), "mu=-0.1"),
    (lambda: llm.Coulomb(np.nan), "mu=nan"),
    (lambda: llm.Coulomb("0.3"), "mu='0.3'"),
    (lambda: llm.Coulomb(0.3, method="bisection"), "method='bisection'"),
    (lambda: llm.RigidPlane((0.0,), (0.0, 1.0)), "point=(0.0,): give 2 or 3 numbers"),
    (lambda: llm.RigidPlane("no", (0.0, 1.0)), "point='no': give"),
    (lambda: llm.RigidPlane((0.0, np.inf), (0.0, 1.0)), "must be finite"),
    (lambda: llm.RigidPlane((0.0, 0.0), (0.0, 0.0, 1.0)), "give 2 numbers"),
    (lambda: llm.RigidPlane((0.0, 0.0), (0.0, 0.0)), "has no direction"),
    (lambda: llm.RigidSphere((0.0, 0.0), 0.0), "radius=0.0"),
    (lambda: llm.RigidSphere((0.0, 0.0), (1.0, 2.0)), "radius=(1.0, 2.0)"),
    (lambda: llm.RigidCylinder((0.0, 0.0), (0.0, 0.0, 1.0), 1.0), "give 3 numbers"),
    (lambda: llm.RigidSurface("ramp.stl"), "mesh='ramp.stl'"),
    (lambda: llm.RigidPlane((0, 0), (0, 1), displacement=(1, 2, 3)).motion(2), "displacement="),
    (lambda: llm.RigidSphere((0, 0), 2.0).clearance(np.zeros((1, 2))), "1 surface node(s) lie at"),
    (lambda: llm.Interface(None, 3), "sides=3"),
    (lambda: llm.Interface(None, (3, 7), law="tied"), "law='tied'"),
    (lambda: llm.Interface(None, (3, 7), design="best"), "design='best'"),
    (lambda: llm.Interface(None, (3, 7), frame="coarse"), "frame='coarse'"),
]


@pytest.mark.parametrize("make, words", WRONG, ids=[words for _, words in WRONG])
def test_wrong_values_are_refused(make, words):
    with pytest.raises(llm.ContactInputError, match=re.escape(words)):
        make()


def test_two_obstacles_or_an_obstacle_with_a_frame_are_refused():
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    frame = llm.Frame([[0.0, 0.0], [1.0, 0.0]], [[0, 1]])
    with pytest.raises(llm.ContactInputError, match="one must be a body"):
        llm.Interface(None, (plane, plane))
    with pytest.raises(llm.ContactInputError, match="leave frame=None"):
        llm.Interface(None, (3, plane), frame=frame)


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
