"""Random scenes in which all of the last body is moved, as a rigid tool, and carries the frame: the
conditions of contact, and what must not change the answer. More: ``random_campaign.py --tools``."""

import numpy as np
import pytest
import random_finite
import random_scenes as scenes
import scene_oracle
from conftest import run_mpi_json
from sampling import some_of
from test_random_scenes import POSED, agree, violations

# Flat and curved, of both laws, beside other interfaces, of second order (the last ones).
SMALL = [
    (n, False) for n in (8001, 8017, 8028, 8029, 8050, 8060, 8104, 8117, 8608, 8620, 8638, 8657)
]
SMALL += [(n, True) for n in (8224, 8226, 8227, 8251, 8262, 8265, 8267)]
KEPT = [(8017, False), (8028, False), (8657, False), (8227, True), (8262, True)]
FINITE = [(n, False) for n in (8304, 8308, 8313, 8316, 8331, 8339, 8340, 8343, 8373, 8388)]
FINITE_KEPT = [(8331, False), (8373, False)]
NAMES = ("turned", "mirrored", "swapped", "renumbered", "units", "saddle", "condensed")


def drawn(seed, second, of=scenes):
    scene = of.draw(seed, second)
    scene.tool = True
    return scene


@pytest.mark.parametrize(("seed", "second"), some_of(SMALL, KEPT))
def test_conditions_of_tools(seed, second):
    """From K u - f and the positions; no node of a tool pulls."""
    _, found = scene_oracle.check(drawn(seed, second))
    assert violations(found) == [{}] * len(found)


@pytest.mark.parametrize(("seed", "second"), some_of(FINITE, FINITE_KEPT))
def test_conditions_of_tools_at_finite_deformation(seed, second):
    _, found = random_finite.check(drawn(seed, second, random_finite))
    assert violations(found) == [{}] * len(found)


POSES = [(*of, name) for of in SMALL for name in NAMES]


@pytest.mark.parametrize(
    ("seed", "second", "name"),
    some_of(POSES, [(8028, False, "swapped"), (8262, True, "turned"), (8017, False, "condensed")]),
)
def test_poses_of_tools(seed, second, name):
    scene = drawn(seed, second)
    agree(scenes.solve(scene, POSED[name].of(scene)), scenes.solve(scene), scene)


# 8340 depends on the pose by 3e-4 of the largest force: a body of two facets below a tool with a
# bulge, with friction.
FINITE_POSES = [(*of, name) for of in FINITE if of[0] != 8340 for name in NAMES]


@pytest.mark.parametrize(
    ("seed", "second", "name"),
    some_of(FINITE_POSES, [(8331, False, "swapped"), (8373, False, "condensed")]),
)
def test_poses_of_tools_at_finite_deformation(seed, second, name):
    scene = drawn(seed, second, random_finite)
    agree(random_finite.solve(scene, POSED[name].of(scene)), random_finite.solve(scene), scene)


@pytest.mark.parametrize(
    ("n", "kind", "seed", "second"),
    some_of(
        [
            (2, "tools", 8017, False),
            (3, "tools", 8028, False),
            (3, "tools", 8262, True),
            (2, "finite-tools", 8331, False),
            (3, "finite-tools", 8373, False),
        ],
        [(3, "tools", 8028, False), (2, "finite-tools", 8331, False)],
    ),
)
def test_tools_on_ranks(n, kind, seed, second):
    ranks = run_mpi_json("random_ranks.py", n, kind, *(["second"] if second else []), seed)
    of = random_finite if kind == "finite-tools" else scenes
    scene = drawn(seed, second, of)
    found = [
        scenes.Answer(np.array(a["u"]), [np.array(f) for f in a["force"]], [], [])
        for a in ranks[str(seed)]
    ]
    agree(found, of.solve(scene), scene)
