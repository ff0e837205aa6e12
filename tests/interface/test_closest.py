"""The closest point of a surface, of which pressures and places are read."""

import itertools

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from dolfinx_llm.interface.forces import closest

pytestmark = pytest.mark.quick


def test_closest_points_of_a_faceted_ball():
    """Beyond edges and corners as well: from shape functions that are continued outside of a cell
    others were made, which turned with the ball's facets."""
    rng = np.random.default_rng(3)
    x = rng.normal(size=(40, 3))
    x /= np.linalg.norm(x, axis=1)[:, None]
    cells = ConvexHull(x).simplices
    points = 1.3 * rng.normal(size=(60, 3)) + [0.0, 0.0, 2.0]
    nodes, N, beside = closest(x, cells, points)
    assert np.abs(beside).max() <= 1e-12  # it has no rim
    assert N.min() >= -1e-12 and np.abs(N.sum(axis=1) - 1.0).max() <= 1e-12
    met = np.einsum("kn,kni->ki", N, x[nodes])
    steps = np.linspace(0.0, 1.0, 41)
    parts = np.array([(a, b, 1 - a - b) for a, b in itertools.product(steps, steps) if a + b <= 1])
    every = np.einsum("pn,fni->fpi", parts, x[cells]).reshape(-1, 3)
    least = np.array([np.linalg.norm(every - point, axis=1).min() for point in points])
    assert (np.linalg.norm(met - points, axis=1) <= least + 1e-12).all()


def test_points_beyond_a_rim():
    """What lies beyond goes along the surface, from inside it goes across."""
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    points = np.array([[0.3, 0.4, 0.2], [1.5, 0.4, -0.1], [-0.3, -0.4, 0.1]])
    for cells in ([[0, 1, 2, 3]], [[0, 1, 2], [0, 2, 3]]):
        _, _, beside = closest(x, np.array(cells), points)
        assert np.abs(beside - [[0, 0, 0], [0.5, 0, 0], [-0.3, -0.4, 0]]).max() <= 1e-12
