"""Friction along curved surfaces: one side carries the frame, at each node of the other the law
holds, with a normal and a slip of its own."""

import curved_scenes as curved
import numpy as np
import pytest
import scenes
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm.laws.rows import OPEN, SLIP, STICK

MU = 0.3


def bracelet(counts, mu=MU, swap=False, frame=None, radii=((0.5, 1.0), (1.0, 1.1))):
    """A belt round the upper half of a drum; a function that pulls at its ends, and the problem."""
    V, tags = curved.rings(MPI.COMM_SELF, counts, radii, 180.0)
    a, L = scenes.forms(V)
    ends, far = [fem.Function(V) for _ in range(3)], radii[1][0]
    where = [
        lambda p: np.isclose(np.hypot(p[0], p[1]), radii[0][0]),
        lambda p: np.isclose(p[1], 0.0) & (p[0] > far + 1e-3),
        lambda p: np.isclose(p[1], 0.0) & (p[0] < -far - 1e-3),
    ]
    bcs = [
        fem.dirichletbc(f, fem.locate_dofs_geometrical(V, w))
        for f, w in zip(ends, where, strict=True)
    ]
    sides = (curved.FACE_0, curved.FACE_1)
    interface = llm.Interface(
        tags, sides[::-1] if swap else sides, law=llm.Coulomb(mu), frame=frame
    )
    problem = llm.ContactProblem(a, L, bcs=bcs, interfaces=[interface])

    def pull(right, left):
        for f, amount in zip(ends[1:], (right, left), strict=True):
            f.interpolate(lambda p, d=amount: np.array([0.0 * p[0], -d + 0.0 * p[0]]))
        problem.solve()
        return problem.results[0]

    return problem, pull


@pytest.mark.parametrize("counts", [((20, 3), (30, 2)), ((30, 3), (20, 2)), ((24, 3), (24, 2))])
def test_the_law_holds_at_every_node_of_the_side_that_moves(counts):
    problem, pull = bracelet(counts)
    before, closed = 0.0, True
    for ends in ((0.02, 0.02), (0.03, 0.01), (0.06, -0.02)):
        result = pull(*ends)
        geometry = problem.geometries[0]
        side = result.sides[geometry.law_side]
        assert len(side.x) == max(len(s.x) for s in result.sides)
        N, T = side.normal_force, side.tangential_force
        largest, drags = N.max(), np.linalg.norm(T, axis=1)
        for one in result.sides:
            assert one.normal_force.min() >= -1e-10 * largest
        assert (drags - MU * N).max() <= 1e-10 * largest
        slips, sticks = side.status == SLIP, side.status == STICK
        assert np.abs(drags - MU * N)[slips].max(initial=0.0) <= 1e-10 * largest
        assert (result.frame_force >= 0.0).all()
        friction = np.linalg.norm(result.frame_friction, axis=1)
        assert (friction - MU * result.frame_force).max() <= 1e-10 * largest
        moved = side.slip - before
        size = np.abs(side.u).max()
        assert np.abs(moved[sticks]).max(initial=0.0) <= 1e-10 * size
        # Forces are those on the frame: along the slip, as the frame resists.
        along = np.einsum("ni,ni->n", T, moved)[slips & closed]
        assert (along >= -1e-12 * largest * size).all()
        total = sum(s.force.sum(axis=0) for s in result.sides)
        assert np.abs(total).max() <= 1e-10 * largest
        before, closed = side.slip, side.status != OPEN
    assert slips.sum() > 0.7 * len(slips)
    problem.destroy()


def test_sides_slip_by_halves():
    """Each by half of the motion along each other, whichever carries the frame."""
    problem, pull = bracelet(((20, 3), (30, 2)))
    pull(0.02, 0.02)
    result = pull(0.06, -0.02)
    largest = [np.linalg.norm(side.slip, axis=1).max() for side in result.sides]
    assert 0.8 < largest[0] / largest[1] < 1.25
    problem.destroy()


def test_swapped():
    found = []
    for swap in (False, True):
        problem, pull = bracelet(((20, 3), (30, 2)), swap=swap)
        pull(0.02, 0.02)
        result = pull(0.05, 0.0)
        order = np.lexsort(result.x.round(9).T)
        sign = -1.0 if swap else 1.0
        found.append([result.pressure[order], sign * result.traction[order], problem.u.x.array])
        found[-1] += [side.slip for side in result.sides[:: -1 if swap else 1]]
        problem.destroy()
    for one, other in zip(*found, strict=True):
        assert np.abs(one - other).max() <= 1e-9 * np.abs(one).max()


def test_coefficients_at_the_frame_or_at_the_nodes():
    """An array has a value per node of ``result.x``, or per node at which the law holds."""
    problem, pull = bracelet(((20, 3), (30, 2)))
    geometry, expected = problem.geometries[0], pull(0.05, 0.0)
    counts = len(expected.x), len(geometry.law_nodes[0])
    assert counts == (21, 31)
    for n in counts:
        again, pull = bracelet(((20, 3), (30, 2)), mu=np.full(n, MU))
        assert np.abs(pull(0.05, 0.0).frame_friction - expected.frame_friction).max() < 1e-10 * (
            np.abs(expected.frame_force).max()
        )
        again.destroy()
    with pytest.raises(llm.ContactInputError, match="31"):
        bracelet(((20, 3), (30, 2)), mu=np.full(25, MU))[1](0.05, 0.0)
    problem.destroy()


def half_circle(n):
    t = np.radians(np.linspace(0.0, 180.0, n + 1))
    return llm.Frame(
        np.column_stack([np.cos(t), np.sin(t)]), np.column_stack([np.arange(n), np.arange(n) + 1])
    )


def test_given_frames():
    """One that is coarser than both serves; one that the carrier alone does not hold is refused."""
    problem, pull = bracelet(((20, 3), (30, 2)), frame=half_circle(14))
    result = pull(0.05, 0.0)
    assert len(result.x) == 15
    largest = max(side.normal_force.max() for side in result.sides)
    known = bracelet(((20, 3), (30, 2)))[1](0.05, 0.0)
    assert np.abs(result.resultant - known.resultant).max() <= 0.05 * np.abs(known.resultant).max()
    assert min(side.normal_force.min() for side in result.sides) >= -1e-10 * largest
    problem.destroy()
    with pytest.raises(llm.ContactError, match="carries the frame"):
        bracelet(((20, 3), (30, 2)), frame=half_circle(26))
