"""Forces of unit pressure by which rows of a moving frame are designed."""

import numpy as np
import pytest

from dolfinx_llm.finite.frame.design_loads import balanced_loads
from dolfinx_llm.finite.frame.sides import Sides
from dolfinx_llm.geometry.surface import Surface

pytestmark = pytest.mark.quick


def circle(n, radius, outwards, centre=(0.0, 0.0)):
    """A closed polygon of n facets of first order."""
    angle, nodes = 2.0 * np.pi * (np.arange(n) + 0.3) / n, np.arange(n)
    x = np.column_stack([np.cos(angle), np.sin(angle)]) * radius + centre
    facets = np.column_stack([nodes, np.roll(nodes, -1)])
    facets = facets[:, ::-1] if outwards else facets
    return Surface(x, facets, nodes, 0 * nodes, "circle")


@pytest.mark.parametrize("gap", [0.0, 0.02])
def test_both_sides_have_the_same_area(gap):
    """Circles, one beside the other's centre: the sums, and first moments but for what polygons
    leave, are alike, where areas differ by the gap over the radius."""
    inner, outer = circle(16, 1.0, False), circle(24, 1.0 + gap, True, (0.6 * gap, 0.0))
    sides = Sides.of((inner, outer))
    z = np.concatenate([s.x.ravel() for s in sides.surfaces])
    meeting = sides.meet(z, sides.candidates(z))
    areas = sides.forces(meeting, z, True)
    (own, frame), _ = balanced_loads(sides, meeting, z, areas)
    around = 2.0 * 16 * np.sin(np.pi / 16)
    assert frame.sum() == pytest.approx(around, rel=1e-12)
    assert own.sum() == pytest.approx(around, rel=1e-12)
    at = meeting.at
    places = np.einsum("nk,nki->ni", at.N, sides.split(z)[1][sides.carrier.cells[at.facet]])
    assert np.abs(own @ places).max() < 0.1 * gap + 1e-12
    assert areas[0].sum() > (1.0 + 0.9 * gap) * around
    assert gap == 0.0 or np.abs(areas[0] @ places).max() > gap
