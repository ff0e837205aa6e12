"""What an interface remembers, carried from one geometry to the next and back."""

import numpy as np
import own_law
import pytest
from moved_scenes import at_rest, flat, geometry_of, obstacle

import dolfinx_llm as llm
from dolfinx_llm.contact.state import ContactState
from dolfinx_llm.interface.update import rebuilt, transfer

LAWS = [llm.Frictionless(), llm.Coulomb(0.3), own_law.Glue()]


def state_of(geometry, field):
    """Pairs by turns in contact; jumps and damage as a field of positions (k, gdim) -> (k,)."""
    n, (x, _) = sum(len(p.nodes) for p in geometry.pairs), geometry.law_nodes
    k, q = geometry.jump_directions.shape[:2]
    x, k = (x, k) if q else (x[:0], 0)
    vectors = field(x)[:, None] * np.arange(1.0, x.shape[1] + 1.0)
    directions = geometry.jump_directions[:k]
    return ContactState(
        active=np.arange(n) % 3 > 0,
        closings=np.arange(n),
        status=np.where(field(x) > np.median(field(x)) if k else x[:, 0] > 0, 1, 2),
        kappa_before=np.einsum("ki,kqi->kq", vectors, directions) if q else np.zeros((0, 1)),
        holds=np.arange(k) % 2 == 0,
        history={"damage": field(x), "both": np.column_stack([field(x), -field(x)])} if k else {},
    )


def rest(geometry):
    """A state at rest, in which all is in contact."""
    state = state_of(geometry, lambda x: 0.0 * x[:, 0])
    state.active[:], state.closings[:], state.status[:] = True, 0, 1
    return state


def assert_same(found, known, tolerance):
    size = max(np.abs(known.kappa_before).max(initial=0.0), 1e-300)
    assert np.abs(found.kappa_before - known.kappa_before).max(initial=0.0) <= tolerance * size
    assert found.history.keys() == known.history.keys()
    for name, value in known.history.items():
        assert np.abs(found.history[name] - value).max() <= tolerance * np.abs(value).max()


def linear(x):
    return 0.3 + x @ np.arange(1.0, x.shape[1] + 1.0)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
@pytest.mark.parametrize("scene", [flat, obstacle])
def test_nothing_moved(scene, law):
    geometry = geometry_of(scene, law)
    new, change = rebuilt(geometry, *at_rest(geometry))
    state = state_of(geometry, linear)
    found = state.carried(change, rest(new))
    for name in ("active", "closings", "status", "holds"):
        assert (getattr(found, name) == getattr(state, name)).all(), name
    assert_same(found, state, 1e-12)
    assert found.active is not state.active


@pytest.mark.parametrize("law", LAWS[1:], ids=lambda law: type(law).__name__)
@pytest.mark.parametrize("scene", [flat, obstacle])
def test_there_and_back(scene, law):
    """The upper body slides: what pairs and nodes that are still there have kept returns; jumps and
    damage that are linear in position return at every node of the frame that lies in the other."""
    geometry = geometry_of(scene, law)
    sides, v = at_rest(geometry)
    sides[-1] = sides[-1] + 0.03 * np.eye(sides[0].shape[1])[0]
    new, there = rebuilt(geometry, sides, v)
    back = transfer(new, geometry)
    state = state_of(geometry, linear)
    found = state.carried(there, rest(new)).carried(back, rest(geometry))
    kept = there.old_pairs[np.maximum(back.old_pairs, 0)] == np.arange(len(state.active))
    kept &= back.old_pairs >= 0
    assert kept.mean() > 0.7
    assert (found.active == state.active)[kept].all()
    assert (found.closings == state.closings)[kept].all()
    x, _ = geometry.law_nodes
    if geometry.frame is None:
        inside = kept
    else:
        passed = back.frame @ (there.frame @ np.column_stack([np.ones(len(x)), x]))
        inside = np.abs(passed - np.column_stack([np.ones(len(x)), x])).max(axis=1) < 1e-12
    assert inside.mean() > 0.2
    fields = [(found.kappa_before, state.kappa_before)]
    fields += [(found.history[key], state.history[key]) for key in state.history]
    for now, then in fields:
        assert np.abs(now - then)[inside].max() <= 1e-11 * np.abs(then).max()
