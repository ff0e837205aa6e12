"""Flat surfaces whose cells are long, and lie across those of the other side."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

FOOT, SEAT, LOW, HIGH = 1, 2, 3, 4
E, NU, LOAD, MU = 1000.0, 0.3, 5.0, 0.3
CELLS = {"hex": mesh.CellType.hexahedron, "tet": mesh.CellType.tetrahedron}


def block(cells, low, high, half, tags, kind, degree):
    """A box about the z axis, its underside and top tagged; form, space, facet tags."""
    ends = [np.array([-half, -half, low]), np.array([half, half, high])]
    domain = mesh.create_box(MPI.COMM_SELF, ends, [*cells], CELLS[kind])
    V = compat.function_space(domain, degree=degree, shape=(3,))
    at = [
        mesh.locate_entities_boundary(domain, 2, lambda p, z=z: np.isclose(p[2], z))
        for z in (low, high)
    ]
    order = np.argsort(np.concatenate(at))
    values = np.repeat(tags, [len(found) for found in at]).astype(np.int32)
    found = mesh.meshtags(domain, 2, np.concatenate(at)[order], values[order])
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    strain = ufl.sym(ufl.grad(u))
    lam, mu = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
    stress = 2 * mu * strain + lam * ufl.tr(strain) * ufl.Identity(3)
    return ufl.inner(stress, ufl.grad(w)) * ufl.dx, V, found, w


def dragged(upper, lower, law, by, kind="hex", degree=1, half=0.5):
    """Forces along and down on the upper block, which is pressed on the lower, clamped one, and
    moved along it in steps ``by``; and the height of its lowest and highest node in contact."""
    a, V, tags, w = block(upper, 0.0, 0.4, 0.5, (FOOT, HIGH), kind, degree)
    b, W, others, q = block(lower, -0.5, 0.0, half, (LOW, SEAT), kind, degree)
    ds, none = ufl.Measure("ds", V.mesh, subdomain_data=tags), fem.Constant(W.mesh, np.zeros(3))
    L = [-LOAD * w[2] * ds(HIGH), ufl.inner(none, q) * ufl.dx]
    bcs = [fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(W, 2, others.find(LOW)), W)]
    moved = []
    for axis in (0, 1):
        X, _ = V.sub(axis).collapse()
        at = fem.locate_dofs_topological((V.sub(axis), X), 2, tags.find(HIGH))
        moved.append(fem.Function(X))
        bcs.append(fem.dirichletbc(moved[-1], at, V.sub(axis)))
    interface = llm.Interface(None, ((tags, FOOT), (others, SEAT)), law=law)
    problem = llm.ContactProblem([a, b], L, bcs=bcs, interfaces=[interface])
    for shift in by:
        moved[0].x.array[:] = shift
        u, _ = problem.solve()
    foot = np.isclose(V.tabulate_dof_coordinates()[:, 2], 0.0)
    heights = u.x.array.reshape(-1, 3)[foot, 2]
    return problem.results[0].sides[0].force.sum(axis=0)[[0, 2]], np.ptp(heights), problem


@pytest.mark.parametrize(
    ("upper", "lower", "kind", "degree"),
    [((12, 3, 1), (3, 12, 1), "hex", 1), ((8, 2, 1), (2, 8, 1), "hex", 2),
     ((12, 3, 1), (3, 12, 1), "tet", 1)],
)  # fmt: skip
def test_friction_across_long_cells(upper, lower, kind, degree, caplog):
    """As stiff to shear as cells of one shape, slip at μ N, and no tilt: a block that was tied by
    rows with corrections of half an entry was three times too soft, and tilted by 0.024."""
    with caplog.at_level("WARNING", "dolfinx_llm"):
        sheared = dragged(upper, lower, llm.Tied(), (0.001,), kind, degree)[0]
    assert "times as fine as one of the sides" in caplog.text
    caplog.clear()
    # Cells are as stiff as their direction makes them, on matching meshes of either kind.
    tied = llm.Tied(), (0.001,), kind, degree
    along = [dragged(cells, cells, *tied)[0][0] for cells in (upper, lower)]
    assert "times as fine" not in caplog.text
    assert 0.95 * min(along) < sheared[0] < 1.05 * max(along)
    steps = llm.Coulomb(MU), (0.0, 0.001, 0.02), kind, degree
    force, tilt, _ = dragged(upper, lower, *steps)
    assert np.abs(force) == pytest.approx([MU * LOAD, LOAD], rel=2e-3)
    assert tilt < 1.5 * dragged((6, 6, 1), (5, 5, 1), *steps)[1]


def test_a_constant_pressure_passes():
    """Pressed without friction or shear: exactly, however long the cells are."""
    for upper, lower, half in (((12, 3, 1), (3, 12, 1), 0.5), ((10, 2, 1), (2, 10, 1), 0.7)):
        _, _, problem = dragged(upper, lower, llm.Frictionless(), (0.0,), half=half)
        assert problem.results[0].certificate.residual < 1e-13
        assert problem.results[0].certificate.largest_correction < 0.3
