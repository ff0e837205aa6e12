"""Mixed spaces, of which one block is a displacement: incompressible bodies, (u, p)."""

import mixed
import numpy as np
import pytest
import second_order_blocks as so
import ufl
from conftest import run_mpi_json
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM = MPI.COMM_SELF
TRI, QUAD, TET, HEX = "triangle", "quadrilateral", "tetrahedron", "hexahedron"


def tied(kinds, n, waves, nu, **chosen):
    """Errors of u, its gradient, p, and of traction on both sides; the problem."""
    gdim = 2 if kinds[0] in (TRI, QUAD) else 3
    spaces, tags = so.blocks(COMM, kinds, n, *mixed.BOXES[gdim])
    field = mixed.Field(gdim, waves)
    problem = mixed.problem(spaces, tags, field, nu, **chosen)
    found = mixed.errors(problem.solve(), field)
    return [*found, *so.traction_errors(problem.results[0], field)], problem


@pytest.mark.parametrize(("kinds", "n", "nu"), [
    ((TRI, TRI), (4, 6), 0.5), ((QUAD, TRI), (4, 3), 0.4999),
    pytest.param((TET, TET), (2, 3), 0.5, marks=pytest.mark.long),
    pytest.param((TET, HEX), (3, 2), 0.4999, marks=pytest.mark.long),
])  # fmt: skip
def test_linear_stress_passes(kinds, n, nu):
    """In Taylor and Hood's spaces, which contain the answer."""
    found, problem = tied(kinds, n, False, nu)
    assert max(found) <= 1e-11
    assert problem.form == "saddle"


def test_values_of_functions_at_surfaces():
    """What laws vary by: on the bodies of two meshes, whose other unknowns lie between them."""
    problem = tied((TRI, QUAD), (3, 4), False, 0.5)[1]
    dofs, geometry = problem.operators.dofs, problem.geometries[0]
    for space, side in zip(geometry.spaces, geometry.sides, strict=True):
        f = fem.Function(compat.function_space(dofs.spaces[space].mesh, degree=2))
        f.interpolate(lambda x: 1.0 + x[0] ** 2 - 2.0 * x[1])
        found = dofs.sampled(f, space, dofs.of(space, side)[:, 0])
        np.testing.assert_allclose(found, 1.0 + side.x[:, 0] ** 2 - 2.0 * side.x[:, 1], atol=1e-12)


def test_pictures_show_the_displacement(tmp_path):
    problem = tied((TRI, TRI), (2, 3), False, 0.5)[1]
    problem.plot(tmp_path)
    assert (tmp_path / "bodies.png").exists()


@pytest.mark.parametrize("nu", [0.5, pytest.param(0.4999, marks=pytest.mark.long)])
def test_third_order_in_displacement_second_in_pressure_and_traction(nu):
    rates = np.log2(np.divide(*(tied((TRI, TRI), n, True, nu)[0] for n in ((8, 12), (16, 24)))))
    assert (rates >= [2.9, 1.95, 1.9, 1.9, 1.9]).all(), rates


@pytest.mark.long
@pytest.mark.parametrize("kind", [TRI, QUAD])
@pytest.mark.parametrize("nu", [0.5, 0.4999])
def test_rates_on_four_meshes(kind, nu):
    """From each to the next, tractions as told and by the integrals of the shape functions alone:
    1.0 to 1.8 from the third to the last, where rows had wider stencils on that mesh alone."""
    errors, field = [], mixed.Field(2, True)
    for n in (8, 16, 32, 64):
        found, problem = tied((kind, kind), (n, 3 * n // 2), True, nu)
        (result,), (geometry,) = problem.results, problem.geometries
        errors.append([*found, *so.traction_errors(result, field, geometry)])
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (rates >= [2.9, 1.95, 1.9, 1.9, 1.9, 1.9, 1.9]).all(), rates


@pytest.mark.parametrize(("law", "solver", "spring"), [
    (llm.Frictionless(), "saddle", 0.0), (llm.Coulomb(0.4), "auto", 0.0),
    (llm.Tied(), "auto", 0.0), (llm.Coulomb(0.4), "saddle", 1.0),
])  # fmt: skip
def test_a_mixed_space_that_is_the_plain_problem(law, solver, spring):
    """Its pressures are linear in each cell, as divergences are; bodies part or slip, and where
    the upper one is on weak springs its pressures belong to its rigid motions as well. So is the
    adjoint, of the square of the displacement."""
    found, products = [], []
    for blocks in (None, (("DG", 1, False), ("Lagrange", 2, True))):
        with mixed.pressed(law, blocks, COMM, solver, spring=spring) as problem:
            u = problem.solve()
            found.append(problem.results[0])
            if not (spring or law.ties):
                continue  # contact alone holds the upper one
            v, part = ufl.TestFunction(u.function_space), (lambda w: w)
            part = part if blocks is None else (lambda w: ufl.split(w)[1])
            p = problem.adjoint(ufl.inner(part(u), part(v)) * ufl.dx)
            products.append(fem.assemble_scalar(fem.form(ufl.inner(part(p), part(u)) * ufl.dx)))
    assert products == pytest.approx(products[::-1], rel=1e-9)
    for sides in zip(*(result.sides for result in found), strict=True):
        assert law.ties or len(set(sides[0].status)) > 1
        for values in ([s.force for s in sides], [s.u for s in sides]):
            assert np.abs(np.subtract(*values)).max() <= 1e-9 * np.abs(values[0]).max()


def test_what_mixed_spaces_are_refused():
    (V,), (own,) = so.blocks(COMM, (TRI, TRI), (2, 3), mixed.BOXES[2][0], mixed.BOXES[2][1])
    interface = llm.Interface(own, (2, 3))

    def problem(*blocks):
        W = mixed.mixed_space(V.mesh, *blocks)
        (u, p), (w, q) = ufl.TrialFunctions(W), ufl.TestFunctions(W)
        a = ufl.inner(u, w) * ufl.dx + ufl.inner(p, q) * ufl.dx
        zero = fem.Constant(V.mesh, np.zeros(W.sub(0).collapse()[0].dofmap.index_map_bs))
        L = ufl.inner(zero, w) * ufl.dx
        return llm.ContactProblem(a, L, interfaces=[interface], solver="condensed")

    vector, two = ("Lagrange", 2, True), ("Lagrange", 1, True)
    with pytest.raises(llm.ContactError, match="positive definite"):
        problem(vector, ("Lagrange", 1, False))
    for blocks, count in (((vector, two), 2), ((("DG", 1, True), ("Lagrange", 1, False)), 0)):
        with pytest.raises(llm.ContactInputError, match=f"{count} of the 2 blocks"):
            problem(*blocks)
    W = mixed.mixed_space(V.mesh, *mixed.TAYLOR_HOOD)
    with pytest.raises(llm.ContactInputError, match="is mixed"):
        llm.find_interfaces(own, W)
    w = fem.Function(W)
    F = ufl.inner(w, ufl.TestFunction(W)) * ufl.dx
    with pytest.raises(llm.ContactInputError, match="positive definite"):
        llm.NonlinearContactProblem(F, w, interfaces=[interface], solver="condensed")


@pytest.mark.long
def test_ranks():
    data = run_mpi_json("mixed_ranks.py", 3)
    assert max(data.values()) <= 1e-9
