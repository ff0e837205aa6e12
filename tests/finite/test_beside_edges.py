"""A tilted bar touches a plate with a corner alone, which may lie between the plate's nodes."""

import logging

import finite_patch
import numpy as np
import pytest
from contact_scenes import ABOVE, BELOW, rectangle
from dolfinx import fem
from mpi4py import MPI
from sampling import longer
from tilted_bar import TiltedBar

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.laws.rows import SLIP

pytestmark = pytest.mark.quick
FREE = llm.Frictionless()


def forces_of(bar, sides, law, motions):
    """Normal forces after motions of the bar's top."""
    u = [fem.Function(V) for V in bar.spaces]
    forms = [finite_patch.residual(v, *finite_patch.lame(1000.0, 0.3)) for v in u]
    interface = llm.Interface(None, sides, law=law)
    problem = llm.NonlinearContactProblem(forms, u, bcs=bar.bcs, interfaces=[interface])
    return bar.pressed(problem, motions), problem


@pytest.mark.parametrize("swapped", [False, longer(True)])
@pytest.mark.parametrize(("across", "degree"), [(8, 1), longer(20, 1), (4, 2)])
def test_a_corner_between_nodes(across, degree, swapped, caplog):
    """Nothing presses before the bar has moved, wherever its corner stands between the plate's
    nodes; then the corner does, which is as good as on the plate (5.5e-3 in it at nodes alone)."""
    bar = TiltedBar(0.1, across, degree)
    with caplog.at_level(logging.WARNING, "dolfinx_llm"):
        forces, problem = forces_of(bar, bar.sides[:: -1 if swapped else 1], FREE, (0.0, 0.02))
    assert forces[0] < 1e-9 < 1.0 < forces[1]
    assert not caplog.messages
    plate, own = problem.results[0].sides[:: 1 if swapped else -1]
    corner = own.x[np.hypot(*own.drawn.T).argmin()]
    order = np.argsort(plate.x[:, 0])
    under = np.interp(corner[0], plate.x[order, 0], plate.x[order, 1])
    assert abs(corner[1] - under) < 5e-4


@pytest.mark.parametrize(("gdim", "law"), [(3, FREE), (2, llm.Coulomb(0.3))])
def test_an_edge_between_nodes(gdim, law, caplog):
    """In space, or with friction, nodes beyond it meet what its facets go on to, which is told."""
    bar = TiltedBar(0.1, gdim=gdim)
    with caplog.at_level(logging.WARNING, "dolfinx_llm"):
        forces, _ = forces_of(bar, bar.sides, law, (0.0, 0.02))
    assert forces[0] > 0.1 * forces[1] > 0.0
    (told,) = caplog.messages
    assert "press beyond an edge of" in told


@pytest.mark.parametrize("degree", [1, longer(2)])
def test_a_block_dragged_past_nodes(degree):
    """Its coarser facets carry the frame, whose ends pass the plate's nodes: all slip by what the
    block goes, and friction is that of what presses."""
    block = rectangle(MPI.COMM_SELF, (4, 3), (-0.5, 0.0), (0.5, 0.8), "quadrilateral")
    plate = rectangle(MPI.COMM_SELF, (15, 3), (-1.1, -0.6), (1.2, 0.0), "quadrilateral")
    spaces = [compat.function_space(d, degree=degree, shape=(2,)) for d, _ in (block, plate)]
    ends, u = ([fem.Function(V) for V in spaces] for _ in range(2))
    held = (lambda x: np.isclose(x[1], 0.8)), (lambda x: np.isclose(x[1], -0.6))
    bcs = [
        fem.dirichletbc(end, fem.locate_dofs_geometrical(V, where))
        for V, end, where in zip(spaces, ends, held, strict=True)
    ]
    forms = [finite_patch.residual(v, *finite_patch.lame(young, 0.3), order=degree)
             for v, young in zip(u, (100.0, 300.0))]  # fmt: skip
    sides = (block[1], BELOW), (plate[1], ABOVE)
    interface = llm.Interface(None, sides, law=llm.Coulomb(0.3))
    problem = llm.NonlinearContactProblem(forms, u, bcs=bcs, interfaces=[interface])
    ends[0].x.array[1::2] = -0.04
    for step in range(7):
        ends[0].x.array[::2] = 0.05 * step
        problem.solve()
    one, other = problem.results[0].sides
    assert np.abs(one.force.sum(axis=0) + other.force.sum(axis=0)).max() < 1e-9
    pressed = other.status == SLIP
    assert pressed.sum() > 4
    slip, force = np.linalg.norm(other.slip[pressed], axis=1), other.force[pressed]
    assert np.abs(slip - 0.05).max() < 0.005
    borne = np.linalg.norm(force, axis=1) / np.sqrt(1.0 + 0.3**2)
    assert np.abs(borne - np.abs(other.normal_force[pressed])).max() < 1e-2 * borne.max()
