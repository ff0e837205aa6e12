"""Sharp edges that press between the nodes of the other body."""

import logging

import finite_patch
import numpy as np
import pytest
from contact_scenes import ABOVE, BELOW, rectangle
from dolfinx import fem
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

pytestmark = pytest.mark.quick


def wedge(x):
    """A square's lower side as a ridge of 90 degrees at (0.03, 0)."""
    return np.column_stack([x[:, 0], x[:, 1] + (1.0 - x[:, 1] / 1.2) * np.abs(x[:, 0] - 0.03)])


@pytest.mark.parametrize(
    ("cells", "deep", "rounded"),
    [((4, 16), True, False), ((4, 48), True, True), longer((16, 8), False, False)],
)
@pytest.mark.parametrize("swapped", [False, longer(True)])
def test_edge_between_nodes(cells, deep, rounded, swapped, caplog):
    """A stiff ridge pressed into a soft block: where it is the coarser one it carries the frame,
    and its edge is no pair; where several nodes of the block lie on it, normals are rounded off.
    That is told, once; where the ridge is finer there is nothing to tell."""
    comm = MPI.COMM_SELF
    low = rectangle(comm, (cells[1], 4), (-1.0, -1.0), (1.0, 0.0), "quadrilateral")
    high = rectangle(comm, (cells[0], 3), (-0.97, 0.0), (1.03, 1.2), "quadrilateral", move=wedge)
    spaces = [compat.function_space(d, shape=(2,)) for d, _ in (high, low)]
    u, ends = ([fem.Function(V) for V in spaces] for _ in range(2))
    held = (lambda x: np.isclose(x[1], 1.2)), (lambda x: np.isclose(x[1], -1.0))
    bcs = [
        fem.dirichletbc(end, fem.locate_dofs_geometrical(V, where))
        for V, end, where in zip(spaces, ends, held, strict=True)
    ]
    forms = [
        finite_patch.residual(v, *finite_patch.lame(E, 0.3))
        for v, E in zip(u, (100.0, 1.0), strict=True)
    ]
    sides = ((high[1], BELOW), (low[1], ABOVE))[:: -1 if swapped else 1]
    interface = llm.Interface(None, sides, law=llm.Frictionless())
    problem = llm.NonlinearContactProblem(forms, u, bcs=bcs, interfaces=[interface])
    with caplog.at_level(logging.WARNING, "dolfinx_llm"):
        for down in (0.05, 0.12):
            ends[0].x.array[1::2] = -down
            problem.solve(2)
            ridge, block = problem.results[0].sides[:: -1 if swapped else 1]
            order = block.x[:, 0].argsort()
            top = np.interp(ridge.x[:, 0], *block.x[order].T)
            depth = (top - ridge.x[:, 1]).max()
            assert (depth > 0.1 * 2.0 / cells[1]) == deep
    assert len(caplog.messages) == deep + rounded
    told = {"between its nodes, by up to": deep, "presses on both sides of 1 sharp edge": rounded}
    for words, so in told.items():
        assert any(words in said for said in caplog.messages) == so
