"""Frame nodes that hardly any pair holds, and who speaks for them."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from dolfinx_llm.base.sparse import picking
from dolfinx_llm.contact.speakers import HELD, asked, follow, speakers

pytestmark = pytest.mark.quick


def first(asks):
    """Who speaks for each node, or the first of those."""
    return np.asarray(speakers(asks).argmax(axis=1)).ravel()


def test_all_speak_for_themselves_where_meshes_match():
    N = csr_matrix(np.eye(5))
    assert first(asked([N, N])).tolist() == [0, 1, 2, 3, 4]


def test_a_node_must_be_held_from_both_sides():
    """Node 2 has a pair of its own on one side, and the end of a shape function on the other."""
    one = csr_matrix(np.eye(3))
    other = csr_matrix([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.8, 0.2]])
    assert first(asked([one, other])).tolist() == [0, 1, 1]
    assert first(asked([other, one])).tolist() == [0, 1, 1]


def test_rings_of_weak_nodes():
    """Node 3 is reached through node 2, whose own speaker is node 1."""
    weak = np.sqrt(0.5 * HELD)
    N = csr_matrix([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 1 - weak, weak, 0], [0, 0, 0.3, 0.1]])
    assert first(asked([N, N])).tolist() == [0, 1, 1, 1]


def test_every_piece_keeps_a_node():
    """A piece of contact of its own, however weakly held, and a node that nothing reaches."""
    N = csr_matrix([[1.0, 0, 0, 0], [0, 0.45, 0.5, 0]])
    assert first(asked([N, N])).tolist() == [0, 2, 2, 3]


def test_follow_turns_with_the_surface():
    """Slip goes on in the same direction in space, whatever the nodes' own tangents are; forces
    of all nodes add up in space."""
    rng = np.random.default_rng(3)
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    first = np.eye(3)[:2]
    tangents = np.stack([first, first @ turn, -first])
    alike = follow(picking(np.array([0, 0, 0]), 3), tangents)
    slip = (alike @ np.array([0.3, -0.7, 9.0, 9.0, 9.0, 9.0])).reshape(3, 2)
    np.testing.assert_allclose(np.einsum("ka,kai->ki", slip, tangents), 3 * [[0.3, -0.7, 0.0]])
    forces = rng.standard_normal((3, 2))
    total = (alike.T @ forces.ravel()).reshape(3, 2)
    assert not total[1:].any()
    expected = np.einsum("ka,kai->i", forces, tangents)
    assert total[0] @ first == pytest.approx(expected)


def test_a_quarter_of_a_tube_apart():
    """Slip around a tube goes on around it, and that along its axis along it, from neighbour to
    neighbour: seen from a quarter apart the former is none, and beyond that it would turn round."""
    n = 9  # from 0 to 180 degrees
    angle = np.linspace(0.0, np.pi, n)
    around = np.column_stack([-np.sin(angle), np.cos(angle), 0.0 * angle])
    along = np.tile([0.0, 0.0, 1.0], (n, 1))
    turned = np.arange(n)[:, None]  # tangents of their own at each node
    tangents = np.stack(
        [
            np.cos(turned) * around + np.sin(turned) * along,
            np.cos(turned) * along - np.sin(turned) * around,
        ],
        axis=1,
    )
    alike = follow(picking(np.maximum(np.arange(n) - 1, 0), n), tangents)
    slip = np.zeros((n, 2))
    slip[0] = 0.3, -0.7
    found = np.einsum("ka,kai->ki", (alike @ slip.ravel()).reshape(n, 2), tangents)
    np.testing.assert_allclose(found, 0.3 * around - 0.7 * along, atol=1e-14)


def test_neighbours_that_are_alike():
    """Both speak, in equal parts, whatever rounding makes of them."""
    N = csr_matrix([[1.0, 0.0, 0.0], [0.4, 0.2, 0.4 + 1e-14], [0.0, 0.0, 1.0]])
    assert speakers(asked([N, N])).toarray().tolist() == [[1, 0, 0], [0.5, 0, 0.5], [0, 0, 1]]
    tangents = np.tile(np.eye(2)[:1], (3, 1, 1))
    assert (follow(asked([N, N]), tangents) @ [1.0, 9.0, 3.0]).tolist() == [1.0, 2.0, 3.0]
