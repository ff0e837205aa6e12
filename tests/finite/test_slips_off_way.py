"""Nodes that meet in an increment slip along their way in it, or the increment is halved."""

from dataclasses import replace

import numpy as np
import pytest
from dolfinx import fem
from test_far_slides import Block
from upright_blocks import FOOT, block

import dolfinx_llm as llm
from dolfinx_llm.finite import arrival
from dolfinx_llm.finite.failures import StepFailed

pytestmark = pytest.mark.quick


def on_a_base():
    """A block led down onto a softer one, and along, in one step."""
    scene = Block(1, "triangle", 4)
    scene.move(0.0, -0.01)
    return scene.problem, lambda: scene.move(0.15, 0.02)


def on_a_plane():
    """A plane that comes up to a block and goes along."""
    _, tags, V, u, F = block("quad")
    top = fem.locate_dofs_geometrical(V, lambda p: np.isclose(p[1], 1.0))
    plane = llm.RigidPlane((0.0, -0.01), (0.0, 1.0))
    interface = llm.Interface(tags, (FOOT, plane), law=llm.Coulomb(0.1))
    bcs = [fem.dirichletbc(np.zeros(2), top, V)]
    problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=[interface])
    problem.solve()

    def move():
        plane.displacement = np.array([0.15, 0.03])
        problem.solve()

    return problem, move


@pytest.mark.parametrize("scene", [on_a_base, on_a_plane])
def test_slips_off_the_way_are_refused(scene, monkeypatch):
    """A bent strip went 0.2 sideways, as slip counted from where an iterate had met; equilibrium
    was met, and friction by that."""
    seen = []
    check = arrival.check_slips
    monkeypatch.setattr(arrival, "check_slips", lambda *told: seen.append(told) or check(*told))
    _, move = scene()
    move()
    contact, held, now = seen[-1]
    place, origin, size = now.place, held.origin, contact.sides.mover.facet_size
    assert (origin.touched & (origin.gap > 0.0)).any()
    assert contact.off_way(place, held, now.status).max() <= 1e-3 * size
    # From a place that no node has gone through: beyond where they are.
    beyond = replace(origin, points=2.0 * contact.here(place) - origin.first)
    ways = [contact.way(place, one)[0] for one in (replace(origin, points=origin.first), beyond)]
    assert np.abs(ways[0] + ways[1]).max() <= 1e-9
    with pytest.raises(StepFailed, match="off the way that they go in it"):
        check(contact, replace(held, origin=beyond), now)
