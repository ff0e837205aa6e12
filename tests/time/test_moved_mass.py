"""Mass that is taken off surfaces stays with its body."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_llm import compat
from dolfinx_llm.time.inertia import moved_mass

pytestmark = pytest.mark.quick


def test_moments_are_kept_and_one_form_is_compiled(monkeypatch):
    """Moments up to second degree, of cells of which some are 31 times as long as others, far from
    the origin; to compile a form takes longer than all else of a first run."""
    corners, cell = [[0.0, 0.0], [1.0, 1.0]], mesh.CellType.quadrilateral
    domain = mesh.create_rectangle(MPI.COMM_SELF, corners, [16, 16], cell)
    facets = mesh.locate_entities_boundary(domain, 1, lambda p: np.isclose(p[1], 1.0))
    tags = mesh.meshtags(domain, 1, np.sort(facets), np.ones(len(facets), dtype=np.int32))
    x = domain.geometry.x
    x[:, :2] = 5.0 * x[:, :2] ** 2 @ [[0.8, 0.6], [-0.6, 0.8]] + 70.0
    V = compat.function_space(domain, shape=(2,))
    made, compiled = [], compat.form
    monkeypatch.setattr(compat, "form", lambda *form: made.append(form) or compiled(*form))
    factor = moved_mass(V, fem.Constant(domain, 3.0), [(tags, 1)])
    assert len(made) == 1
    assert (factor.x.array == 0.0).sum() == 16  # next to the surface
    s = (ufl.SpatialCoordinate(domain) - ufl.as_vector([70.0, 74.0])) / 5.0
    terms = 1.0, s[0], s[1], s[0] ** 2, s[0] * s[1], s[1] ** 2
    chosen = [fem.Constant(domain, 0.0) for _ in terms]
    form = sum(c * (factor - 1.0) * term for c, term in zip(chosen, terms, strict=True))
    form = fem.form(form * ufl.dx)
    for c in chosen:
        c.value = 1.0
        assert abs(fem.assemble_scalar(form)) <= 1e-12 * 25.0
        c.value = 0.0
