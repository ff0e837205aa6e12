"""Second-order bodies whose facets are graded: small where stresses are, large elsewhere."""

import contact_scenes
import numpy as np
import pytest
import ufl
from contact_scenes import ABOVE, BELOW, rectangle
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.design import weights

pytestmark = pytest.mark.quick


def graded(x):
    """Positions whose distances from x = 0 are squared: facets from 1/n² to 2/n."""
    return np.column_stack([np.sign(x[:, 0]) * x[:, 0] ** 2, x[:, 1]])


@pytest.mark.parametrize("cells", [(24, 33), (24, 50), (36, 39), (36, 50), (40, 54), (50, 70)])
def test_linear_pressure_of_graded_facets(cells):
    """Refinement against rounding goes on where a round leaves more than the one before: it was
    given up at patch residuals of 1e-12 to 1e-11, and the bodies refused."""
    ends = ((-1.0, -1.0), (1.0, 0.0)), ((-1.0, 0.0), (1.0, 1.0))
    bodies = [
        rectangle(MPI.COMM_SELF, (n, 2), *end, "quadrilateral", move=graded)
        for n, end in zip(cells, ends, strict=True)
    ]
    a, L, spaces = [], [], []
    for (domain, tags), loaded in zip(bodies, (0.0, 1.0), strict=True):
        V = compat.function_space(domain, degree=2, shape=(2,))
        u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(domain)
        a.append(ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(v)) * ufl.dx)  # E = 1, nu = 0
        top = ufl.ds(domain=domain, subdomain_data=tags)(ABOVE)
        L.append(-fem.Constant(domain, loaded) * (1.0 + 0.8 * x[0]) * v[1] * top)
        spaces.append(V)
    base = contact_scenes.hold_all(spaces[0], lambda p: np.isclose(p[1], -1.0), lambda p: 0.0 * p)
    sides = tuple((tags, tag) for (_, tags), tag in zip(bodies, (ABOVE, BELOW), strict=True))
    problem = llm.ContactProblem(a, L, bcs=base, interfaces=llm.Interface(None, sides))
    found, (result,) = problem.solve(), problem.results
    np.testing.assert_allclose(result.pressure, 1.0 + 0.8 * result.x[:, 0], atol=1e-9)
    for u in found:
        x, y = u.function_space.tabulate_dof_coordinates()[:, :2].T
        exact = np.column_stack([0.4 * (y + 1.0) ** 2, -(1.0 + 0.8 * x) * (y + 1.0)])
        np.testing.assert_allclose(u.x.array.reshape(-1, 2), exact, atol=1e-9)


def test_rounding_is_no_want_of_freedom(monkeypatch):
    """Frames on slivers of facets were refused for patch residuals of 1.4e-13 and 2.5e-13, of
    rounding alone."""
    monkeypatch.setattr(weights, "TOLERANCE", 1e-18)
    frame = llm.Frame([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]], [[0, 1], [1, 2], [2, 3]])
    x = np.array([0.0, 1.5, 3.0]), np.array([0.0, 0.8, 2.0, 3.0])
    forces = np.array([0.75, 1.5, 0.75]) / 3, np.array([0.4, 1.0, 1.1, 0.5]) / 3
    at = [frame.locate(np.column_stack([s, 0.0 * s])) for s in x]
    N, own = [frame.interpolation(a) for a in at], [a.cell for a in at]
    L = weights.design_weights(frame, frame.x[:, :1], N, own, forces)
    assert 0.0 < np.abs(weights.patch_residual(L, forces)).max() <= 1e-15
