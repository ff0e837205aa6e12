"""What an interface remembers, carried from one mesh to another and back."""

import numpy as np
import own_law
import pytest
from state_scenes import flat, geometry_of, obstacle

import dolfinx_llm as llm
from dolfinx_llm.contact.equations.state import ContactState
from dolfinx_llm.interface.update import remeshed

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
def test_on_the_same_mesh(scene, law):
    geometry, again = (geometry_of(scene, law) for _ in range(2))
    state = state_of(geometry, linear)
    found = state.carried(remeshed(geometry, again)[0], rest(again))
    for name in ("active", "closings", "status", "holds"):
        assert (getattr(found, name) == getattr(state, name)).all(), name
    assert_same(found, state, 1e-12)
    assert found.active is not state.active


@pytest.mark.parametrize("law", LAWS[1:], ids=lambda law: type(law).__name__)
def test_there_and_back(law):
    """Jumps and damage that are linear in position return at every node of the frame that lies in
    the other one."""
    geometry, other = (geometry_of(flat, law, n) for n in (4, 3))
    there, back = remeshed(geometry, other)[0], remeshed(other, geometry)[0]
    state = state_of(geometry, linear)
    found = state.carried(there, rest(other)).carried(back, rest(geometry))
    x = np.column_stack([np.ones(len(geometry.frame.x)), geometry.frame.x])
    inside = np.abs(back.nodes @ (there.nodes @ x) - x).max(axis=1) < 1e-12
    assert inside.mean() > 0.2
    fields = [(found.kappa_before, state.kappa_before)]
    fields += [(found.history[key], state.history[key]) for key in state.history]
    for now, then in fields:
        assert np.abs(now - then)[inside].max() <= 1e-11 * np.abs(then).max()
