"""Prescribed mean displacements of surfaces: what moves them is a uniform traction.

As a script it prints what several ranks find at finite deformation.
"""

import json

import numpy as np
import pytest
import ufl
from conftest import run_mpi_json
from contact_scenes import ABOVE, hold_all, rectangle
from dolfinx import fem, mesh
from mpi4py import MPI
from sampling import longer
from upright_blocks import FOOT, TOP, block

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM, E = MPI.COMM_SELF, 200.0


def console(gdim, traction, mean=None, order=1, form="auto"):
    """A column of height 3, held at its foot, loaded or moved at its end: problem and its L."""
    low, high = np.zeros(gdim), np.ones(gdim)
    high[-1] = 3.0
    if gdim == 2:
        domain, tags = rectangle(COMM, (3, 6), low, high, "triangle", 0.2, np.random.default_rng(7))
    else:
        domain = mesh.create_box(COMM, [low, high], [2, 2, 4], mesh.CellType.tetrahedron)
        at = np.sort(mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[2], 3.0)))
        tags = mesh.meshtags(domain, 2, at, np.full(len(at), ABOVE, dtype=np.int32))
    V = compat.function_space(domain, degree=order, shape=(gdim,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    eps = ufl.sym(ufl.grad(u))
    sigma = E * eps + 0.5 * E * ufl.tr(eps) * ufl.Identity(gdim)
    ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
    L = ufl.inner(fem.Constant(domain, tuple(traction)), w) * ds(ABOVE)
    a = ufl.inner(sigma, ufl.grad(w)) * ufl.dx
    bcs = hold_all(V, lambda p: p[gdim - 1] < 1e-9, lambda p: 0.0 * p)
    if mean is not None:
        side = llm.Interface(tags, (ABOVE, llm.MeanDisplacement(mean)), law=llm.Tied())
        return llm.ContactProblem(a, L, bcs=bcs, interfaces=side, solver=form), ds
    A = compat.assemble_matrix(compat.form("a", a), bcs, 1.0)
    fixed = compat.prescribed_values(V, bcs)
    b = compat.assemble_force([compat.form("L", L)], [1.0], V)
    found = fem.Function(V)
    found.x.array[:] = np.linalg.solve(A[:, :], np.where(np.isnan(fixed), b, fixed))
    return found, ds


@pytest.mark.parametrize(
    ("gdim", "order"), [(2, 1), (2, 2), pytest.param(3, 1, marks=pytest.mark.long)]
)
def test_uniform_traction(gdim, order):
    """The mean that a uniform traction makes, prescribed, takes that traction; free components keep
    their load."""
    zeros = np.zeros(gdim)
    traction = np.array([0.3, -2.0] if gdim == 2 else [0.3, 0.1, -2.0])
    u, ds = console(gdim, traction, order=order)
    mean = [fem.assemble_scalar(fem.form(u[k] * ds(ABOVE))) for k in range(gdim)]
    problem, _ = console(gdim, zeros, mean, order)
    expected = u.x.array
    np.testing.assert_allclose(problem.solve().x.array, expected, atol=1e-12)
    assert "rigid" not in str(problem)  # the surface deforms
    np.testing.assert_allclose(problem.results[0].resultant, -traction, atol=1e-10)
    np.testing.assert_allclose(problem.results[0].displacement, mean, atol=1e-13)
    pressed = problem.results[0].sides[0].normal_force.sum()  # at nodes amid edges as well
    assert pressed == pytest.approx(-traction[-1], abs=1e-10)
    along = [None] * (gdim - 1) + [mean[-1]]
    aside = np.array([*traction[:-1], 0.0])
    problem, _ = console(gdim, aside, along, order, "condensed")
    np.testing.assert_allclose(problem.solve().x.array, expected, atol=1e-12)
    np.testing.assert_allclose(problem.results[0].displacement, mean, atol=1e-13)
    problem.interfaces[0].obstacle.mean = [None] * (gdim - 1) + [2.0 * mean[-1]]
    problem.solve()
    assert problem.results[0].displacement[-1] == pytest.approx(2.0 * mean[-1], abs=1e-13)


def moved(kind, degree, solver, traction, mean=None, comm=COMM):
    """A neo-Hookean block held at its foot, its top under a traction as drawn, or moved in the
    mean."""
    domain, tags, V, u, F = block(kind, 4, degree, comm)
    gdim = domain.geometry.dim
    ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
    F -= ufl.inner(fem.Constant(domain, tuple(traction)), ufl.TestFunction(V)) * ds(TOP)
    foot = fem.locate_dofs_topological(V, gdim - 1, tags.indices[tags.values == FOOT])
    bcs = [fem.dirichletbc(fem.Function(V), foot)]
    sides = []
    if mean is not None:
        sides = [llm.Interface(tags, (TOP, llm.MeanDisplacement(mean)), law=llm.Tied())]
    problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=sides, solver=solver)
    problem.solve(increments=2)
    return problem, [
        comm.allreduce(fem.assemble_scalar(fem.form(u[k] * ds(TOP)))) for k in range(gdim)
    ]


@pytest.mark.parametrize(
    ("kind", "degree", "solver"),
    [
        ("quad", 1, "saddle"),
        ("quad", 2, "condensed"),
        ("tet", 1, "condensed"),
        longer("quad", 2, "saddle"),
        longer("tet", 2, "saddle"),
        longer("tet", 2, "condensed"),
    ],
)
def test_at_finite_deformation(kind, degree, solver, caplog):
    """As at small strains, where a block is pressed by 5 % and pushed aside by 10 % of its height;
    with all components prescribed, or the last one alone."""
    traction = np.array([50.0, -75.0] if kind == "quad" else [40.0, 20.0, -75.0])
    loaded, mean = moved(kind, degree, "saddle", traction)
    assert mean[-1] < -0.05 and mean[0] > 0.08
    for free in (0, len(mean) - 1):
        left = np.where(np.arange(len(mean)) < free, traction, 0.0)
        given = [None] * free + mean[free:]
        problem, found = moved(kind, degree, solver, left, given)
        np.testing.assert_allclose(problem.u.x.array, loaded.u.x.array, atol=1e-10)
        np.testing.assert_allclose(found, mean, atol=1e-11)
        (result,) = problem.results
        np.testing.assert_allclose(result.displacement, mean, atol=1e-11)
        np.testing.assert_allclose(result.resultant, left - traction, atol=1e-7)
    assert "MUMPS instead" not in caplog.text
    problem.interfaces[0].obstacle.mean = [*mean[:-1], mean[-1]]
    with pytest.raises(llm.ContactInputError, match="other components were prescribed"):
        problem.solve()


def test_at_finite_deformation_on_two_ranks():
    problem, found = moved("tet", 1, "condensed", (0.0, 0.0, 0.0), (0.1, None, -0.05))
    two = run_mpi_json(__file__, 2)
    np.testing.assert_allclose(two["mean"], found, atol=1e-11)
    np.testing.assert_allclose(two["resultant"], problem.results[0].resultant, atol=1e-7)


def test_refused():
    for wrong in ((None, None), (1.0,), (1.0, "far"), 3.0):
        with pytest.raises(llm.ContactInputError, match="mean=.*give"):
            llm.MeanDisplacement(wrong)
    with pytest.raises(llm.ContactInputError, match="force=.*not taken"):
        llm.MeanDisplacement((1.0, None), force=(None, 1.0))
    problem, _ = console(2, (0.0, 0.0), (None, 0.1))
    problem.interfaces[0].obstacle.mean = (0.0, 0.1)
    with pytest.raises(llm.ContactInputError, match="other components were prescribed"):
        problem.solve()


if __name__ == "__main__":
    scene = "tet", 1, "condensed", (0.0,) * 3, (0.1, None, -0.05)
    problem, found = moved(*scene, MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        told = {"mean": found, "resultant": problem.results[0].resultant.tolist()}
        print(json.dumps(told))
