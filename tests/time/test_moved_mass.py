"""Mass that is taken off surfaces stays with its body."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
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
    factor, _ = moved_mass(V, fem.Constant(domain, 3.0), [(tags, 1)])
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


def box(n):
    """A cube of tetrahedra, n cells across, tagged all round."""
    domain = mesh.create_unit_cube(MPI.COMM_SELF, n, n, n, mesh.CellType.tetrahedron)
    facets = np.sort(mesh.locate_entities_boundary(domain, 2, lambda p: p[0] > -1.0))
    return domain, mesh.meshtags(domain, 2, facets, np.ones(len(facets), dtype=np.int32))


def test_moments_of_inertia_of_few_tetrahedra():
    """A polynomial left 0.6 of them: without negative densities it could not bring more."""
    domain, tags = box(8)
    factor, ratio = moved_mass(compat.function_space(domain, shape=(3,)), 1.0, [(tags, 1)])
    assert 0.0 < factor.x.array[factor.x.array > 0.0].min() and np.ptp(ratio) <= 1e-12
    x = ufl.SpatialCoordinate(domain) - ufl.as_vector([0.5, 0.5, 0.5])
    dx = ufl.dx(domain, degree=2)
    for term, true in ((1.0, 1.0), (x[0], 0.0), (x[0] ** 2, 1 / 12), (x[0] * x[1], 0.0)):
        found = fem.assemble_scalar(fem.form(factor * fem.Constant(domain, 1.0) * term * dx))
        assert abs(found - true) <= 1e-12


@pytest.mark.parametrize("held", [False, True], ids=["free", "held"])
def test_moments_of_inertia_that_are_lost_are_told(caplog, held):
    """Four cells across have none; what supports hold does not turn."""
    domain, tags = box(4)
    V = compat.function_space(domain, shape=(3,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * ufl.dx
    L = ufl.inner(fem.Constant(domain, np.zeros(3)), w) * ufl.dx
    end = fem.locate_dofs_geometrical(V, lambda p: np.isclose(p[2], 1.0))
    bcs = [fem.dirichletbc(np.zeros(3), end, V)] if held else []
    plane = llm.RigidPlane((0.0, 0.0, -1.0), (0.0, 0.0, 1.0))
    interface = llm.Interface(tags, (1, plane), law=llm.Frictionless())
    llm.TimeStepper(1.0, a, L, dt=0.01, bcs=bcs, interfaces=interface)
    assert ("moments of inertia of the body about [0.5, 0.5, 0.5]" in caplog.text) != held
