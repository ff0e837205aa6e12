"""A quarter of a press fit in plane strain, against Lamé: corners of the interface, where planes of
symmetry meet, lie across the overlap from each other. Forces there were up to 1e5 times larger."""

import bent_rings
import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI
from sampling import drawn, longer

import dolfinx_llm as llm
from dolfinx_llm import compat

pytestmark = pytest.mark.quick
E, NU, R, OVERLAP = 1000.0, 0.3, 2.0, 1e-3
LAME = E / (1 - NU**2) * OVERLAP / R * (9 - R**2) * (R**2 - 1) / (2 * R**2 * (9 - 1))
HEX, TET = dmesh.CellType.hexahedron, dmesh.CellType.tetrahedron


def elastic(V):
    """Forms without loads."""
    gdim, u, v = V.mesh.geometry.dim, ufl.TrialFunction(V), ufl.TestFunction(V)
    strain = ufl.sym(ufl.grad(u))
    sigma = E / (1 + NU) * (strain + NU / (1 - 2 * NU) * ufl.tr(strain) * ufl.Identity(gdim))
    none = fem.Constant(V.mesh, (0.0,) * gdim)
    return ufl.inner(sigma, ufl.grad(v)) * ufl.dx, ufl.inner(none, v) * ufl.dx


def tube(radii, cells, ends, kind, slides):
    """A quarter: forms, tags 1 and 2 of the inner and outer face, 3 of the plane x = 0, which holds
    it unless it slides, and conditions."""
    corners = [(radii[0], 0.0, ends[0]), (radii[1], np.pi / 2, ends[1])]
    domain = dmesh.create_box(MPI.COMM_SELF, corners, cells, kind)
    at = [(0, radii[0]), (0, radii[1]), (1, np.pi / 2), (1, 0.0), (2, ends[0]), (2, ends[1])]
    faces = [
        dmesh.locate_entities_boundary(domain, 2, lambda x, k=k, c=c: np.isclose(x[k], c))
        for k, c in at
    ]
    marked = np.concatenate(faces[:3])
    values = np.repeat(np.arange(1, 4), [len(f) for f in faces[:3]]).astype(np.int32)
    order = np.argsort(marked)
    tags = dmesh.meshtags(domain, 2, marked[order], values[order])
    r, t = domain.geometry.x[:, 0].copy(), domain.geometry.x[:, 1].copy()
    domain.geometry.x[:, 0], domain.geometry.x[:, 1] = r * np.cos(t), r * np.sin(t)
    V = compat.function_space(domain, shape=(3,))
    a, L = elastic(V)
    held = [(1, 3), (2, 4), (2, 5)] + ([] if slides else [(0, 2)])
    bcs = [
        fem.dirichletbc(
            fem.Constant(domain, 0.0),
            fem.locate_dofs_topological(V.sub(i), 2, faces[k]),
            V.sub(i),
        )
        for i, k in held
    ]
    return a, L, tags, bcs


def fit(law, kind=HEX, height=0.5, off=0.0, slides=False, swapped=False, solver="auto"):
    """Result of a fit whose outer ring ends ``off`` away from the inner one, and its history."""
    inner = tube((1.0, R + OVERLAP), (3, 8, 2), (0.0, height), kind, slides)
    outer = tube((R, 3.0), (3, 10, 3), (off, height - off), kind, slides)
    a, L, tags, bcs = zip(inner, outer, strict=True)
    sides = ((tags[0], 2), (tags[1], 1))
    interfaces = [llm.Interface(None, sides[::-1] if swapped else sides, law=law)]
    if slides:
        plane = llm.RigidPlane((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
        interfaces += [llm.Interface(own, (3, plane), law=llm.Sliding()) for own in tags]
    options = dict(bcs=bcs[0] + bcs[1], interfaces=interfaces, solver=solver)
    with llm.ContactProblem(a, L, **options) as problem:
        problem.solve()
        return problem.results[0], len(problem.history)


def check(result, height, swapped, share):
    """Resultant, and nodal forces no larger than normal ones by much."""
    of_inner = -result.resultant if swapped else result.resultant
    assert np.abs(of_inner[:2] / (LAME * R * height) - 1.0).max() < share
    for side in result.sides:
        assert np.linalg.norm(side.force, axis=1).max() < 1.1 * side.normal_force.max()


@pytest.mark.parametrize(
    ("kind", "off", "swapped"), drawn((HEX, TET), (0.0, 3e-4, -3e-4), (False, True))
)
def test_tied(kind, off, swapped):
    """Ends that are drawn apart, and held there, are not closed."""
    result, _ = fit(llm.Tied(close_gap=True), kind, off=off, swapped=swapped)
    check(result, 0.5, swapped, 0.05)
    shear = [np.linalg.norm(s.tangential_force, axis=1).sum() for s in result.sides]
    assert max(shear) < 0.1 * sum(result.sides[0].normal_force)
    if kind == HEX:
        assert np.abs(result.pressure / LAME - 1.0).max() < 0.03


def test_tied_slice():
    """The outline's other side is nearer than the next node along it."""
    result, _ = fit(llm.Tied(close_gap=True), height=0.05)
    check(result, 0.05, False, 0.05)


@pytest.mark.parametrize(
    ("kind", "solver"),
    [(HEX, "saddle"), longer(HEX, "condensed"), longer(TET, "saddle"), (TET, "condensed")],
)
def test_friction_beside_a_plane(kind, solver):
    """Friction at nodes that a frictionless plane has, too, in as many iterations as elsewhere."""
    result, iterations = fit(llm.Coulomb(0.2), kind, slides=True, solver=solver)
    check(result, 0.5, False, 0.05)
    for side in result.sides:
        shear = np.linalg.norm(side.tangential_force, axis=1)
        assert shear.sum() < 0.2 * side.normal_force.sum()
    assert iterations <= 12


@pytest.mark.parametrize("kind", [longer(TET), HEX])
def test_ties_beside_a_plane(kind):
    """Planes of symmetry that bodies slide on bear what supports there would: at nodes that they
    share the tie bears what it bears beside. It was told a fifth of the resultant less."""
    held, _ = fit(llm.Tied(close_gap=True), kind)
    for swapped in (False, True):
        slid, _ = fit(llm.Tied(close_gap=True), kind, slides=True, swapped=swapped)
        for side, other in zip(held.sides, slid.sides[:: -1 if swapped else 1], strict=True):
            off = np.abs(side.force - other.force).max()
            assert off < (1e-4 if kind == HEX else 0.01) * np.abs(side.force).max()


@pytest.mark.parametrize("overlap", [OVERLAP, -0.1])
def test_tied_rings_of_second_order(overlap):
    """Rows at supports reached past them, by 5e-4 across the small overlap, and held frame nodes
    there: the bodies moved by a hundred overlaps."""
    parts = []
    for size, radii, tag in ((0.25, (1.0, R + overlap), 1), (0.2, (R, 3.0), 5)):
        domain, tags = bent_rings.bricks(size, *radii, tag, gdim=2)
        V = compat.function_space(domain, degree=2, shape=(2,))
        a, L = elastic(V)
        bcs = []
        for i in range(2):
            facets = dmesh.locate_entities_boundary(domain, 1, lambda x, i=i: np.isclose(x[i], 0.0))
            dofs = fem.locate_dofs_topological(V.sub(i), 1, facets)
            bcs.append(fem.dirichletbc(fem.Constant(domain, 0.0), dofs, V.sub(i)))
        parts.append((a, L, tags, bcs))
    a, L, tags, bcs = zip(*parts, strict=True)
    tie = llm.Interface(None, ((tags[0], 2), (tags[1], 5)), law=llm.Tied(close_gap=True))
    with llm.ContactProblem(a, L, bcs=bcs[0] + bcs[1], interfaces=[tie]) as problem:
        problem.solve()
        result = problem.results[0]
    assert np.abs(result.resultant * OVERLAP / overlap / LAME / R - 1.0).max() < 0.03
    for side in result.sides:
        assert np.abs(side.force).max() < 1.1 * np.abs(side.normal_force).max()
