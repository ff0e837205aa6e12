"""Nodal loads are those that stand in the user's list when a step is solved."""

import numpy as np
import pytest
import ufl
from contact_scenes import ABOVE, BELOW, rectangle
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

WIDTH, E = 2.0, 1000.0


class Block:
    """A block on a rigid plane, with a residual form or forms a and L; ``options`` as of the
    problem, which is ``kind``."""

    def __init__(self, kind, nodal, nonlinear=False, **options):
        self.mesh, self.tags = rectangle(MPI.COMM_SELF, (4, 6), (0, 0), (WIDTH, 1), "quadrilateral")
        self.V = V = compat.function_space(self.mesh, shape=(2,))
        u, w = fem.Function(V) if nonlinear else ufl.TrialFunction(V), ufl.TestFunction(V)
        forms = E * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * ufl.dx, u
        if not nonlinear:
            forms = forms[0], ufl.inner(fem.Constant(self.mesh, (0.0, 0.0)), w) * ufl.dx
        left = fem.locate_dofs_geometrical(
            (V.sub(0), V.sub(0).collapse()[0]), lambda p: p[0] < 1e-9
        )
        zero = fem.Function(V.sub(0).collapse()[0])
        self.plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
        interface = llm.Interface(self.tags, (BELOW, self.plane), law=llm.Frictionless())
        bcs = [fem.dirichletbc(zero, left, V.sub(0))]
        options = {"bcs": bcs, "interfaces": interface, "nodal_loads": nodal} | options
        args = (1.0, *forms) if kind is llm.TimeStepper else forms
        self.problem = kind(*args, **options)

    def load(self, pressure):
        return llm.free_surface_load(self.V, self.tags, ABOVE, pressure)


@pytest.mark.parametrize("kind", [llm.ContactProblem, llm.NonlinearContactProblem])
def test_loads_that_come_and_go(kind):
    """The plane bears what presses at the moment."""
    nodal = []
    block = Block(kind, nodal, nonlinear=kind is llm.NonlinearContactProblem)
    nodal.append(block.load(1.5))
    for change, pressure in (
        (lambda: None, 1.5), (lambda: nodal.append(block.load(2.0)), 3.5), (nodal.pop, 1.5)
    ):  # fmt: skip
        change()
        block.problem.solve()
        result = block.problem.results[0]
        assert abs(result.resultant[1]) == pytest.approx(WIDTH * pressure, rel=1e-9)
    nodal.append("a load")
    with pytest.raises(llm.ContactInputError, match="nodal_loads: item='a load'"):
        block.problem.solve()


@pytest.mark.parametrize("nonlinear", [False, True])
def test_loads_of_steps_in_time(nonlinear):
    """A load that comes after a step moves the block as one that was there with no force."""
    found = []
    for late in (True, False):
        nodal = []
        block = Block(llm.TimeStepper, nodal, nonlinear, dt=1e-3)
        extra, weight = block.load(4.0), block.load(1.0)
        forces = extra.x.array.copy()
        nodal += [weight] if late else [weight, extra]
        extra.x.array[:] = 0.0
        block.problem.step()
        extra.x.array[:] = forces
        nodal[:] = [weight, extra]
        block.problem.step()
        found.append(block.problem.u.x.array.copy())
    np.testing.assert_allclose(*found, rtol=0.0, atol=1e-14)
    assert np.abs(found[0]).max() > 1e-6
