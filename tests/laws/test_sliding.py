"""Surfaces that slide and never part: supports across any axis, guides between bodies."""

import numpy as np
import pytest
import ufl
from contact_scenes import ABOVE, BELOW, hold_all, rectangle
from dolfinx import fem
from facing_scenes import turn
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM = MPI.COMM_SELF


def bulk(V):
    """Forms of a linear elastic body without load."""
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    eps = ufl.sym(ufl.grad(u))
    sigma = 100.0 * eps + 40.0 * ufl.tr(eps) * ufl.Identity(2)
    nothing = fem.Constant(V.mesh, (0.0, 0.0))
    return ufl.inner(sigma, ufl.grad(w)) * ufl.dx, ufl.inner(nothing, w) * ufl.dx


@pytest.mark.parametrize("solver", ["saddle", pytest.param("condensed", marks=pytest.mark.long)])
def test_support_across_an_axis(solver):
    """A block that is pulled off a tilted plane: as with the normal component prescribed to be 0,
    where the plane is across an axis."""
    domain, tags = rectangle(
        COMM, (5, 4), (0, 0), (1, 1), "quadrilateral", 0.2, np.random.default_rng(7)
    )
    V, pull = compat.function_space(domain, shape=(2,)), np.array([0.02, 0.05])
    top = fem.locate_dofs_geometrical(V, lambda p: p[1] > 1.0 - 1e-9)
    moved = fem.Function(V)
    moved.x.array.reshape(-1, 2)[top] = pull
    bottom = fem.locate_dofs_topological(V.sub(1), 1, tags.indices[tags.values == BELOW])
    held = fem.dirichletbc(0.0, bottom, V.sub(1))
    a, L = bulk(V)
    A = compat.assemble_matrix(compat.form("a", a), [held, fem.dirichletbc(moved, top)], 1.0)
    b = A.createVecLeft()
    fixed = compat.prescribed_values(V, [held, fem.dirichletbc(moved, top)])
    K = compat.assemble_matrix(compat.form("a", a), [], 1.0)
    known, f = A.createVecLeft(), A.createVecLeft()
    known.array_w[:] = np.nan_to_num(fixed)
    K.mult(known, f)
    b.array_w[:] = np.where(np.isnan(fixed), -f.array_r, fixed)
    expected = np.linalg.solve(A[:, :], b.array_r).reshape(-1, 2)
    R = turn(2, 7)
    domain.geometry.x[:, :2] = domain.geometry.x[:, :2] @ R.T
    moved.x.array.reshape(-1, 2)[top] = R @ pull
    plane = llm.RigidPlane((0.0, 0.0), tuple(R @ (0.0, 1.0)))
    support = llm.Interface(tags, (BELOW, plane), law=llm.Sliding())
    problem = llm.ContactProblem(
        a, L, bcs=[fem.dirichletbc(moved, top)], interfaces=support, solver=solver
    )
    found = problem.solve().x.array.reshape(-1, 2) @ R
    np.testing.assert_allclose(found, expected, atol=1e-13)
    side = problem.results[0].sides[0]
    assert side.normal_force.max() < 0.0 and np.abs(side.tangential_force).max() < 1e-12


def test_guide_between_bodies():
    """One body is pulled off the other and aside, across meshes that do not match: a constant
    tension passes, and no shear; each slides as a whole."""
    parts = [
        rectangle(COMM, (3, 2), (0, 0), (1, 1), "quadrilateral"),
        rectangle(COMM, (4, 2), (0, 1), (1, 2), "triangle"),
    ]
    spaces = [compat.function_space(d, shape=(2,)) for d, _ in parts]
    forms = [bulk(V) for V in spaces]
    bcs = hold_all(spaces[0], lambda p: p[1] < 1e-9, lambda p: 0.0 * p)
    up = lambda p: np.stack([0.0 * p[0] + 0.3, 0.0 * p[0] + 0.02])  # noqa: E731
    bcs += hold_all(spaces[1], lambda p: p[1] > 2.0 - 1e-9, up)
    eps = [ufl.sym(ufl.grad(ufl.TrialFunction(V))) for V in spaces]
    forms = [
        (ufl.inner(100.0 * e, ufl.grad(ufl.TestFunction(V))) * ufl.dx, L)
        for e, V, (_, L) in zip(eps, spaces, forms, strict=True)
    ]  # no Poisson's effect
    sides = (parts[0][1], ABOVE), (parts[1][1], BELOW)
    problem = llm.ContactProblem(
        [a for a, _ in forms],
        [L for _, L in forms],
        bcs=bcs,
        interfaces=llm.Interface(None, sides, law=llm.Sliding()),
    )
    low, high = problem.solve()
    x = spaces[1].tabulate_dof_coordinates()
    expected = np.column_stack([np.full(len(x), 0.3), 0.01 * x[:, 1]])
    np.testing.assert_allclose(high.x.array.reshape(-1, 2), expected, atol=1e-13)
    assert np.abs(low.x.array.reshape(-1, 2)[:, 0]).max() < 1e-13
    assert problem.results[0].pressure == pytest.approx(-1.0, abs=1e-11)
