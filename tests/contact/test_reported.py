"""What is reported means what it says: gap, status, slip, pressure, and the frame's forces."""

import itertools
import pickle

import contact_scenes
import curved_scenes as curved
import numpy as np
import pairs
import pytest
from contact_scenes import violations
from law_scenes import Lifted
from mpi4py import MPI
from sampling import some_of
from test_contact import down, pressed

import dolfinx_llm as llm
from dolfinx_llm.laws.rows import CLOSED, OPEN, SLIP, STICK

LAWS = [llm.Frictionless(), llm.Coulomb(0.3)]


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_gap_is_between_the_bodies(law):
    """A block pressed and turned lifts off at one end: the gap there is what the positions of both
    bodies say, wherever the frame lies in it."""
    scene = pressed(law)
    scene.move(down(0.01, turn=0.03))
    sides = scene.problem.results[0].sides
    opened = 0
    for k, side in enumerate(sides):
        other = sides[1 - k]
        order = np.argsort(other.x[:, 0])
        y = np.interp(side.x[:, 0], other.x[order, 0], (other.x + other.u)[order, 1])
        expected = (y - (side.x + side.u)[:, 1]) * side.normal[:, 1]
        apart = side.status == OPEN
        opened += apart.sum()
        np.testing.assert_allclose(side.gap[apart], expected[apart], atol=1e-12)
        assert not side.gap[~apart].any() and not side.slip[apart].any()
        assert not side.normal_force[apart].any() and (expected[apart] > 0.0).all()
        known = {OPEN, STICK, SLIP} if law.slips else {OPEN, CLOSED}
        assert set(side.status) <= known
    assert opened > 2 and sum((side.status != OPEN).sum() for side in sides) > 2


@pytest.mark.parametrize("law", [*LAWS, llm.Tied()], ids=str)
def test_frame_is_between_the_bodies(law):
    """It is where the law has it as long as it bears, in the middle of what opens; beyond the rim
    of one body with the other."""
    scene = pressed(law)
    scene.move(down(0.01, drag=0.002))
    (result,) = scene.problem.results
    assert (result.deformed == result.frame.x + result.frame.v).all()
    if not law.opens:
        return
    scene.move(down(-0.05))
    (result,) = scene.problem.results
    assert (result.frame_status == OPEN).all()
    narrow, wide = sorted(result.sides, key=lambda side: np.ptp(side.x[:, 0]))
    beyond = np.abs(result.x[:, 0]) > np.abs(narrow.x[:, 0]).max()
    assert 2 <= beyond.sum() < len(beyond)
    for scale, told in ((1.0, result.deformed), (10.0, result.moved(10.0))):
        one, other = ((side.x + scale * side.u)[:, 1].mean() for side in (narrow, wide))
        expected = np.where(beyond, other, 0.5 * (one + other))
        assert abs(one - other) > 0.049 * scale
        assert np.abs(told[:, 1] - expected).max() <= 1e-7 * scale
        assert np.abs(told[:, 0] - result.x[:, 0]).max() <= 1e-7 * scale


@pytest.mark.parametrize("seed", some_of((303, 307, 551), (551,)))
def test_pressure_where_all_presses(seed):
    scene, motions = contact_scenes.random_pressed(MPI.COMM_SELF, seed)
    for motion in motions:
        scene.move(motion)
        result = scene.problem.results[0]
        assert (result.pressure >= 0.0).all()
        closed = result.frame_status != OPEN
        assert (result.frame_force[closed] > 0.0).all()


def test_rigid_obstacle_has_no_slip_without_friction():
    scene = Lifted(MPI.COMM_SELF, 2, "rigid smooth")
    scene.move(0.08, 0.01)
    side = scene.problem.results[0].sides[0]
    assert set(side.status) <= {OPEN, CLOSED} and (side.status == CLOSED).any()
    assert np.abs(side.gap - side.frame_gap).max() < 1e-12


@pytest.mark.parametrize(
    ("mu", "counts", "swap"),
    some_of(
        list(itertools.product((0.05, 0.3), ((20, 30), (30, 20)), (False, True))),
        [(0.05, (20, 30), False), (0.3, (30, 20), True)],
    ),
)  # fmt: skip
def test_belt_round_a_drum(mu, counts, swap):
    """Pulled evenly, then dragged over the drum: the law holds at every node that is reported, both
    sides exert the same there, and no slip is larger than the bodies' motions."""
    problem, pull = curved.drum(mu, counts, swap)
    for ends in ((0.02, 0.02), (0.06, -0.02)):
        result = pull(*ends)
        largest = max(np.abs(side.normal_force).max() for side in result.sides)
        N, T = result.frame_force, np.linalg.norm(result.frame_friction, axis=1)
        assert (T - mu * np.maximum(N, 0.0)).max() <= 1e-9 * largest
        side = result.sides[problem.geometries[0].law_side]
        slips, drags = side.status == SLIP, np.linalg.norm(side.tangential_force, axis=1)
        assert (drags - mu * side.normal_force).max() <= 1e-9 * largest
        assert np.abs(drags - mu * side.normal_force)[slips].max(initial=0.0) <= 1e-9 * largest
        way = np.sign(
            side.tangential_force[:, 0] * side.x[:, 1] - side.tangential_force[:, 1] * side.x[:, 0]
        )
        ways = (abs(problem.geometries[0].shares) > 0.0).T @ np.stack(
            [slips & (way > 0), slips & (way < 0), ~slips], 1
        )
        alike = (ways > 0).sum(axis=1) == 1  # all nodes about it slip one way
        at = (result.frame_status == SLIP) & alike
        assert np.abs(T - mu * N)[at].max(initial=0.0) <= 1e-9 * largest
        totals = [p.N.T @ s.force for p, s in zip(problem.geometries[0].pairs, result.sides)]
        assert np.abs(totals[0] + totals[1]).max() <= 1e-9 * largest
        motion = max(np.abs(side.u).max() for side in result.sides)
        assert max(np.abs(side.slip).max() for side in result.sides) <= 2.0 * motion
        assert violations(problem)["residual"] < 1e-9
    assert slips.sum() > 0.7 * len(slips)


def test_notebooks_and_pickle():
    """A problem shows itself in a notebook; results are kept by pickle."""
    scene = pressed(llm.Coulomb(0.3))
    scene.move(down(0.01))
    problem = scene.problem
    assert "<pre>ContactProblem: " in problem._repr_html_()
    assert problem.A is problem.K
    kept, result = pickle.loads(pickle.dumps(problem.results[0])), problem.results[0]
    assert (kept.pressure == result.pressure).all()
    assert (kept.sides[1].force == result.sides[1].force).all()


@pytest.mark.parametrize("law", [llm.Tied(), *LAWS], ids=str)
def test_pressure_at_an_edge(law):
    """An upper block that stands out over the lower one's edge covers next to nothing about a
    corner of the frame, where the edge's force is on it: over that area it was 20 times the rest.
    """
    low = pairs.block(MPI.COMM_SELF, (4, 3, 2), (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), "tetrahedron")
    high = (3, 5, 2), (0.2145, 0.0558, 1.0), (0.707, 1.1818, 2.0), "tetrahedron"
    high = pairs.block(MPI.COMM_SELF, *high)
    scene = contact_scenes.Pressed([low, high], law, lambda p: p[2] > 1.99, lambda p: p[2] < 0.01)
    scene.move(lambda p: np.outer([0.0, 0.0, -0.02], np.ones_like(p[0])))
    result = scene.problem.results[0]
    assert result.frame_area.min() < 0.01 * np.median(result.frame_area)
    assert 0.5 < (result.pressure / np.median(result.pressure)).min()
    assert (result.pressure / np.median(result.pressure)).max() < 2.5
    assert np.sum(result.pressure * result.frame_area) == pytest.approx(
        result.frame_force.sum(), rel=0.02
    )
