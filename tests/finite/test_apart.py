"""Bodies that a load brings nearer to each other, and that touch nowhere: said once, as of linear
ones; nothing is said once they touch, and of those that move away."""

import logging

import finite_patch
import numpy as np
import pytest
from contact_scenes import ABOVE, BELOW, rectangle
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

pytestmark = pytest.mark.quick


@pytest.mark.parametrize("gap", [0.05, 3.0])  # facets have the size 0.33
@pytest.mark.parametrize("rigid", [False, True])
def test_nothing_touches(gap, rigid, caplog):
    kind = "quadrilateral"
    meshes = [rectangle(MPI.COMM_SELF, (3, 2), (0.0, gap), (1.0, gap + 0.6), kind)]
    if not rigid:
        meshes.append(rectangle(MPI.COMM_SELF, (4, 2), (-0.2, -0.6), (1.3, 0.0), kind))
    spaces = [compat.function_space(domain, shape=(2,)) for domain, _ in meshes]
    ends, u = ([fem.Function(V) for V in spaces] for _ in range(2))
    at = gap + 0.6, -0.6
    bcs = [
        fem.dirichletbc(end, fem.locate_dofs_geometrical(V, lambda x, y=y: np.isclose(x[1], y)))
        for V, end, y in zip(spaces, ends, at)
    ]
    forms = [finite_patch.residual(v, *finite_patch.lame(1000.0, 0.3)) for v in u]
    other = llm.RigidPlane((0.0, 0.0), (0.0, 1.0)) if rigid else (meshes[-1][1], ABOVE)
    interface = llm.Interface(None, ((meshes[0][1], BELOW), other), law=llm.Frictionless())
    problem = llm.NonlinearContactProblem(forms, u, bcs=bcs, interfaces=[interface])
    told = []
    for down in (-0.1 * gap, 0.2 * gap, 0.4 * gap, gap + 0.01):
        ends[0].x.array[1::2] = -down
        caplog.clear()
        with caplog.at_level(logging.WARNING, "dolfinx_llm"):
            problem.solve()
        told.append(caplog.messages)
    assert [len(messages) for messages in told] == [0, 1, 0, 0]
    (words,) = told[1]
    assert (
        "nothing touches" in words and f"from {gap:.2g} as drawn to about {0.8 * gap:.2g}" in words
    )
    assert abs(problem.results[0].resultant[1]) > 1.0
