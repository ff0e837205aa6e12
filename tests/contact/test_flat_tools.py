"""Flat tools that supports move as a whole, with smaller facets than the block below them."""

import numpy as np
import pytest
from flat_tools import FlatTool
from sampling import longer

import dolfinx_llm as llm

LAWS = {"frictionless": llm.Frictionless(), "friction": llm.Coulomb(0.3)}


def balanced(result):
    """Whether forces and moments of both sides cancel, and none pulls."""
    tool, block = result.sides[1], result.sides[0]
    size = np.abs(block.force).max()
    moment = result.moment(side=0) + result.moment(side=1)
    total = np.abs(block.force.sum(axis=0) + tool.force.sum(axis=0)).max()
    pulls = max(-side.normal_force.min() for side in (block, tool))
    return max(total, np.abs(moment).max(), pulls) < 1e-10 * size


@pytest.mark.quick
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("finite", [False, True], ids=["small", "finite"])
@pytest.mark.parametrize("order", [1, 2])
def test_any_mesh_of_the_tool(order, finite, law):
    """The same forces on the block, whatever the cells of the tool, in few iterations: with a frame
    of the block's facets Newton's iteration failed. The tool's own press most at its edges, also
    where it is dragged, and none pulls."""
    found = []
    for across in (21, 37) if order == 1 else (13, 21):
        scene = FlatTool("quadrilateral", 16, across, 0.59, order, LAWS[law], finite)
        for motion in ((0.0, -0.07), (0.03, -0.07)):
            result = scene.press(*motion)
            assert len(scene.problem.history) <= (8 if motion[0] and law == "friction" else 5)
            assert balanced(result)
            found.append(result.sides[0].force)
        tool = result.sides[1]
        assert (tool.status != 0).sum() >= 0.6 * len(tool.x)
        inner = np.abs(tool.x[:, 0] - tool.x[:, 0].mean()) < 0.3
        assert tool.pressing.max() > 1.5 * np.median(tool.pressing[inner])
    for one, other in zip(found[:2], found[2:], strict=True):
        assert np.abs(one - other).max() < 1e-9 * np.abs(one).max()


@pytest.mark.parametrize("finite", [False, True], ids=["small", "finite"])
@pytest.mark.parametrize(
    "kind, order, cells",
    [
        ("quadrilateral", 2, (6, 11)),
        ("hexahedron", 1, (4, 7)),
        longer("triangle", 1, (6, 15)),
        longer("tetrahedron", 1, (4, 9)),
        longer("hexahedron", 2, (4, 8)),
    ],
    ids=str,
)
def test_as_a_rigid_plane(kind, order, cells, finite):
    """A tool that is wider than the block, and presses and drags it as the plane does."""
    forces = []
    for rigid in (False, True):
        scene = FlatTool(kind, *cells, 1.2, order, llm.Coulomb(0.3), finite, rigid)
        along = (0.0,) * (scene.gdim - 2)
        for motion in ((0.0, *along, -0.05), (0.02, *along, -0.05)):
            result = scene.press(*motion)
            assert rigid or balanced(result)
            forces.append(result.sides[0].force)
    for tool, plane in zip(forces[:2], forces[2:], strict=True):
        assert np.abs(tool - plane).max() < 1e-8 * np.abs(plane).max()


def test_few_facets_below():
    """A tool no wider than a few facets of the block: its nodes are the pairs, and press where they
    are."""
    scene = FlatTool("quadrilateral", 2, 8, 0.3, 1, llm.Frictionless(), finite=False)
    result = scene.press(0.0, -0.05)
    assert scene.problem.geometries[0].site.prescribed is None
    assert balanced(result)


@pytest.mark.parametrize("finite", [False, True], ids=["small", "finite"])
def test_beside_the_rim(finite):
    """A tilted tool that the block first meets beside its rim: an error, and what was found before
    is kept; pressed in farther it is met below."""
    scene = FlatTool("quadrilateral", 8, 21, 0.59, 1, llm.Frictionless(), finite)
    before = scene.press(0.0, -0.02).sides[0].force
    with pytest.raises(llm.ContactError, match="what presses lies beside tag 1"):
        scene.press(0.0, 0.0139, tilt=0.02)
    assert np.array_equal(scene.problem.results[0].sides[0].force, before)
    assert balanced(scene.press(0.0, -0.02, tilt=0.02))
