"""A tilted bar touches a plate with a corner alone: what presses beyond that presses too early."""

import logging

import finite_patch
import pytest
from dolfinx import fem
from sampling import longer
from tilted_bar import TiltedBar

import dolfinx_llm as llm

pytestmark = pytest.mark.quick


@pytest.mark.parametrize("across, early", [(8, True), (20, False)])
@pytest.mark.parametrize("swapped", [False, longer(True)])
def test_a_corner_between_nodes(across, early, swapped, caplog):
    """Nothing presses before the bar has moved, but where its facets are the coarser ones and go on
    beyond the corner, into the plate: that is told, with how much too early it presses."""
    bar = TiltedBar(0.1, across)
    u = [fem.Function(V) for V in bar.spaces]
    forms = [finite_patch.residual(v, *finite_patch.lame(1000.0, 0.3)) for v in u]
    interface = llm.Interface(None, bar.sides[:: -1 if swapped else 1], law=llm.Frictionless())
    problem = llm.NonlinearContactProblem(forms, u, bcs=bar.bcs, interfaces=[interface])
    with caplog.at_level(logging.WARNING, "dolfinx_llm"):
        forces = bar.pressed(problem, (0.0, 0.02))
    assert (forces[0] > 0.1 * forces[1] > 0.0) == early
    assert [w for w in caplog.messages if "press beyond an edge of" in w] == caplog.messages
    assert len(caplog.messages) == early
