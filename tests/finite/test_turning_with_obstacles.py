"""Supports and obstacles that let bodies go, and turn alike: bodies turn with them."""

import numpy as np
import pytest
from dolfinx import fem
from scipy.spatial.transform import Rotation
from upright_blocks import FOOT, TOP, block

import dolfinx_llm as llm

TURN = np.pi / 2.0


@pytest.mark.parametrize("kind", ["quad", "tet"])
@pytest.mark.parametrize("law", [llm.Coulomb(0.4), llm.Frictionless()], ids=str)
@pytest.mark.parametrize("round_one", [False, True], ids=["plane", "sphere"])
def test_by_a_right_angle_at_once(kind, law, round_one):
    """A block that is pressed and dragged, then turned with its obstacle: nothing changes. The
    step was halved, supports went along the chord, and forces came out 0.2 to 0.6 off."""
    domain, tags, V, u, F = block(kind, 3)
    gdim = domain.geometry.dim
    up, low = np.eye(gdim)[-1], np.full(gdim, 0.5) * (1.0 - np.eye(gdim)[-1])
    obstacle = llm.RigidSphere(low - 3.0 * up, 3.0) if round_one else llm.RigidPlane(low, up)
    g, X = fem.Function(V), V.tabulate_dof_coordinates()[:, :gdim]
    dofs = fem.locate_dofs_topological(V, gdim - 1, tags.find(TOP))
    interface = llm.Interface(tags, (FOOT, obstacle), law=law)
    bcs = [fem.dirichletbc(g, dofs)]
    problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=[interface])
    R = Rotation.from_rotvec([0.0, 0.0, TURN] if gdim == 2 else [TURN, 0.0, 0.0]).as_matrix()
    R = R[:gdim, :gdim]
    for drag in (0.0, 0.02):
        g.x.array[:] = (-0.05 * up + drag * np.eye(gdim)[0] + 0.0 * X).ravel()
        problem.solve()
    before = problem.results[0].sides[0]
    g.x.array[:] = ((X - 0.05 * up + 0.02 * np.eye(gdim)[0]) @ R.T - X).ravel()
    obstacle.pivot = (0.0,) * gdim
    obstacle.rotation = TURN if gdim == 2 else (TURN, 0.0, 0.0)
    problem.solve()
    after = problem.results[0].sides[0]
    largest = np.abs(before.force).max()
    assert len(problem.history) == 1
    assert np.abs(after.x - before.x @ R.T).max() < 1e-10
    assert np.abs(after.force - before.force @ R.T).max() < 1e-9 * largest
    assert np.abs(after.slip).max() < 1e-10 and (after.status == before.status).all()


@pytest.mark.parametrize("kind", ["quad", "tet"])
def test_clamped_between_obstacles_alone(kind):
    """Friction between two planes that turn alike holds a block; forces came out 0.01 off."""
    _, tags, V, u, F = block(kind, 3)
    gdim = V.mesh.geometry.dim
    e, centre = np.eye(gdim), np.full(gdim, 0.5)
    low, high = (llm.RigidPlane(z * e[-1], s * e[-1]) for z, s in ((0.0, 1.0), (1.0, -1.0)))
    interfaces = [
        llm.Interface(tags, (side, plane), law=llm.Coulomb(0.4))
        for side, plane in ((FOOT, low), (TOP, high))
    ]
    problem = llm.NonlinearContactProblem(F, u, interfaces=interfaces)
    moved = -0.05 * e[-1]
    for drag in (0.0, 0.01):
        high.displacement = moved + drag * e[0]
        problem.solve()
    before = [result.sides[0] for result in problem.results]
    R = Rotation.from_rotvec([0.0, 0.0, TURN] if gdim == 2 else [TURN, 0.0, 0.0]).as_matrix()
    R = R[:gdim, :gdim]
    for plane in (low, high):
        plane.pivot = centre
        plane.rotation = TURN if gdim == 2 else (TURN, 0.0, 0.0)
    high.displacement = R @ (moved + 0.01 * e[0])
    problem.solve()
    assert len(problem.history) == 1
    for result, side in zip(problem.results, before, strict=True):
        (after,) = result.sides
        assert np.abs(after.force - side.force @ R.T).max() < 1e-9 * np.abs(side.force).max()
        assert np.abs(after.slip).max() < 1e-10
