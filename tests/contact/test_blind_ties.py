"""Ties that pass no friction, as the frame follows each body where that slides."""

import numpy as np
import pytest
import scenes
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm.contact.search.blind import blind_share, require_sight

pytestmark = pytest.mark.quick


def dragged():
    """Problem of two blocks on meshes that do not match, pressed, and its interface's state."""
    V, tags = scenes.two_blocks(MPI.COMM_SELF)[:2]
    problem = scenes.block_problem(V, tags, law=llm.Coulomb(0.3))
    problem.solve()
    (state,) = problem.method.iteration.states
    return problem, state


def test_ties_of_one_side_alone():
    """With those of both friction passes in proportion to what presses; with those of one none
    does, and the state is refused, though its forces may meet the law."""
    problem, state = dragged()
    multiplier = problem.method.iteration.multiplier
    assert blind_share(state, multiplier) < 1e-5
    require_sight([state], multiplier)
    first = len(state.nodes.geometry.pairs[0].nodes)
    for pairs in (slice(None, first), slice(first, None)):
        state.own.ties = np.zeros(len(state.nodes.rows), dtype=bool)
        state.own.ties[pairs] = True
        state.touch(state.own.active)
        assert blind_share(state, multiplier) > 0.99
        with pytest.raises(llm.ContactError, match="no friction passes where"):
            require_sight([state], multiplier)


def test_few_ties_of_both_sides():
    """Fewer than the frame's nodes that they reach: it gives way to both."""
    problem, state = dragged()
    multiplier = problem.method.iteration.multiplier
    state.own.ties = np.concatenate(
        [_next_to(pairs.x, (0.5, 0.5, 1.0)) for pairs in state.nodes.geometry.pairs]
    )
    state.begin(adrift=0.0)
    assert blind_share(state, multiplier) > 0.5


def _next_to(x, place):
    """(n,) True for that of some nodes which is next to a place."""
    away = np.linalg.norm(x - place, axis=1)
    return away == away.min()
