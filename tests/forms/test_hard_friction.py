"""Friction from stick to gross slip in the condensed form on hard data: forces as by flexibility,
and how many iterations they take (the table of ``limits.md``)."""

import numpy as np
import pytest
import stiff_cases
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

CASES = [  # what is hard, law iterations of three load steps, GMRES's, at most
    ({}, 14, 80),
    ({"ratio": 1e-6}, 24, 250),
    ({"ratio": 1e-3}, 23, 95),
    ({"ratio": 1e3}, 24, 120),
    ({"ratio": 1e6}, 26, 165),
    ({"nu": 0.49}, 22, 330),
    ({"nu": 0.4999}, 24, 3400),
    ({"aspect": 0.01}, 12, 210),
    ({"bend": 0.9}, 14, 140),
]


def blocks(n, ratio=1.0, nu=0.3, aspect=1.0, bend=0.2):
    """Mesh of two blocks of about n and 1.3 n cells a side, tags of the surfaces that touch, and
    the form of the bodies; ``bend`` grades the cells, up to 1."""
    m = round(1.3 * n)
    x0, cells0 = stiff_cases.block([stiff_cases.grid(n, bend=bend)] * 2, 0.0, aspect, n)
    x1, cells1 = stiff_cases.block([stiff_cases.grid(m, bend=-bend)] * 2, aspect, aspect, n)
    x, cells = np.concatenate([x0, x1]), np.concatenate([cells0, cells1 + len(x0)])
    domain = compat.create_mesh(MPI.COMM_SELF, cells, x, "hexahedron")
    facets = stiff_cases.facets_at(domain, aspect)
    domain.topology.create_connectivity(2, 3)
    to_cell = domain.topology.connectivity(2, 3)
    middle = domain.geometry.x[compat.cell_dofs(domain.geometry)].mean(axis=1)[:, 2]
    upper = middle[to_cell.array[to_cell.offsets[facets]]] > aspect
    tags = mesh.meshtags(domain, 2, facets, np.where(upper, 2, 1).astype(np.int32))
    V = compat.function_space(domain, shape=(3,))
    E = fem.Function(compat.function_space(domain, "DG", 0))
    E.interpolate(lambda p: np.where(p[2] > aspect, ratio, 1.0))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    mu, lam = E / (2 * (1 + nu)), E * nu / (1 + nu) / (1 - 2 * nu)
    strain = ufl.sym(ufl.grad(u))
    stress = 2 * mu * strain + lam * ufl.tr(strain) * ufl.Identity(3)
    return V, tags, ufl.inner(stress, ufl.grad(w)) * ufl.dx


def dragged(V, tags, a, height, solver, options):
    """Forces at the end, law iterations of three load steps together, and the problem."""
    w = ufl.TestFunction(V)
    low, top = (
        fem.locate_dofs_geometrical(V, lambda x, z=z: np.isclose(x[2], z))
        for z in (0.0, 2.0 * height)
    )
    moved, across = fem.Function(V), V.tabulate_dof_coordinates()[top, 0] - 0.5
    problem = llm.ContactProblem(
        a, fem.Constant(V.mesh, 0.0) * w[0] * ufl.dx,
        bcs=[fem.dirichletbc(np.zeros(3), low, V), fem.dirichletbc(moved, top)],
        interfaces=[llm.Interface(tags, (1, 2), law=llm.Coulomb(0.3))],
        solver=solver, petsc_options=options,
    )  # fmt: skip
    taken = 0
    for k, along in enumerate((0.0, 0.004, 0.03)):
        values = moved.x.array.reshape(-1, 3)
        values[top, 0] = along * height
        values[top, 2] = height * (-0.02 + 0.01 * k * across)
        problem.solve()
        taken += len(problem.history)
    return np.concatenate([side.force for side in problem.results[0].sides]), taken, problem


@pytest.mark.long
@pytest.mark.parametrize(("data", "laws", "krylov"), CASES)
def test_hard_data(data, laws, krylov):
    V, tags, a = blocks(5, **data)
    height = data.get("aspect", 1.0)
    known, _, by = dragged(V, tags, a, height, "auto", None)
    assert by.form == "flexibility" and by.history[-1]["slip"] > 0
    found, taken, problem = dragged(V, tags, a, height, "condensed", {"pc_type": "gamg"})
    kept = problem.method.form.friction
    assert np.abs(found - known).max() <= 1e-8 * np.abs(known).max()
    assert taken <= laws
    assert not kept.notes and kept.iterations <= krylov


@pytest.mark.parametrize(
    ("data", "laws", "most"), [({"ratio": 1e-6}, 24, 1e-12), ({"aspect": 100.0}, 30, 1e-8)]
)
def test_factorised(data, laws, most):
    """A stiff body's stiffness times displacement lost the digits of a soft one's forces: 295 law
    iterations, and forces off by 1e-2, without a word. Towers of 100 times their width, which a
    force of 1e-11 bends, were bent by what held the frames' nodes beside contact."""
    V, tags, a = blocks(4, **data)
    height = data.get("aspect", 1.0)
    known, _, by = dragged(V, tags, a, height, "auto", None)
    assert by.form == "flexibility" and by.history[-1]["slip"] > 0
    found, taken, _ = dragged(V, tags, a, height, "condensed", {"pc_type": "lu"})
    assert np.abs(found - known).max() <= most * np.abs(known).max()
    assert taken <= laws


@pytest.mark.parametrize(("data", "most"), [({"ratio": 1e9}, 1e-5), ({"aspect": 300.0}, 1e-5)])
def test_amplified_rounding_is_said(data, most):
    """By how much forms differ: 1e-6 and 1e-7 of the forces, and nothing was said."""
    V, tags, a = blocks(3, **data)
    height = data.get("aspect", 1.0)
    ways = ("auto", None), ("condensed", {"pc_type": "lu"})
    found = [dragged(V, tags, a, height, *way) for way in ways]
    difference = np.abs(found[0][0] - found[1][0]).max() / np.abs(found[0][0]).max()
    for _, _, problem in found:
        verdict = problem.method.iteration.verdict
        assert difference <= 10.0 * verdict.felt <= 10.0 * most
        assert "contact forces may be off" in str(problem)
