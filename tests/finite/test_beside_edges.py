"""A tilted bar touches a plate with a corner alone: what presses beyond that presses too early."""

import logging

import finite_patch
import numpy as np
import pytest
from contact_scenes import ABOVE, BELOW, rectangle
from dolfinx import fem
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

pytestmark = pytest.mark.quick
TILT = 0.1  # [rad]


def tilted(x):
    """About the corner at (0, 0), on which a bar to its left comes to stand."""
    c, s = np.cos(TILT), np.sin(TILT)
    return np.column_stack([c * x[:, 0] + s * x[:, 1], c * x[:, 1] - s * x[:, 0]])


@pytest.mark.parametrize("across, early", [(8, True), (20, False)])
@pytest.mark.parametrize("swapped", [False, longer(True)])
def test_a_corner_between_nodes(across, early, swapped, caplog):
    """Nothing presses before the bar has moved, but where its facets are the coarser ones and go on
    beyond the corner, into the plate: that is told, with how much too early it presses."""
    comm = MPI.COMM_SELF
    bar = rectangle(comm, (across, 2), (-2.0, 0.0), (0.0, 0.5), "quadrilateral", move=tilted)
    plate = rectangle(comm, (25, 5), (-2.9, -1.0), (2.1, 0.0), "quadrilateral")
    spaces = [compat.function_space(d, shape=(2,)) for d, _ in (bar, plate)]
    u, ends = ([fem.Function(V) for V in spaces] for _ in range(2))
    c, s = np.cos(TILT), np.sin(TILT)
    held = (
        (lambda x: np.isclose(s * x[0] + c * x[1], 0.5)),
        (lambda x: np.isclose(x[1], -1.0)),
    )
    bcs = [
        fem.dirichletbc(end, fem.locate_dofs_geometrical(V, where))
        for V, end, where in zip(spaces, ends, held, strict=True)
    ]
    forms = [finite_patch.residual(v, *finite_patch.lame(1000.0, 0.3)) for v in u]
    sides = ((bar[1], BELOW), (plate[1], ABOVE))[:: -1 if swapped else 1]
    interface = llm.Interface(None, sides, law=llm.Frictionless())
    problem = llm.NonlinearContactProblem(forms, u, bcs=bcs, interfaces=[interface])
    forces = []
    with caplog.at_level(logging.WARNING, "dolfinx_llm"):
        for down in (0.0, 0.02):
            ends[0].x.array[1::2] = -down
            problem.solve()
            forces.append(abs(problem.results[0].resultant[1]))
    assert (forces[0] > 0.1 * forces[1] > 0.0) == early
    assert [w for w in caplog.messages if "press beyond an edge of" in w] == caplog.messages
    assert len(caplog.messages) == early
