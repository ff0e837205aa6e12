"""Frame nodes that hardly any pair holds, and who speaks for them."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from dolfinx_llm.contact.equations.speakers import HELD, asked, speakers

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


def test_neighbours_that_are_alike():
    """Both speak, in equal parts, whatever rounding makes of them."""
    N = csr_matrix([[1.0, 0.0, 0.0], [0.4, 0.2, 0.4 + 1e-14], [0.0, 0.0, 1.0]])
    assert speakers(asked([N, N])).toarray().tolist() == [[1, 0, 0], [0.5, 0, 0.5], [0, 0, 1]]
