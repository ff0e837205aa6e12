"""Bodies with friction that slide, tip or roll by more than a facet in a load step: how many of
Newton's iterations they take."""

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

MIDDLE = np.array([[0.5], [1.0]])  # of the block's top


class Block:
    """A block on a softer base, led by its top."""

    def __init__(self, degree, kind, cells, mu=0.3):
        comm = MPI.COMM_SELF
        block = rectangle(comm, (cells, cells), (0.0, 0.0), (1.0, 1.0), kind)
        below = (12 * cells) // 5, 2
        base = rectangle(comm, below, (-1.0, -0.5), (3.0, 0.0), kind)
        spaces = [compat.function_space(d, degree=degree, shape=(2,)) for d, _ in (block, base)]
        self.top = fem.Function(spaces[0])
        ends = (spaces[0], self.top, 1.0), (spaces[1], fem.Function(spaces[1]), -0.5)
        bcs = [
            fem.dirichletbc(
                value, fem.locate_dofs_geometrical(V, lambda x, y=y: np.isclose(x[1], y))
            )
            for V, value, y in ends
        ]
        u = [fem.Function(V) for V in spaces]
        F = [
            finite_patch.residual(v, *finite_patch.lame(E, 0.3), degree)
            for v, E in zip(u, (20.0, 10.0), strict=True)
        ]
        sides = (block[1], BELOW), (base[1], ABOVE)
        interface = llm.Interface(None, sides, law=llm.Coulomb(mu))
        self.problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=[interface])

    def move(self, along, down, angle=0.0):
        """Iterations with the top there."""
        c, s = np.cos(angle), np.sin(angle)
        R, to = np.array([[c, -s], [s, c]]), MIDDLE + [[along], [-down]]
        self.top.interpolate(lambda x: R @ (x[:2] - MIDDLE) + to - x[:2])
        self.problem.solve()
        return len(self.problem.history)


@pytest.mark.parametrize(
    ("degree", "kind", "cells"),
    [(2, "triangle", 4), longer(2, "quadrilateral", 4), longer(2, "quadrilateral", 6)],
)
def test_a_block_that_is_dragged_and_tipped(degree, kind, cells):
    """Which pairs touch is found in the linear model in every iteration: steps took 8 to 22."""
    block = Block(degree, kind, cells)
    assert max(block.move(0.6 * s, 0.05, -0.2 * s) for s in np.linspace(0.0, 1.0, 4)) <= 7
    T, N = np.abs(block.problem.results[0].resultant)
    assert T / N == pytest.approx(0.3, abs=0.02)
