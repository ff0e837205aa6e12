"""A follower pressure on contact that is narrower than a facet."""

import finite_patch
import numpy as np
import pytest
import scenes
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

SAID = "which covers no whole facet there"


@pytest.mark.parametrize(
    ("turn", "p", "told"), [(45, 0.1, True), (45, 0.0, False), (0, 0.1, False)]
)
def test_says_so(turn, p, told, caplog):
    """A square that stands on a corner, which is said, or lies on a floor. A seal with facets as
    wide as its contact bore 0.09 in the place of 0.51 under the pressure, without a word."""
    domain = mesh.create_rectangle(MPI.COMM_SELF, ((0.0, 0.0), (1.0, 1.0)), (4, 4))
    facets = mesh.locate_entities_boundary(domain, 1, lambda x: np.full(x.shape[1], True))
    tags = scenes.tags_from(domain, [facets], [np.full(len(facets), 1)], 1)
    V = compat.function_space(domain, shape=(2,))
    top = fem.locate_dofs_geometrical(V, scenes.on(1, 1.0))
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    domain.geometry.x[:, :2] = domain.geometry.x[:, :2] @ [[c, s], [-s, c]]
    u = fem.Function(V)
    F = finite_patch.residual(u, *finite_patch.lame(100.0, 0.3), 1)
    floor = llm.RigidPlane((0.0, 0.0), (0.0, 1.0), displacement=(0.0, 0.02))
    interface = llm.Interface(tags, (1, floor), law=llm.Frictionless())
    load = llm.FreeSurfacePressure(tags, 1, p, covered_by=floor)
    bcs = [fem.dirichletbc(np.zeros(2), top, V)]
    problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=[interface], loads=[load])
    problem.solve()
    assert (SAID in caplog.text) == told
    assert problem.results[0].sides[0].normal_force.sum() > 0.0
    problem.destroy()
