"""Frame nodes that hardly any pair holds, and who speaks for them."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from dolfinx_llm.contact.followers import HELD, follow, speakers

pytestmark = pytest.mark.quick


def test_all_speak_for_themselves_where_meshes_match():
    N = csr_matrix(np.eye(5))
    assert speakers([N, N]).tolist() == [0, 1, 2, 3, 4]


def test_a_node_must_be_held_from_both_sides():
    """Node 2 has a pair of its own on one side, and the end of a shape function on the other."""
    one = csr_matrix(np.eye(3))
    other = csr_matrix([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.8, 0.2]])
    assert speakers([one, other]).tolist() == [0, 1, 1]
    assert speakers([other, one]).tolist() == [0, 1, 1]


def test_rings_of_weak_nodes():
    """Node 3 is reached through node 2, whose own speaker is node 1."""
    weak = np.sqrt(0.5 * HELD)
    N = csr_matrix([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 1 - weak, weak, 0], [0, 0, 0.3, 0.1]])
    assert speakers([N, N]).tolist() == [0, 1, 1, 1]


def test_every_piece_keeps_a_node():
    """A piece of contact of its own, however weakly held, and a node that nothing reaches."""
    N = csr_matrix([[1.0, 0, 0, 0], [0, 0.45, 0.5, 0]])
    assert speakers([N, N]).tolist() == [0, 2, 2, 3]


def test_follow_turns_with_the_surface():
    """Slip goes on in the same direction in space, whatever the nodes' own tangents are; forces
    of all nodes add up in space."""
    rng = np.random.default_rng(3)
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    first = np.eye(3)[:2]
    tangents = np.stack([first, first @ turn, -first])
    alike = follow(np.array([0, 0, 0]), tangents)
    slip = (alike @ np.array([0.3, -0.7, 9.0, 9.0, 9.0, 9.0])).reshape(3, 2)
    np.testing.assert_allclose(np.einsum("ka,kai->ki", slip, tangents), 3 * [[0.3, -0.7, 0.0]])
    forces = rng.standard_normal((3, 2))
    total = (alike.T @ forces.ravel()).reshape(3, 2)
    assert not total[1:].any()
    expected = np.einsum("ka,kai->i", forces, tangents)
    assert total[0] @ first == pytest.approx(expected)
