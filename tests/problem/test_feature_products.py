"""Products of documented features: each body balances, and ranks and forms agree."""

from functools import cache

import numpy as np
import pytest
from conftest import run_mpi_json
from random_features import ABOVE, BETWEEN, draw
from sampling import longer

SOME, MANY, MORE = range(2, 6), range(6, 26), range(26, 46)
WITHOUT = {"tied", "close", "frictionless"}  # friction


def test_scenes_are_of_all_kinds():
    """What is drawn has every law, end and action."""
    scenes = [draw(seed) for seed in (*SOME, *MANY, *MORE)]
    assert {scene.above for scene in scenes} == set(ABOVE)
    assert {scene.between for scene in scenes} == set(BETWEEN)
    assert len({kind for scene in scenes for kind, _ in scene.laws}) >= 10
    assert len({(s.gdim, s.order, s.quads, s.nonlinear) for s in scenes}) >= 8


def meets_on_the_way(scene):
    """Whether contact with friction may begin in an increment: slip counts from an iterate then."""
    rubs = "plane" in (scene.below, scene.above) or {kind for kind, _ in scene.laws} - WITHOUT
    return scene.nonlinear and bool(rubs)


@cache
def told(seeds, n=1, solver="auto"):
    """Per scene the numbers and imbalances of its load steps."""
    return run_mpi_json("features.py", n, solver, *map(str, seeds), seconds=900.0)


@pytest.mark.parametrize(
    ("seeds", "solver", "n"),
    [(SOME, "auto", 2), longer(SOME, "auto", 3), longer(MANY, "auto", 2)]
    + [longer(MORE, "auto", 2), longer(MORE, "condensed", 1)],
)
def test_features_together(seeds, solver, n):
    """Forces of sides, loads and springs on every body; numbers of all interfaces."""
    one, other = told(seeds), told(seeds, n, solver)
    assert list(one) == list(other) == list(map(str, seeds))
    for seed, (numbers, imbalances) in one.items():
        scene = draw(int(seed))
        assert max(imbalances) < 1e-10 and max(other[seed][1]) < 1e-9, scene
        if scene.twofold and solver != "auto":
            continue
        bound, words = 1e-3 if meets_on_the_way(scene) else 1e-8, str(scene)
        for a, b in zip(numbers, other[seed][0], strict=True):
            np.testing.assert_allclose(b, a, rtol=0.0, atol=bound * np.abs(a).max(), err_msg=words)
