"""Interfaces where their bodies have moved to: relocated, rebuilt, and what is carried over."""

from types import SimpleNamespace

import numpy as np
import pytest
from moved_scenes import at_rest, curved, flat, geometry_of, obstacle

import dolfinx_llm as llm
from dolfinx_llm.interface.shared import check_once
from dolfinx_llm.interface.update import rebuilt, relocated, transfer
from dolfinx_llm.operators.assemble import interface_operator

LAWS = [llm.Tied(), llm.Frictionless(), llm.Coulomb(0.3)]


SCENES = [flat, curved, obstacle]


def rigid(gdim, seed=9):
    """Rotation and shift."""
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.standard_normal((gdim, gdim)))[0]
    Q[0] *= np.sign(np.linalg.det(Q))
    return Q, rng.uniform(-3.0, 3.0, gdim)


def motions(geometry, Q, shift):
    """Per side displacement of the tagged surface; that of the frame."""
    sides = [side.X @ Q.T + shift - side.X for side in geometry.site.whole]
    v = None if geometry.frame is None else geometry.frame.x @ Q.T + shift - geometry.frame.x
    return sides, v


def same(geometry, other):
    for p, q in zip(geometry.pairs, other.pairs, strict=True):
        assert (p.nodes == q.nodes).all() and (p.dofs == q.dofs).all()
        for name in ("forces", "normal", "base", "gap"):
            assert (getattr(p, name) == getattr(q, name)).all(), name
        assert p.N.shape == q.N.shape and (p.N != q.N).nnz == 0
    assert (geometry.directions == other.directions).all()


@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize("scene", SCENES)
def test_nothing_moved_gives_the_same_to_the_last_bit(scene, law):
    geometry = geometry_of(scene, law)
    same(geometry, relocated(geometry, *at_rest(geometry)))
    new, carried = rebuilt(geometry, *at_rest(geometry))
    same(geometry, new)
    for p, place in zip(geometry.pairs, carried.pairs, strict=True):
        assert (place == np.arange(len(p.nodes))).all()
    if geometry.frame is not None:
        assert abs(carried.frame - np.eye(len(geometry.frame.x))).max() < 1e-12


@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize("scene", SCENES[:2])
@pytest.mark.parametrize("how", ["relocated", "rebuilt"])
def test_a_rigid_motion_turns_the_operators_with_it(scene, law, how):
    """Motions V of the frame as rows of λ see them: L_b V, with V turned as the bodies are."""
    geometry = geometry_of(scene, law)
    gdim = geometry.frame.gdim
    Q, shift = rigid(gdim)
    moved = motions(geometry, Q, shift)
    new = relocated(geometry, *moved) if how == "relocated" else rebuilt(geometry, *moved)[0]
    for p, q in zip(geometry.pairs, new.pairs, strict=True):
        assert (p.nodes == q.nodes).all()
        np.testing.assert_allclose(q.forces, p.forces, atol=1e-12)
        np.testing.assert_allclose(q.N.toarray(), p.N.toarray(), atol=1e-10)
        np.testing.assert_allclose(q.normal, p.normal @ Q.T, atol=1e-11)
        np.testing.assert_allclose(q.gap, p.gap @ Q.T, atol=1e-11)
        # B and L_b by what spans the same: projectors on the base vectors.
        spans = [np.einsum("nci,ncj->nij", r.base, r.base) for r in (p, q)]
        np.testing.assert_allclose(spans[1], Q @ spans[0] @ Q.T, atol=1e-11)
    push = np.random.default_rng(3).standard_normal(geometry.frame.x.shape)
    felt = []
    for one, field in ((geometry, push), (new, push @ Q.T)):
        w = np.einsum("mdi,mi->md", one.directions, field).ravel()
        force = (interface_operator(one.pairs, one.directions) @ w).reshape(
            -1, len(one.pairs[0].base[0])
        )
        base = np.concatenate([p.base for p in one.pairs])
        felt.append(np.einsum("nc,nci->ni", force, base))
    np.testing.assert_allclose(felt[1], felt[0] @ Q.T, atol=1e-10)


def test_against_an_obstacle_the_clearance_is_that_of_now():
    geometry = geometry_of(obstacle, llm.Frictionless())
    up = [np.zeros_like(geometry.site.whole[0].x)]
    up[0][:, 2] = 0.25
    for new in (relocated(geometry, up), rebuilt(geometry, up)[0]):
        np.testing.assert_allclose(new.pairs[0].gap[:, 2], geometry.pairs[0].gap[:, 2] + 0.25)


@pytest.mark.parametrize("scene", [flat, curved])
def test_there_and_back(scene):
    """What was remembered returns: of pairs that stay exactly, of the frame as a linear field."""
    geometry = geometry_of(scene, llm.Coulomb(0.3))
    sides, _ = at_rest(geometry)
    slide = 0.03 * np.eye(geometry.frame.gdim)[0]
    sides[1] = sides[1] + slide  # side 1 slides over side 0
    new, there = rebuilt(geometry, sides, np.zeros_like(geometry.frame.x))
    back = transfer(new, geometry)
    value = np.arange(len(geometry.pairs[1].nodes))
    gone = np.where(there.pairs[1] >= 0, value[there.pairs[1]], -1)
    returned = np.where(back.pairs[1] >= 0, gone[back.pairs[1]], -1)
    assert ((returned == value) | (returned == -1)).all() and (returned >= 0).mean() > 0.8
    linear = geometry.frame.x @ np.arange(1.0, geometry.frame.gdim + 1.0)
    found = back.frame @ (there.frame @ linear)
    assert np.abs(found - linear).max() < 0.05 * np.ptp(linear)


def test_a_body_that_has_left_is_refused():
    geometry = geometry_of(flat, llm.Frictionless())
    sides, v = at_rest(geometry)
    sides[1] = sides[1] + [9.0, 0.0, 0.0]
    with pytest.raises(llm.ContactError):
        rebuilt(geometry, sides, v)
    with pytest.raises(llm.ContactError):
        relocated(geometry, sides, v)


def test_surfaces_that_several_interfaces_have():
    """A pair of surfaces is given once; two that meet each other may both meet a third one."""
    ties = [SimpleNamespace(name=name, obstacle=None) for name in ("a", "b")]
    a, b, c = (np.array([[k, k + 1], [k + 1, k + 2]]) for k in (0, 10, 20))
    check_once(ties, [[a, b], [np.concatenate([a, b]), c]])
    check_once(ties, [[a], [b]])
    for other in ([b, a], [a, b], [np.concatenate([c, b])[:, ::-1], a[:1]]):
        with pytest.raises(llm.ContactInputError, match="facets of both sides in common"):
            check_once(ties, [[a, b], other])
