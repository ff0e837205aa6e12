"""Frames between bodies that have come apart."""

import numpy as np
import pytest
from contact_scenes import Pressed, rectangle
from mpi4py import MPI
from scipy.sparse import csr_matrix

import dolfinx_llm as llm
from dolfinx_llm.contact.search.parted import _farthest

pytestmark = pytest.mark.quick


@pytest.mark.parametrize("unit", [1e-12, 1e-8, 1.0, 1e9])
def test_in_any_units(unit):
    """Two nodes between a body below, up to 0.2, and one from 1 and 0.6 on: midway."""
    N = np.array([[1.0, 0.0], [0.0, 1.0], [0.5, 0.5]])
    low, high = np.array([0.2, 0.1, 0.2]), np.array([1.0, 0.6, 0.8])
    L, position = csr_matrix(np.vstack([N, -N])), np.concatenate([low, -high])
    found = _farthest(L, position * unit, unit)
    least = (L @ found - position * unit).min() / unit
    assert least == pytest.approx(0.25, rel=1e-6)
    assert _farthest(L, -position * unit, unit) is None


def test_nodes_that_rows_hardly_see():
    """One of them went to 1e13 times the motion of the bodies, which then told what rounding is:
    wrong forces of the next load step were taken for exact."""
    N = np.array([[1.0, 0.0], [1.0, 1e-8], [1.0, -1e-8]])
    low, high = np.array([0.0, 0.1, 0.0]), np.array([1.0, 1.0, 0.4])
    found = _farthest(csr_matrix(np.vstack([N, -N])), np.concatenate([low, -high]), 1.0)
    assert np.abs(found).max() <= 2.0


@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("law", [llm.Frictionless(), llm.Coulomb(0.1)], ids=str)
def test_nodes_beside_the_other_side(law, swap):
    """A block just above a coarse one, over a part of which it stands on one corner: where it ends
    the frame between them goes on into the other, which was taken for overlap."""

    def tilted(x):
        return x + (0.02 * (1.0 - x[:, 0]))[:, None] * [0.0, 1.0]

    low = rectangle(MPI.COMM_SELF, (2, 2), (-2.0, 0.0), (2.0, 0.5), "triangle")
    high = rectangle(MPI.COMM_SELF, (8, 2), (-1.0, 0.5), (1.0, 1.0), "triangle", move=tilted)
    scene = Pressed(
        [low, high], law, lambda p: p[1] > 0.9, lambda p: np.isclose(p[1], 0.0), swap=swap
    )
    scene.move(lambda p: np.vstack([0.0 * p[0], 1e-4 + 0.0 * p[0]]))
    (result,) = scene.problem.results
    assert np.abs(result.resultant).max() == 0.0
    assert min(side.gap.min() for side in result.sides) == pytest.approx(1e-4, rel=0.01)
