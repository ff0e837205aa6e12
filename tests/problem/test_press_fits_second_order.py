"""Press fits of second order up to planes of symmetry, against Lamé."""

import itertools

import bent_rings
import numpy as np
import pytest
from lame_rings import Lame
from sampling import some_of

import dolfinx_llm as llm


def fit(make, sizes, overlap):
    """Quarters of tubes with fixed inner and outer surfaces: the problem, and Lamé's pressure."""
    exact = Lame()
    exact.degree, exact.c, (low, at, high) = 2, np.zeros(2), exact.RADII
    parts = zip(sizes, ((low, at), (at - overlap, high)), (1, 5), strict=True)
    meshes = [make(h, *radii, tag) for h, radii, tag in parts]
    # a (r - low² / r) inside and b (r - high² / r) outside, of the same pressure and this jump
    slopes = [[at - r**2 / at for r in (low, high)]]
    slopes += [[exact.bulk + 2 * exact.mu * r**2 / at**2 for r in (low, high)]]
    a, _ = np.linalg.solve(np.multiply(slopes, (1.0, -1.0)), [-overlap, 0.0])
    return exact.linear(meshes, llm.Tied(close_gap=True), "saddle"), -slopes[1][0] * a


MAKE = bent_rings.bricks, bent_rings.shell
FITS = list(itertools.product(MAKE, ((0.4, 0.3), (0.3, 0.2)), ((0.0075, 0.045), (0.00075, 0.12))))


@pytest.mark.parametrize(("make", "sizes", "bounds"), some_of(FITS, [FITS[0], FITS[5]]))
def test_pressure(make, sizes, bounds):
    """Rows at the planes miss their nodes along the surface, by a part of the overlap: closing
    that as well sheared the bodies to and fro. And rows have places of the surface off by a
    hundredth of the smaller overlap, which was closed, too."""
    overlap, off = bounds
    problem, lame = fit(make, sizes, overlap)
    problem.solve()
    for side in problem.results[0].sides:
        pressure = np.einsum("ni,ni->n", side.density, side.normal)
        assert np.abs(pressure / lame - 1.0).max() <= off
    assert problem.results[0].pressure.mean() == pytest.approx(lame, rel=0.03)


def test_gaps_of_closed_rings():
    """Of 16:24 cells around: circles that are drawn in touch have none."""
    problem = bent_rings.tied((16, 24), 0.1, close_gap=True)
    (geometry,) = problem.geometries
    for pairs in geometry.pairs:
        off = np.linalg.norm(pairs.x, axis=1) - np.linalg.norm(pairs.N @ geometry.frame.x, axis=1)
        assert np.abs(off).max() > 1e-5
        assert np.abs(np.einsum("ni,ni->n", pairs.gap, pairs.normal)).max() <= 1e-7
