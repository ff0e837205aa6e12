"""Ties that supports, or other interfaces, hold apart."""

from dataclasses import replace

import numpy as np
import pytest
import scenes
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm


def tied(others=(), held=()):
    """Problem of two blocks that are tied, the lower held, with interfaces at the top (tag 4), and
    component 2 of the nodes of tags ``held`` at a value each."""
    V, tags = scenes.two_blocks(MPI.COMM_SELF)
    bcs = scenes.hold(V, [(k, scenes.on(2, 0.0)) for k in range(3)])
    for tag, value in held:
        dofs = fem.locate_dofs_topological(V.sub(2), 2, tags.find(tag))
        bcs.append(fem.dirichletbc(fem.Constant(V.mesh, value), dofs, V.sub(2)))
    interfaces = [llm.Interface(tags, (2, 3), law=llm.Tied())]
    interfaces += [llm.Interface(tags, (4, other), law=llm.Tied()) for other in others]
    return scenes.elastic_problem([V], bcs, interfaces)


MEAN = [llm.MeanDisplacement((None, None, value)) for value in (-0.01, -0.02)]
ENDS = [llm.RigidPlane((0, 0, 2), (0, 0, -1), displacement=(0, 0, v)) for v in (-0.01, -0.02)]


@pytest.mark.parametrize(("others", "held"), [(MEAN, ()), (MEAN[1:], [(4, -0.01)])])
def test_a_mean_that_is_not_met(others, held):
    with pytest.raises(llm.ContactError, match="the mean displacement is not met"):
        tied(others, held).solve()


def test_what_prescribes_the_same(caplog):
    """Twice the same mean, or the one that supports prescribe."""
    for others, held in (((MEAN[0], replace(MEAN[0])), ()), (MEAN[:1], [(4, -0.01)])):
        problem = tied(others, held)
        (u,) = problem.solve()
        assert np.isfinite(u.x.array).all() and "torn" not in caplog.text


@pytest.mark.parametrize(
    ("others", "held"), [(ENDS, ()), ((MEAN[1], ENDS[0]), ()), ((), [(2, 0.0), (3, 0.01)])]
)
def test_torn_apart(others, held, caplog):
    """Two rigid ends that move by other amounts; supports that lift the upper block off."""
    tied(others, held).solve()
    assert "the tie is torn at" in caplog.text


def test_rounding_tears_nothing(caplog):
    """Where nothing moves, or supports move both sides alike."""
    tied(MEAN[:0], [(4, 0.0)]).solve()
    tied((replace(MEAN[0], mean=(None, None, 0.0)),)).solve()
    tied((), [(2, 1.0), (3, 1.0)]).solve()
    assert "torn" not in caplog.text
