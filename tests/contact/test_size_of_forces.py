"""By which forces residuals and pulls are judged: those of a load step, not of all before."""

import numpy as np
import pytest
import ufl
from contact_scenes import ABOVE, BELOW, rectangle, stress
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat


class OnFloor:
    """A block that only contact holds from below, held sideways at its left edge; pressed or pulled
    by a force per area of its top."""

    def __init__(self, law=None, solver="auto"):
        self.domain, tags = rectangle(MPI.COMM_SELF, (4, 5), (0, 0), (1, 1), "quadrilateral")
        V = self.V = compat.function_space(self.domain, shape=(2,))
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        self.force = fem.Constant(self.domain, np.zeros(2))
        ds = ufl.Measure("ds", domain=self.domain, subdomain_data=tags)(ABOVE)
        side, _ = V.sub(0).collapse()
        left = fem.locate_dofs_geometrical((V.sub(0), side), lambda p: np.isclose(p[0], 0.0))
        zero = fem.Constant(self.domain, 0.0)
        self.problem = llm.ContactProblem(
            ufl.inner(stress(u), ufl.grad(w)) * ufl.dx,
            ufl.inner(self.force, w) * ds,
            bcs=[fem.dirichletbc(zero, left[0], V.sub(0))],
            interfaces=[
                llm.Interface(
                    tags,
                    (BELOW, llm.RigidPlane((0.0, 0.0), (0.0, 1.0))),
                    law=law or llm.Frictionless(),
                )
            ],
            solver=solver,
        )

    def load(self, down):
        self.force.value = 0.0, -down
        self.problem.solve()
        return self.problem.results[0].resultant


def spoil(method, share):
    """Have a form tell displacements that are wrong by a share of their size."""
    form, right = method.form, method.form.displacement
    form.displacement = lambda found: (
        (u := right(found)) * (1.0 + share * np.cos(np.arange(len(u))))
    )


@pytest.mark.parametrize("solver", ["saddle", "condensed"])
@pytest.mark.parametrize("first", [1e6, 1e9])
def test_a_body_that_is_pulled_off(solver, first):
    """However hard it was pressed before."""
    block = OnFloor(solver=solver)
    assert abs(block.load(first)[1] / -first - 1.0) < 1e-9
    with pytest.raises(llm.ContactError, match="do not balance the load"):
        block.load(-1.0)
    assert abs(block.load(1.0)[1] + 1.0) < 1e-6


@pytest.mark.parametrize("law", [llm.Frictionless(), llm.Coulomb(0.3)])
@pytest.mark.parametrize("solver", ["saddle", "condensed"])
def test_loads_that_go_back_to_zero(law, solver):
    """What rounding and GMRES leave of the loads before is no imbalance, nor later on."""
    block = OnFloor(law, solver)
    for down in (1e3, 0.0, 0.0, 1e3, 1e-3, 0.0, 1e3):
        N = -block.load(down)[1]
        assert abs(N - down) <= 1e-9 * 1e3


def test_a_wrong_solution_after_large_forces():
    """A displacement that is wrong by 1 % is found out, though the forces that are left over are
    next to nothing beside those of the first step."""
    block = OnFloor()
    for down in (1e9, 1.0, 1.0):
        block.load(down)
    spoil(block.problem.method, 1e-2)
    with pytest.raises(llm.ContactError, match="the solve failed"):
        block.load(1.0)


def test_a_wrong_solution_in_time():
    """The same of steps in time of a body that slides at the start: what holds it there, to find
    the forces, is 1e7 times as stiff."""
    block = OnFloor(llm.Coulomb(0.2))
    V, w = block.V, ufl.TestFunction(block.V)
    tags = block.problem.interfaces[0].facet_tags
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    stepper = llm.TimeStepper(
        1.0,
        ufl.inner(stress(ufl.TrialFunction(V)), ufl.grad(w)) * ufl.dx,
        ufl.inner(fem.Constant(block.domain, np.array([0.0, -1.0])), w) * ufl.dx,
        dt=0.005,
        interfaces=[llm.Interface(tags, (BELOW, plane), law=llm.Coulomb(0.2))],
    )
    stepper.v.x.array.reshape(-1, 2)[:] = 0.5, 0.0
    for _ in range(2):
        stepper.step()
    spoil(stepper.problem.method, 1e-2)
    with pytest.raises(llm.ContactError, match="the solve failed"):
        stepper.problem.solve()
