"""A quarter of a ball pressed onto a block, between two planes of symmetry: slips on the
planes, where supports hold both sides."""

import warnings

import numpy as np
import pytest
import scenes
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.laws.rows import OPEN

pytestmark = pytest.mark.quick
DOWN, HIGH = 0.03, 0.25  # motion of the ball; height of nodes that it cannot bring into contact


def pressed(law, caplog):
    """Result of the ball, side 1, pressed by DOWN, and the warnings that came with it."""
    sections = (scenes.grid(7, 6), scenes.grid(5, 7))
    domain, tags = scenes.stacked(MPI.COMM_SELF, sections, (0.0, 1.0, 2.0))
    x, cells = domain.geometry.x, compat.cell_dofs(domain.geometry)
    ball = np.unique(cells[x[cells].mean(axis=1)[:, 2] > 1.0])
    x[ball, 2] += 0.25 * (x[ball, 0] ** 2 + x[ball, 1] ** 2) * (2.0 - x[ball, 2])
    V = compat.function_space(domain, shape=(3,))
    planes = [(k, scenes.on(k, 0.0)) for k in range(2)]
    held = planes + [(k, scenes.on(2, 0.0)) for k in range(3)]
    bcs = scenes.hold(V, held)
    bcs += scenes.hold(V, [(2, scenes.on(2, 2.0))], lambda p: np.full_like(p, -DOWN))
    problem = scenes.block_problem(V, tags, bcs=bcs, loads=[], law=law)
    with warnings.catch_warnings():
        problem.solve()
    return problem.results[0], [record.getMessage() for record in caplog.records]


def test_slips_on_planes_of_symmetry(caplog):
    """There supports hold both bodies across, and nothing slips; it did by up to the ball's radius,
    and a warning said that nodes slide by more than a facet."""
    result, said = pressed(llm.Coulomb(0.3), caplog)
    on_planes = 0
    for side in result.sides:
        assert np.linalg.norm(side.slip, axis=1).max() < 0.2 * DOWN
        for k in range(2):
            at = (np.abs(side.x[:, k]) < 1e-9) & (side.status != OPEN)
            on_planes += at.sum()
            assert np.abs(side.slip[at, k]).max() < 1e-12
    assert on_planes >= 8 and not [text for text in said if "slide by" in text]
