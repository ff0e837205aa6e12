"""Two roofs, the ridges of which cross between their nodes."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.finite.frame.crossing import crossing

CELLS = 4


def roof(up, along, shift):
    """A block whose top, or underside, has a ridge along an axis; its tags, 1 of that surface."""
    low, high = ([-1.0, -1.0, -1.0], [1.0, 1.0, 0.0]) if up else ([-1.0, -1.0, 0.0], [1.0] * 3)
    domain = mesh.create_box(MPI.COMM_SELF, [low, high], [CELLS, CELLS, 2])
    found = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[2], 0.0))
    tags = mesh.meshtags(domain, 2, found, np.ones(len(found), np.int32))
    x = domain.geometry.x
    x[:, 2] += (-0.6 if up else 0.6) * np.abs(x[:, 1 - along]) * (1.0 - np.abs(x[:, 2]))
    x[:, :2] += shift
    return domain, tags


@pytest.mark.parametrize(("depth", "cross"), [(-0.01, False), (0.01, False), (0.12, True)])
def test_facets_that_cross(depth, cross):
    """Those of both sides of either ridge, where these are in each other by more than a bit."""
    ridge = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, -0.6], [1.0, -1.0, -0.6]])
    ridge = np.concatenate([ridge, ridge[2:] * [1.0, -1.0, 1.0]]) - [0.5, 0.0, 0.0]
    facets = np.array([[0, 1, 2], [1, 3, 2], [0, 4, 1], [1, 4, 5]])
    other = ridge[:, [1, 0, 2]] * [1.0, 1.0, -1.0] - [0.0, 0.0, depth]
    found = crossing((ridge, other), (facets, facets))
    assert bool(len(found[2])) == cross
    assert found[2].max(initial=0.0) <= 3.0 * abs(depth)


def test_crossing_ridges_are_told(caplog):
    """Nodes alone touch facets: ridges went into each other, with forces aside."""
    both = roof(True, 0, 0.0), roof(False, 1, 0.13)
    forms, us, bcs = [], [], []
    for k, (domain, _) in enumerate(both):
        V = compat.function_space(domain, shape=(3,))
        u, w = fem.Function(V), ufl.TestFunction(V)
        strain = ufl.sym(ufl.grad(u))
        forms.append(1e3 * ufl.inner(strain, ufl.grad(w)) * ufl.dx)
        at = mesh.locate_entities_boundary(
            domain, 2, lambda x, k=k: np.isclose(x[2], 2.0 * k - 1.0, atol=1e-6)
        )
        held = np.array([0.0, 0.0, -0.12 * k])
        bcs.append(fem.dirichletbc(held, fem.locate_dofs_topological(V, 2, at), V))
        us.append(u)
    interface = llm.Interface(None, tuple((tags, 1) for _, tags in both), llm.Frictionless())
    problem = llm.NonlinearContactProblem(forms, us, bcs=bcs, interfaces=[interface])
    problem.solve()
    assert "edges meet between their nodes" in caplog.text
