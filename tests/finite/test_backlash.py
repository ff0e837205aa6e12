"""A lever on a rigid end with play between two jaws, which a moment brings to the farther one."""

import finite_patch
import numpy as np
import pytest
import wall_scenes as walls
from dolfinx import fem, mesh
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm.finite.falling import met_first

pytestmark = pytest.mark.quick
LEVER, JAWS, END = 1, 2, 3
BLOCKS = ((3.0, -1.0), (4.5, -0.31)), ((0.0, -0.3), (4.0, 0.3)), ((3.0, 0.33), (4.5, 1.0))
FREE, MOMENT = llm.Frictionless(), 0.2


def lever(law, moments, degree=1, parted=False, turn=0.0):
    """Results after each of the moments, and iterations; ``parted``: an interface per jaw."""
    counts = (5, 2), (13, 3), (5, 2)
    wall = walls.Wall(MPI.COMM_SELF, np.array(BLOCKS), counts, faces=[], turn=turn, degree=degree)
    domain, body = wall.domain, wall.body
    domain.topology.create_connectivity(1, 2)
    outside = mesh.exterior_facet_indices(domain.topology)
    of = body[[domain.topology.connectivity(1, 2).links(f)[0] for f in outside]]
    middle = mesh.compute_midpoints(domain, 1, outside)[:, :2] @ wall.R
    tag = np.where(of == 1, LEVER, JAWS + (10 * (of == 2) if parted else 0))
    tag[(of == 1) & np.isclose(middle[:, 0], 0.0)] = END
    tags = mesh.meshtags(domain, 1, outside, tag.astype(np.int32))
    u = fem.Function(wall.V)
    held = fem.locate_dofs_geometrical(wall.V, lambda x: np.abs((wall.R.T @ x[:2])[1]) > 0.999)
    end = llm.RigidPlane((0.0, 0.0), wall.R[:, 0], moment=0.0, pivot=(0.0, 0.0))
    jaws = sorted(set(tag) - {LEVER, END})
    interfaces = [llm.Interface(tags, (LEVER, int(jaw)), law=law) for jaw in jaws]
    problem = llm.NonlinearContactProblem(
        finite_patch.residual(u, *finite_patch.lame(1000.0, 0.3), degree),
        u,
        bcs=[fem.dirichletbc(np.zeros(2), held, wall.V)],
        interfaces=[*interfaces, llm.Interface(tags, (END, end), law=llm.Tied())],
    )
    for moment in moments:
        end.moment = moment
        problem.solve()
        sides = [r.sides[0] for r in problem.results[:-1]]
        turned = problem.results[-1].rotation.item()
        yield sides, turned, len(problem.history)
    problem.destroy()


@pytest.mark.parametrize("parted", [False, True])
@pytest.mark.parametrize(("degree", "law"), [(1, FREE), (1, llm.Coulomb(0.3)), longer(2, FREE)])
def test_a_moment_across_the_play(degree, law, parted):
    """Up, where the gap is three times as wide as below, down, and up: "a body flies away"."""
    turns = []
    for way, (sides, turned, count) in zip(
        (1, -1, 1), lever(law, (MOMENT, -MOMENT, MOMENT), degree, parted), strict=True
    ):
        x, f = (np.concatenate([getattr(s, name) for s in sides]) for name in ("x", "force"))
        assert np.isclose((x[:, 0] * f[:, 1] - x[:, 1] * f[:, 0]).sum(), way * MOMENT, rtol=1e-7)
        assert (x[np.abs(f[:, 1]) > 1e-3, 1] * way > 0.0).all()
        assert count <= 8
        turns.append(turned)
    assert turns[1] < -0.01 / 4.0 < 0.03 / 4.0 < turns[0]
    assert np.isclose(turns[0], turns[2], rtol=1e-6 if law is FREE else 1e-2)


def test_turned():
    """The same in another pose."""
    (one,), (other,) = (list(lever(FREE, (MOMENT,), turn=turn)) for turn in (0.0, 0.7))
    assert np.isclose(one[1], other[1], rtol=1e-9) and one[2] == other[2]


def test_met_first():
    """No load moves any: the nearest pairs. All go apart: none."""
    gap, nears = np.array([0.2, 0.1, np.inf]), np.array([1e-12, -1e-12, 5.0])
    assert (met_first(gap, nears, 1e-9) == 0.1).all()
    assert (met_first(gap, -np.ones(3), 1e-9) == -np.inf).all()
