"""Where several interfaces of different laws stand in the vectors of all."""

import operator
from dataclasses import replace

import numpy as np
import pytest
import scenes
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.operators.numbering import frame_numbering, places

pytestmark = pytest.mark.quick


@pytest.fixture(scope="module")
def problem():
    """Four blocks on each other and on an obstacle: a tie, friction, none, friction."""
    sections = [scenes.grid(n, n, jitter=0.2, seed=3 + n) for n in (2, 3, 2, 3)]
    domain, tags = scenes.stacked(MPI.COMM_WORLD, sections, range(5), layers=(1, 1, 1, 1))
    V = compat.function_space(domain, shape=(3,))
    a, L = scenes.forms(V)
    laws = [llm.Tied(), llm.Coulomb(0.3), llm.Frictionless()]
    interfaces = [
        llm.Interface(tags, (2 * k + 2, 2 * k + 3), law=law) for k, law in enumerate(laws)
    ]
    obstacle = llm.RigidPlane((0.0, 0.0, 4.0), (0.0, 0.0, -1.0))
    interfaces.append(llm.Interface(tags, (8, obstacle), law=llm.Coulomb(0.2)))
    bcs = scenes.hold(V, scenes.SYMMETRY)
    return llm.ContactProblem(a, L, bcs=bcs, interfaces=interfaces)


def test_slices_tile_every_vector(problem):
    """Each vector is covered once, in the interfaces' order; v of all, then κ of all."""
    operators, found = problem.operators, places(problem.geometries)
    sizes = {
        "sides": len(operators.pairs),
        "pairs": sum(len(side.nodes) for side in operators.pairs),
        "rows": operators.L_b.getSize()[0],
        "frame": operators.L_b.getSize()[1],
    }
    for name, size in sizes.items():
        slices = [getattr(place, name) for place in found]
        assert np.array_equal(np.concatenate([np.r_[s] for s in slices]), np.arange(size)), name
    slips = np.concatenate([np.r_[place.slips] for place in found])
    n_v, n_w = sizes["frame"], operators.unknowns.sizes[1]
    assert np.array_equal(slips, np.arange(n_v, n_w))
    # Two tangents at the frame's nodes, at the pairs against an obstacle, none without friction.
    friction, obstacle = (
        len(problem.geometries[1].frame.x),
        len(problem.geometries[3].pairs[0].nodes),
    )
    counts = [place.slips.stop - place.slips.start for place in found]
    assert counts == [0, 2 * friction, 0, 2 * obstacle]


def test_places_belong_to_their_interface(problem):
    operators = problem.operators
    for geometry, place, L in zip(
        problem.geometries, operators.places, operators.blocks, strict=True
    ):
        assert all(map(operator.is_, operators.pairs[place.sides], geometry.pairs))
        base = np.concatenate([side.base.reshape(-1, 3) for side in geometry.pairs])
        assert np.array_equal(operators.rows.base[place.rows], base)
        other = np.delete(np.arange(operators.L.shape[1]), np.r_[place.frame])
        assert abs(operators.L[place.rows][:, other]).nnz == 0
        assert L.shape == (len(base), place.frame.stop - place.frame.start)


def test_frames_between_two_ranks(problem):
    """Where bodies are on different ranks each takes half of the frame's nodes, in one piece: one
    had all of them, and their work."""
    geometry = problem.geometries[1]
    ranks = [
        replace(side, surface=replace(side.surface, owner=0 * side.surface.owner + rank))
        for rank, side in enumerate(geometry.pairs)
    ]
    found = frame_numbering([replace(geometry, pairs=tuple(ranks))], MPI.COMM_SELF)
    d, x = geometry.directions.shape[1], geometry.places
    owner = found.owner.reshape(-1, d)
    assert (owner == owner[:, :1]).all()
    share = [x[owner[:, 0] == rank] for rank in (0, 1)]
    assert abs(len(share[0]) - len(share[1])) <= 1
    assert any(share[0][:, k].max() <= share[1][:, k].min() for k in range(3))
    alone = frame_numbering([replace(geometry, pairs=(ranks[1], ranks[1]))], MPI.COMM_SELF)
    assert (alone.owner == 1).all()
