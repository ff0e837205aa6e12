"""A tilted bar touches a plate with a corner alone, which may lie between the plate's nodes."""

import logging

import finite_patch
import numpy as np
import pytest
from dolfinx import fem
from sampling import longer
from tilted_bar import TiltedBar

import dolfinx_llm as llm

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


@pytest.mark.parametrize(("tilt", "leans"), [(0.1, False), (0.3, True)])
def test_an_edge_that_leans(tilt, leans, caplog):
    """What the corner presses leans as the bar's own facet does, which is told where it is much."""
    bar = TiltedBar(tilt)
    with caplog.at_level(logging.WARNING, "dolfinx_llm"):
        _, problem = forces_of(bar, bar.sides, FREE, (0.02,))
    along, across = np.abs(problem.results[0].resultant)
    assert (along > 0.1 * across) == leans == len(caplog.messages)
    assert all("presses along the normals of its own facets" in told for told in caplog.messages)
