"""What makes contact unknown between steps in time: an obstacle drawn anew, u set by hand."""

import itertools
from functools import cache

import finite_patch
import numpy as np
import pytest
import scenes
import ufl
from contact_scenes import BELOW, rectangle
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

WAY = 0.1  # by which the block is set elsewhere [length]


class Block:
    """Under its weight on a plane, along which it is pushed by less than friction bears."""

    def __init__(self, kind):
        domain, tags = rectangle(MPI.COMM_SELF, (4, 5), (0, 0), (1, 1), "quadrilateral")
        V = compat.function_space(domain, shape=(2,))
        u, w = fem.Function(V), ufl.TestFunction(V)
        load = ufl.inner(fem.Constant(domain, (0.2, -1.0)), w) * ufl.dx
        form, rest = scenes.forms(V)[0], load
        if kind == "finite":
            energy = finite_patch.energy(u, *finite_patch.lame(scenes.E, scenes.NU))
            form, rest = ufl.derivative(energy * ufl.dx, u, w) - load, u
        self.plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
        interface = llm.Interface(tags, (BELOW, self.plane), law=llm.Coulomb(0.6))
        self.stepper = llm.TimeStepper(1.0, form, rest, dt=2e-3, damping=0.5, interfaces=interface)

    def draw_anew(self):
        self.plane.point = (0.0, 1e-12)

    def start_again(self):
        self.stepper.start()

    def forget(self):
        self.stepper.problem.reset()

    def set_elsewhere(self):
        self.stepper.u.x.array[0::2] += WAY


@cache
def slid(kind, change=lambda block: None):
    """Resultant and displacement of a block that slides back at first, and is changed then."""
    block = Block(kind)
    block.stepper.v.x.array[0::2] = -0.04
    for _ in range(30):
        block.stepper.step()
    change(block)
    block.stepper.step()
    return block.stepper.problem.results[0].resultant, block.stepper.u.x.array


CHANGES = Block.draw_anew, Block.start_again, Block.forget, Block.set_elsewhere
CASES = [*itertools.product(("linear",), CHANGES), ("finite", Block.set_elsewhere)]


@pytest.mark.parametrize("kind, change", CASES)
def test_sticks_where_it_is(kind, change):
    """Slip was counted from the drawing, or from the place before, and friction turned round; what
    acted along the plane at the start of linear bodies was lost."""
    wanted, place = slid(kind)
    found, reached = slid.__wrapped__(kind, change)
    assert abs(wanted[0]) > 0.1 * abs(wanted[1])
    assert np.abs(found - wanted).max() < 0.02 * np.abs(wanted).max()
    motion = (reached - place).reshape(-1, 2)
    if change is Block.set_elsewhere:
        motion[:, 0] -= WAY
    assert np.abs(motion).max() < 0.02 * np.abs(place).max()


@pytest.mark.parametrize("kind", ["linear", "finite"])
def test_starts_elsewhere(kind):
    """A block at rest that is set elsewhere has slipped nowhere."""
    forces = []
    for way in (0.0, WAY):
        stepper = Block(kind).stepper
        stepper.u.x.array[0::2] = way
        stepper.start()
        stepper.step()
        forces.append(stepper.problem.results[0].resultant)
    assert np.abs(forces[1] - forces[0]).max() < 0.01 * np.abs(forces[0]).max()
