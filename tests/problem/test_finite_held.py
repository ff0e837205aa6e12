"""Supports that prescribe both sides of an interface at finite deformation."""

import numpy as np
import pytest
import test_finite_deformation as fd
from dolfinx import fem

import dolfinx_llm as llm


def held(law, other=None, order=(fd.LOW, fd.HIGH)):
    """Two blocks, 0.25 and 0.12 wide facets, both sides of whose interface are prescribed; and the
    motion of the upper one. In the place of the lower one another thing may be touched."""
    domain, tags = fd.blocks((4, 5), (1.0, 0.6), shift=0.17)
    V, u, F = fd.bodies_of(domain)
    down, still = fem.Constant(domain, (0.0, 0.0)), fem.Constant(domain, (0.0, 0.0))
    bcs = []
    for value, tag in ((still, fd.LOW), (still, fd.BOTTOM), (down, fd.TOP), (down, fd.HIGH)):
        dofs = fem.locate_dofs_topological(V, 1, tags.indices[tags.values == tag])
        bcs.append(fem.dirichletbc(value, dofs, V))
    order = order if other is None else (fd.HIGH, other)
    interfaces = [llm.Interface(tags, order, law=law)]
    return llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=interfaces), down


@pytest.mark.parametrize(
    ("law", "other"),
    [
        (llm.Frictionless(), None),
        (llm.Coulomb(0.3), None),
        (llm.Tied(), None),
        (llm.Frictionless(), llm.RigidPlane((0.0, 1.0), (0.0, 1.0))),
        (llm.Coulomb(0.3), llm.RigidPlane((0.0, 1.0), (0.0, 1.0))),
    ],
)
def test_both_sides_prescribed(law, other):
    """In each other it is an error that says how deep, and keeps the last increment; apart, or by
    less than facets of curved surfaces are off, it is none."""
    problem, down = held(law, other)
    torn = "torn apart" if isinstance(law, llm.Tied) else "in each other"
    down.value = 0.0, -5e-4
    problem.solve()
    before = problem.u.x.array.copy()
    for increments in (1, 4):
        down.value = 0.0, -0.1
        with pytest.raises(llm.ContactError, match=f"both sides at 6 node.*, {torn} by up to 0.1,"):
            problem.solve(increments)
        assert np.array_equal(problem.u.x.array, before) == (increments == 1)
        assert len(problem.history) <= increments
    if not isinstance(law, llm.Tied):
        down.value = 0.0, 0.01
        problem.solve()
        assert not problem.results[0].sides[0].status.any()


def test_order_of_the_sides_does_not_matter():
    said = []
    for order in ((fd.LOW, fd.HIGH), (fd.HIGH, fd.LOW)):
        problem, down = held(llm.Frictionless(), order=order)
        down.value = 0.0, -0.1
        with pytest.raises(llm.ContactError) as error:
            problem.solve()
        said.append(str(error.value).split(", in each")[1])
    assert said[0] == said[1]
