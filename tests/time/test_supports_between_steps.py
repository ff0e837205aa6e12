"""Supports that come and go between steps in time: forces are others at once."""

import finite_patch
import numpy as np
import pytest
import scenes
import ufl
from contact_scenes import ABOVE, BELOW, rectangle
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM = MPI.COMM_SELF


class Pair:
    """A tool on a block, stepped in time under its weight."""

    def __init__(self, kind, law, held):
        bodies = [rectangle(COMM, (4, 8), (0, 0), (1, 1), "triangle")]
        bodies += [rectangle(COMM, (7, 8), (0, 1), (1, 2), "triangle")]
        a, loads, u = [], [], []
        for domain, _ in bodies:
            V = compat.function_space(domain, shape=(2,))
            w = ufl.TestFunction(V)
            u.append(fem.Function(V))
            loads.append(ufl.inner(fem.Constant(domain, (0.3, -1.0)), w) * ufl.dx)
            energy = finite_patch.energy(u[-1], *finite_patch.lame(10.0, 0.3))
            F = ufl.derivative(energy * ufl.dx, u[-1], w) - loads[-1]
            a.append(F if kind == "finite" else scenes.forms(V)[0])
        foot, tool = (
            fem.dirichletbc(np.zeros(2), fem.locate_dofs_geometrical(v.function_space, at),
                            v.function_space)
            for v, at in zip(u, (scenes.on(1, 0.0), scenes.on(1, 1.0)), strict=True)
        )  # fmt: skip
        self.bcs, self.tool = [foot], tool
        self.hold(held)
        sides = (bodies[0][1], ABOVE), (bodies[1][1], BELOW)
        interface, rest = llm.Interface(None, sides, law=law), u if kind == "finite" else loads
        self.stepper = llm.TimeStepper(1.0, a, rest, dt=0.02, interfaces=interface, bcs=self.bcs)

    def hold(self, held):
        self.bcs[1:] = [self.tool] if held else []

    def step(self, times):
        """Displacement, velocity and forces then."""
        for _ in range(times):
            self.stepper.step()
        sides = self.stepper.problem.results[0].sides
        own = [np.concatenate([f.x.array for f in w]) for w in (self.stepper.u, self.stepper.v)]
        return *own, np.concatenate([side.force.ravel() for side in sides])


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("law", [llm.Tied(), llm.Frictionless()], ids=["tied", "frictionless"])
@pytest.mark.parametrize("kind", ["linear", "finite"])
def test_as_steps_that_start_there(kind, law, held):
    """Ties rang with what supports had borne, three times as much as they should bear, and linear
    bodies went ways of their own, by 3 % after four steps."""
    one, other = Pair(kind, law, held), Pair(kind, law, not held)
    one.step(3)
    for name in ("u", "v"):
        of = zip(getattr(other.stepper, name), getattr(one.stepper, name), strict=True)
        for f, g in of:
            f.x.array[:] = g.x.array
    one.hold(not held)
    for found, known in zip(one.step(3), other.step(3), strict=True):
        assert np.abs(found - known).max() <= 1e-9 * np.abs(known).max()
