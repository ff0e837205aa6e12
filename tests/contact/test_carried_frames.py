"""Friction along curved surfaces: one side carries the frame, at each node of the other the law
holds, with a normal and a slip of its own."""

import curved_scenes as curved
import numpy as np
import pytest
import scenes
from dolfinx import fem
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.laws.rows import CLOSED, OPEN, SLIP, STICK

MU = 0.3


@pytest.mark.parametrize("counts", [longer((20, 30)), (30, 20), (24, 24)])
def test_the_law_holds_at_every_node_of_the_side_that_moves(counts):
    problem, pull = curved.drum(MU, counts)
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
    problem, pull = curved.drum(MU, (20, 30))
    pull(0.02, 0.02)
    result = pull(0.06, -0.02)
    largest = [np.linalg.norm(side.slip, axis=1).max() for side in result.sides]
    assert 0.8 < largest[0] / largest[1] < 1.25
    problem.destroy()


def test_swapped():
    found = []
    for swap in (False, True):
        problem, pull = curved.drum(MU, (20, 30), swap=swap)
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
    problem, pull = curved.drum(MU, (20, 30))
    geometry, expected = problem.geometries[0], pull(0.05, 0.0)
    counts = len(expected.x), len(geometry.law_nodes[0])
    assert counts == (21, 31)
    for n in counts:
        again, pull = curved.drum(np.full(n, MU), (20, 30))
        assert np.abs(pull(0.05, 0.0).frame_friction - expected.frame_friction).max() < 1e-10 * (
            np.abs(expected.frame_force).max()
        )
        again.destroy()
    with pytest.raises(llm.ContactInputError, match="31"):
        curved.drum(np.full(25, MU), (20, 30))[1](0.05, 0.0)
    problem.destroy()


def half_circle(n):
    t = np.radians(np.linspace(0.0, 180.0, n + 1))
    return llm.Frame(
        np.column_stack([np.cos(t), np.sin(t)]), np.column_stack([np.arange(n), np.arange(n) + 1])
    )


def test_given_frames():
    """One that is coarser than both serves; one that the carrier alone does not hold is refused."""
    problem, pull = curved.drum(MU, (20, 30), frame=half_circle(14))
    result = pull(0.05, 0.0)
    assert len(result.x) == 15
    largest = max(side.normal_force.max() for side in result.sides)
    known = curved.drum(MU, (20, 30))[1](0.05, 0.0)
    assert np.abs(result.resultant - known.resultant).max() <= 0.05 * np.abs(known.resultant).max()
    assert min(side.normal_force.min() for side in result.sides) >= -1e-10 * largest
    problem.destroy()
    with pytest.raises(llm.ContactError, match="carries the frame"):
        curved.drum(MU, (20, 30), frame=half_circle(26))


def pad(counts, spans):
    """A pad on a drum, sectors of so many cells over these degrees, and what moves it."""
    points, cells, ends, where = [], [], [0], []
    for k, (n, (first, last), radii) in enumerate(
        zip(counts, spans, ((0.5, 1.0), (1.0, 1.3)), strict=True)
    ):
        s, quads = scenes.grid(n, 2, (first, radii[0]), (last, radii[1]))
        t = np.radians(s[:, 0])
        points.append(s[:, 1:] * np.column_stack([np.cos(t), np.sin(t)]))
        cells.append(quads[:, [0, 1, 3, 2]] + ends[-1])
        ends.append(ends[-1] + len(s))
        where += [
            (tag, k, lambda p, r=r: np.isclose(np.hypot(p[0], p[1]), r))
            for tag, r in zip((2 * k + 1, 2 * k + 2), radii, strict=True)
        ]
    domain, tags = scenes.bodies_mesh(MPI.COMM_SELF, points, cells, "quadrilateral", ends, where)
    V = compat.function_space(domain, shape=(2,))
    held = [fem.Function(V), fem.Function(V)]
    bcs = [
        fem.dirichletbc(f, fem.locate_dofs_topological(V, 1, tags.find(tag)))
        for f, tag in zip(held, (1, 4), strict=True)
    ]
    a, L = scenes.forms(V)
    interface = llm.Interface(tags, (2, 3), law=llm.Coulomb(MU))
    problem = llm.ContactProblem(a, L, bcs=bcs, interfaces=[interface])

    def move(*way):
        held[1].x.array.reshape(-1, 2)[:] = way
        problem.solve()
        return problem.results[0]

    return problem, move


def test_what_is_told_of_a_pad_that_is_covered_in_part():
    """Nodes of the carrying side that bear friction stick or slip: rows beyond its end have large
    parts in the last one, which was told to be without friction. Lifted off it was said to have
    come nearer, "from inf as drawn"."""
    problem, move = pad((30, 6), ((20.0, 160.0), (50.0, 130.0)))
    assert problem.geometries[0].site.carrier == 1
    for way in ((0.0, -0.01), (0.01, -0.01)):
        result = move(*way)
        side = result.sides[1]
        assert (side.normal_force > 1e-6 * side.normal_force.max()).all()
        assert not (side.status == CLOSED).any() and not (result.frame_status == CLOSED).any()
    assert (move(0.0, 0.02).frame_status == OPEN).all()
    assert "nothing touches" not in str(problem)
    problem.destroy()
