"""Supports, rigid ends and means that have moved on before the first step."""

import numpy as np
import pytest
import ufl
from contact_scenes import ABOVE, BELOW, rectangle, stress
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat


def forces(led, starts, nonlinear=False):
    """Of the joint of two blocks, and on what leads them, in four steps."""
    bodies = [rectangle(MPI.COMM_SELF, (4, 4), (0, 0), (1, 1), "quadrilateral")]
    bodies += [rectangle(MPI.COMM_SELF, (3, 4), (0, 1), (1, 2), "quadrilateral")]
    spaces = [compat.function_space(domain, shape=(2,)) for domain, _ in bodies]
    (low, under), (high, over) = ((V, tags) for V, (_, tags) in zip(spaces, bodies, strict=True))
    moved, u = fem.Function(high), [fem.Function(V) for V in spaces]
    dofs = [fem.locate_dofs_geometrical(V, lambda p, z=z: np.isclose(p[1], z))
            for V, z in ((low, 0.0), (high, 2.0))]  # fmt: skip
    bcs = [fem.dirichletbc(fem.Function(low), dofs[0])]
    ends = {
        "end": llm.RigidPlane((0.0, 2.0), (0.0, -1.0)),
        "mean": llm.MeanDisplacement((0.0, 0.0)),
    }
    interfaces = [llm.Interface(None, ((under, ABOVE), (over, BELOW)), law=llm.Tied())]
    if led == "support":
        bcs.append(fem.dirichletbc(moved, dofs[1]))
    else:
        interfaces.append(llm.Interface(over, (ABOVE, ends[led]), law=llm.Tied()))
    trials = u if nonlinear else [ufl.TrialFunction(V) for V in spaces]
    tests = [ufl.TestFunction(V) for V in spaces]
    F = [ufl.inner(stress(a), ufl.grad(w)) * ufl.dx for a, w in zip(trials, tests, strict=True)]
    L = [ufl.inner(fem.Function(w.ufl_function_space()), w) * ufl.dx for w in tests]
    of = (F, u) if nonlinear else (F, L)
    stepper = llm.TimeStepper(1.0, *of, dt=0.1, bcs=bcs, interfaces=interfaces)
    if starts:
        stepper.start()
    found = []
    for k in range(1, 5):
        moved.x.array[1::2] = down = -1e-3 * k
        ends["end"].displacement, ends["mean"].mean = (0.0, down), (0.0, down)
        stepper.step()
        found.append([result.resultant for result in stepper.problem.results])
    assert ends["end"].displacement == (0.0, down)
    stepper.destroy()
    return np.array(found)


@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("led", ["support", "end", "mean"])
def test_moved_on_before_start(led, nonlinear):
    """Forces are those of a start at rest: ties had forces of 1e5 times as much, which changed
    sign from step to step."""
    known, found = (forces(led, starts, nonlinear) for starts in (True, False))
    assert np.abs(known).max() > 1e-7
    assert np.abs(found - known).max() < 1e-6 * np.abs(known).max()
