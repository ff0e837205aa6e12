"""One tag for all tops of a stack, one for all undersides: each part meets the one across it."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from finite_patch import lame, residual
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.finite.frame.location import find_on_frame

LAWS = [llm.Tied(), llm.Frictionless(), llm.Coulomb(0.3)]
TOPS, FEET, LOWEST, HIGHEST = 1, 2, 3, 4
E, NU = 100.0, 0.3


def stack(dim, thin):
    """Three blocks on each other in one mesh, the one in the middle ``thin``; tags of all tops and
    all undersides, tags per pair (10, 20; 11, 21)."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ, low, found = gmsh.model.occ, 0.0, {}
    for k, (high, size) in enumerate(((1.0, 0.34), (thin, 0.22), (1.0, 0.28))):
        made = [occ.addBox(0, 0, low, 1, 1, high)] if dim == 3 else [
            occ.addRectangle(0, low, 0, 1, high)
        ]  # fmt: skip
        occ.synchronize()
        gmsh.model.addPhysicalGroup(dim, made, k + 1)
        gmsh.model.mesh.setSize(gmsh.model.getBoundary([(dim, made[0])], recursive=True), size)
        for _, face in gmsh.model.getBoundary([(dim, made[0])], oriented=False):
            at = occ.getCenterOfMass(dim - 1, face)[dim - 1]
            if np.isclose(at, low):
                found[face] = 19 + k if k else LOWEST
            elif np.isclose(at, low + high):
                found[face] = 10 + k if k < 2 else HIGHEST
        low += high
    for face, tag in found.items():
        gmsh.model.addPhysicalGroup(dim - 1, [face], tag)
    gmsh.model.mesh.generate(dim)
    domain, _, tags = compat.model_to_mesh(gmsh.model, MPI.COMM_SELF, 0, gdim=dim)
    gmsh.finalize()
    return domain, tags


def pressed(dim, thin, law, each, finite=False):
    """Forces that pass each interface and the displacements, pressed evenly by 1 on top; tags of
    ``each`` pair, or of all tops and undersides."""
    domain, tags = stack(dim, thin)
    if each:
        interfaces = [llm.Interface(tags, (10 + k, 20 + k), law=law) for k in (0, 1)]
    else:
        values = tags.values.copy()
        values[np.isin(values, (10, 11))], values[np.isin(values, (20, 21))] = TOPS, FEET
        shared = mesh.meshtags(domain, dim - 1, tags.indices, values)
        interfaces = [llm.Interface(shared, (TOPS, FEET), law=law)]
    V = compat.function_space(domain, shape=(dim,))
    w, bcs = ufl.TestFunction(V), []
    low = fem.locate_dofs_topological(V, dim - 1, tags.find(LOWEST))
    bcs = [fem.dirichletbc(np.zeros(dim), low, V)]
    for a in range(dim - 1):  # no body may glide
        W, _ = V.sub(a).collapse()
        ends = fem.locate_dofs_geometrical((V.sub(a), W), lambda p, a=a: np.isclose(p[a], 0.0))
        bcs.append(fem.dirichletbc(fem.Function(W), ends, V.sub(a)))
    ds = ufl.Measure("ds", domain, subdomain_data=tags)
    load = -w[dim - 1] * ds(HIGHEST)
    if finite:
        u = fem.Function(V)
        F = residual(u, *lame(E, NU), 1) - load
        problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=interfaces)
        problem.solve()
    else:
        v = ufl.TrialFunction(V)
        mu, lam = lame(E, NU)
        strain = ufl.sym(ufl.grad(v))
        stress = 2.0 * mu * strain + lam * ufl.tr(strain) * ufl.Identity(dim)
        a = ufl.inner(stress, ufl.grad(w)) * ufl.dx
        problem = llm.ContactProblem(a, load, bcs=bcs, interfaces=interfaces)
        u = problem.solve()
    forces = [result.resultant[dim - 1] for result in problem.results]
    return sum(forces), u.x.array.copy()


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
@pytest.mark.parametrize(("dim", "thin"), [(2, 0.1), (2, 1.0), (3, 0.3)])
def test_parts_meet_what_is_across(dim, thin, law):
    """As with an interface for each pair: not the top of the lowest block the highest, nor the
    middle one's top its own underside, 100 times the load with more than its height of overlap."""
    force, u = pressed(dim, thin, law, each=True)
    both, same = pressed(dim, thin, law, each=False)
    assert force == pytest.approx(2.0, rel=1e-9) and both == pytest.approx(force, rel=1e-9)
    assert np.abs(same - u).max() < 1e-9 * np.abs(u).max()


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
@pytest.mark.parametrize("thin", [0.3, 1.0])
def test_parts_meet_what_is_across_at_finite_deformation(thin, law):
    """Blocks of other stiffness bulge by other amounts: nodes leave the ends of what they lie on,
    over which other tops lie. The coarser of all tops and all feet carry the frame, of each pair
    perhaps the finer."""
    force, u = pressed(2, thin, law, each=True, finite=True)
    both, same = pressed(2, thin, law, each=False, finite=True)
    assert force == pytest.approx(2.0, rel=1e-9) and both == pytest.approx(force, rel=1e-9)
    assert np.abs(same - u).max() < 1e-3 * np.abs(u).max()


def test_nodes_beyond_the_end_of_a_part():
    """Beside a block on a base, nodes of what lies on both meet the nearer: by the base alone the
    block's edge went into a lid between its nodes by 13 % of a facet, and that bore too little."""
    x, blocks = np.linspace(-1.0, 3.0, 9), np.linspace(0.3, 1.6, 11)
    y = np.concatenate([np.stack([x, 0.0 * x], axis=1), np.stack([blocks, 0.3 + 0.0 * blocks], 1)])
    facets = np.stack([np.arange(len(y) - 1), np.arange(1, len(y))], axis=1)
    facets = np.delete(facets, len(x) - 1, axis=0)
    nodes = np.array([[0.229, 0.299], [0.05, 0.29], [-0.2, 0.31], [0.27, 0.01], [1.0, 0.305]])
    at = find_on_frame(nodes, y, facets, np.tile([0.0, 1.0], (len(y), 1)))
    assert (at.facet >= len(x) - 1).tolist() == [True, True, False, False, True]
    assert np.allclose(at.gap, [-0.001, -0.01, 0.31, 0.01, 0.005], rtol=0.0, atol=1e-12)
