"""Which of two equally coarse surfaces carries the frame, however both are turned and named."""

import numpy as np
import pytest

from dolfinx_llm.finite.frame.sides import coarser
from dolfinx_llm.geometry.surface import Surface

pytestmark = pytest.mark.quick


def line(x, name):
    """Along points (n, 2)."""
    at = np.arange(len(x))
    return Surface(np.asarray(x), np.column_stack([at[:-1], at[1:]]), at, 0 * at, name)


def flat(lengths, y, names):
    """Two lines across from each other, of facets of the same size."""
    for count, way, height, name in zip(lengths, (-1, 1), y, names, strict=True):
        x = np.linspace(0.0, 0.2 * count, count + 1)
        yield np.column_stack([x, np.full(count + 1, height)])[::way], name


def rings(names):
    """Two rings, one in the other, of facets of the same size."""
    for radius, way, name in zip((1.0, 1.0), (1, -1), names, strict=True):
        angle = np.linspace(0.0, 2.0 * np.pi, 31)
        yield radius * np.column_stack([np.cos(angle), np.sin(angle)])[::way], name


SCENES = {
    "longer": lambda: flat((7, 6), (0.0, 0.1), ("tag 1", "tag 2")),
    "alike": lambda: flat((6, 6), (0.0, 0.1), ("tag 1", "tag 2")),
    "rings": lambda: rings(("tag 1", "tag 2")),
}


@pytest.mark.parametrize("scene", SCENES)
def test_whatever_the_pose(scene):
    """The same one, also with the other named first; of flat ones it was that whose normal came
    first, and so another one where bodies were turned."""
    found = set()
    for angle in np.linspace(0.1, 2.0 * np.pi, 7):
        c, s = np.cos(angle), np.sin(angle)
        both = [line(x @ [[c, s], [-s, c]], name) for x, name in SCENES[scene]()]
        found.add(coarser(both))
        assert coarser(both[::-1]) == 1 - coarser(both)
    assert len(found) == 1
