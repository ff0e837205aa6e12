"""Curved tools that supports move as a whole: the frame is theirs, whatever their mesh."""

import bowls
import curved_scenes as curved
import numpy as np
import pytest
import scenes
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.laws.rows import OPEN

pytestmark = pytest.mark.quick
LAWS = {"frictionless": llm.Frictionless(), "friction": llm.Coulomb(0.3)}
DOWN, PRESS = 0.03, 0.01


BLOCK = scenes.grid(8, 8, high=(1.5, 1.5))


@pytest.mark.parametrize("law", LAWS)
def test_as_a_rigid_surface(law):
    """Pressed in by a fine mesh, as by the obstacle of the same facets; by both forms, with either
    side named first. With a frame of the block's facets nodes of the bowl pressed between its
    nodes, a fifth too hard; on a block of 4 cells 2.5 times as hard as a bowl of 4."""
    ways = ("saddle", (2, 3)), ("condensed", (2, 3)), ("saddle", (3, 2))
    found = [
        bowls.moved_down(
            BLOCK, scenes.grid(14, 14), DOWN, sides, law=LAWS[law], options={"solver": form}
        )
        for form, sides in ways
    ]
    for problem in found:
        problem.solve()
    assert all(len(problem.history) <= 8 for problem in found)
    assert "as a rigid obstacle" in str(found[0])
    sides = [problem.results[0].sides[::step] for problem, step in zip(found, (1, 1, -1))]
    block, bowl = sides[0]
    size = np.abs(block.force).max()
    for side in (block, bowl):
        assert 0 < (side.status == OPEN).sum() < len(side.x)
        assert side.normal_force.min() >= -1e-9 * size
    assert np.abs(block.force.sum(axis=0) + bowl.force.sum(axis=0)).max() <= 1e-10 * size
    for others in sides[1:]:
        for one, other in zip(sides[0], others, strict=True):
            assert np.abs(one.force - other.force).max() <= 1e-8 * size

    tool = found[0].geometries[0].site.whole[1]
    obstacle = llm.RigidSurface(llm.Frame(tool.x, tool.facets), displacement=(0.0, 0.0, -DOWN))
    alone, tags = scenes.stacked(MPI.COMM_SELF, (BLOCK,), (0.0, 1.0))
    V = compat.function_space(alone, shape=(3,))
    bcs = scenes.hold(V, bowls.HELD)
    other = scenes.block_problem(V, tags, (2, obstacle), bcs=bcs, loads=[], law=LAWS[law])
    other.solve()
    force = other.results[0].sides[0].force.sum(axis=0)
    assert abs(force[2] - block.force[:, 2].sum()) <= 0.01 * abs(force[2])


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("swap", [False, True])
def test_shafts_of_any_mesh(law, swap):
    """A shaft that is wider by PRESS, of 12 and of 31 cells around, in a ring of 12: all nodes of
    the ring bear the same, and the frame's say so. With a frame of the ring's facets it took up to
    10 iterations, and pressures were off by up to 0.05."""
    means = []
    for cells in (12, 31):
        V, tags = curved.rings(MPI.COMM_SELF, ((cells, 1), (12, 4)))
        a, L = scenes.forms(V)
        wider = fem.Function(V)
        wider.interpolate(lambda x: PRESS * x[:2] / np.hypot(x[0], x[1]))
        middle = V.mesh.geometry.x[compat.cell_dofs(V.mesh.geometry)].mean(axis=1)
        shaft = np.flatnonzero(np.hypot(*middle[:, :2].T) < 1.5).astype(np.int32)
        V.mesh.topology.create_connectivity(2, 2)
        bcs = scenes.hold(V, curved.QUARTER)
        bcs.append(fem.dirichletbc(wider, fem.locate_dofs_topological(V, 2, shaft)))
        sides = (curved.FACE_0, curved.FACE_1)
        interface = llm.Interface(tags, sides[::-1] if swap else sides, law=LAWS[law])
        problem = llm.ContactProblem(a, L, bcs=bcs, interfaces=[interface])
        problem.solve()
        assert len(problem.history) <= 6
        (result,) = problem.results
        ring = result.sides[0 if swap else 1]
        pressure = ring.normal_force / ring.area
        means.append(pressure.mean())
        assert np.abs(pressure / means[-1] - 1.0).max() <= 0.01
        assert np.abs(result.pressure / means[-1] - 1.0).max() <= 0.01
    assert abs(means[1] / means[0] - 1.0) <= 0.005
