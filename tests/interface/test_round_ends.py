"""What is said of a round bore or shaft that is to be tied to an obstacle of another form."""

import numpy as np
import pytest

import dolfinx_llm as llm
from dolfinx_llm.finite.obstacles.tied_obstacle import TiedObstacle
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.rounds import round_advice


def surface(x, facets):
    """Of nodes x (n, gdim) and facets (f, k), on one rank."""
    n = len(x)
    return Surface(x, facets, np.arange(n), np.zeros(n, int), name="tag 2")


def ring(out, n=24, part=1.0):
    """A circle of radius 0.7 about (0, 1) whose normals point out of it or into it."""
    turn = 2.0 * np.pi * part * np.arange(n + (part < 1.0)) / n
    x = np.column_stack([0.7 * np.cos(turn), 1.0 + 0.7 * np.sin(turn)])
    first = np.arange(n)
    facets = np.column_stack([first, (first + 1) % len(x)])
    return x, facets[:, :: -1 if out else 1]


@pytest.mark.parametrize("part", [1.0, 0.3])
@pytest.mark.parametrize(("out", "inside"), [(False, ""), (True, ", inside=True")])
def test_circles(out, inside, part):
    said = round_advice(surface(*ring(out, part=part)))
    assert f"llm.RigidSphere([0.0, 1.0], 0.7{inside}): take that" in said


def test_a_bore():
    """Quadrilaterals about the axis z: the cylinder is told, whatever way its axis goes."""
    (x, facets), n = ring(out=False), 24
    low, high = np.c_[x, np.zeros(n)], np.c_[x, np.full(n, 0.5)]
    cells = np.column_stack([facets, facets + n])[:, [0, 1, 3, 2]]
    said = round_advice(surface(np.r_[low, high], cells))
    assert "RigidCylinder([0.0, 1.0, 0.25], [0.0, 0.0, " in said
    assert "1.0], 0.7" in said


def test_what_is_not_round():
    line = np.column_stack([np.arange(5.0), np.zeros(5)])
    facets = np.column_stack([np.arange(4), np.arange(1, 5)])
    assert not round_advice(surface(line, facets))
    bent = np.array([[0.0, 0.0], [1.0, 0.0], [3.0, 1.0]])  # always lie on a circle
    assert not round_advice(surface(bent, facets[:2]))


def test_a_bore_that_is_tied_to_a_plane():
    bore, plane = surface(*ring(out=False)), llm.RigidPlane((0.0, 1.0), (0.0, 1.0))
    told = r"lie up to 0\.7 apart, .* within .* of a llm\.RigidSphere\(\[0\.0, 1\.0\], 0\.7\): take"
    with pytest.raises(llm.ContactError, match=told):
        TiedObstacle.between(bore, plane, "end", False)
