"""Second-order bodies at finite deformation: exact states, orders, forms, ranks."""

import bent_rings
import finite_patch
import hertz2d
import hertz_meshes
import mixed
import numpy as np
import patch2d
import pytest
import second_order_blocks as so
import test_finite_deformation as fd
import ufl
from dolfinx import fem
from mpi4py import MPI
from pressed_scenes import Punch
from sampling import longer
from scipy.sparse.linalg import spsolve
from test_second_order import HEX, QUAD, TET, TRI, Bent, floor, scene, standing

import dolfinx_llm as llm
from dolfinx_llm.geometry.cells import unit
from dolfinx_llm.geometry.loads import NodalLoads
from dolfinx_llm.geometry.surface import extract_surface
from dolfinx_llm.problem import nonlinear_system

COMM = MPI.COMM_SELF


@pytest.mark.long
@pytest.mark.parametrize(
    ("kinds", "order"), [("hex", (0, 1)), ("tet", (1, 0)), (("hex", "tet"), (0, 1))], ids=str
)
def test_finite_patch(kinds, order):
    """A punch on a wider foundation, under pressures that follow all that is free: forces of
    constant pressure vanish at corners of 6-node facets, and are negative on some clipped ones."""
    separate = isinstance(kinds, tuple)
    bodies = patch2d.bodies(COMM, kinds, 1, separate, boxes=finite_patch.BOXES[3])
    problem = finite_patch.problem(bodies, order=order, degree=2)
    problem.solve()
    stretch, pressure = finite_patch.errors(problem, finite_patch.stretches(300.0))
    assert stretch < 1e-10 and pressure < 1e-9
    result = problem.results[0]
    for side in result.sides:  # forces of nodes are those of the area that they stand for
        assert np.abs(side.normal_force - 300.0 * side.area).max() < 1e-9 * 300.0
    assert max(h["iteration"] for h in problem.history) <= 7


def nonlinear(a, L, **chosen):
    """Linear bodies by residual forms."""
    a, L = (form if isinstance(form, list) else [form] for form in (a, L))
    u = [fem.Function(form.arguments()[0].ufl_function_space()) for form in a]
    F = [ufl.action(form, w) - load for form, load, w in zip(a, L, u, strict=True)]
    return llm.NonlinearContactProblem(F, u, **chosen)


def traction_errors(problem, u, field, normal):
    """Per side the relative error of the traction read by the integrals of the shape functions'
    products on the drawing, where the first side has the normal of a function of places."""
    (interface,), found = problem.interfaces, []
    for k, (own, side) in enumerate(
        zip(interface.tagged_sides(), problem.results[0].sides, strict=True)
    ):
        drawn = extract_surface(u[k].function_space, *own)
        loads = NodalLoads.whole(drawn, np.arange(len(drawn.facets)))
        n = normal(drawn.x) * (-1) ** k
        exact = -np.einsum("nij,nj->ni", field.stress(drawn.x), n)
        off = spsolve(loads.mass.tocsc(), side.force) - exact
        weight = loads.forces + 1e-2 * loads.forces.max()
        found.append(np.sqrt((weight @ off**2).sum() / (weight @ exact**2).sum()))
    return found


@pytest.mark.long
def test_curved_ties():
    """A ring in a ring on meshes that do not match, and turned: no worse than on meshes that do;
    tractions of the same order."""

    def found(*scene):
        problem = bent_rings.tied(*scene, make=nonlinear, close_gap=True)
        errors = bent_rings.errors(problem)[:2]
        return *errors, *traction_errors(problem, problem.u, so.Waves(2), unit)

    coarse, fine, matching = (
        np.array(found(*s)) for s in (((16, 24), 0.13), ((32, 48), 0.13), ((32, 32), 0.0))
    )
    assert (np.log2(coarse / fine) >= [2.8, 1.9, 1.8, 1.8]).all()
    assert (fine <= [1.2, 1.2, 1.2, 1.8] * matching).all()


def test_order():
    """Ties of linear bodies with a smooth answer: of third order in displacement, of second in
    stress and traction, and a hundredth of the errors of first order."""

    def found(n, degree):
        spaces, tags = scene((TRI, QUAD), n, degrees=(degree, degree))
        problem = so.manufactured_problem(spaces, tags, field, make=nonlinear)
        u = problem.solve()
        tractions = traction_errors(problem, u, field, up) if degree == 2 else []
        return *so.errors(u, field), *tractions

    def up(x):
        return np.tile([0.0, 1.0], (len(x), 1))

    field = so.Waves(2)

    coarse, fine, first = found((8, 12), 2), found((16, 24), 2), found((16, 24), 1)
    assert (np.log2(np.divide(coarse, fine)) >= [2.9, 1.9, 1.85, 1.9]).all()
    assert (np.divide(first, fine[:2]) >= [100.0, 70.0]).all()


@pytest.mark.parametrize(
    ("kinds", "n"), [((TRI, QUAD), (5, 7)), longer((QUAD, TRI), (4, 6)), longer((TET, HEX), (3, 2)),
                     longer((TET, TET), (2, 3)), longer((HEX, HEX), (3, 4))],
)  # fmt: skip
def test_linear_stress_passes(kinds, n):
    """Ties of linear bodies: pressures that are linear along the surface."""
    spaces, tags = scene(kinds, n)
    field = so.Polynomial(2, spaces[0].mesh.geometry.dim)
    problem = so.manufactured_problem(spaces, tags, field, make=nonlinear)
    assert so.largest_error(problem.solve(), field) <= 1e-10


@pytest.mark.parametrize("kind", ["tri", longer("quad"), longer("tet"), longer("hex")])
def test_forms(kind, monkeypatch):
    """A punch under friction, some of whose nodes stick: the same by GMRES as by MUMPS, in
    equilibrium; no pair pulls, and pressures are none either."""
    found = []
    for limit in (10**9, 0):
        monkeypatch.setattr(nonlinear_system, "FROM_UNKNOWNS", {2: limit, 3: limit})
        punch = Punch(kind, llm.Coulomb(0.3), degree=2)
        found.append((punch.to(down=0.05, along=0.01), punch.problem))
        assert all((h["linear"] > 0) == (limit == 0) for h in punch.problem.history)
    (one, _), (other, _) = found
    for a, b in zip(one.sides, other.sides, strict=True):
        assert np.abs(a.force - b.force).max() < 1e-8 * np.abs(a.force).max()
    assert {1, 2} <= set(one.sides[1].status) and one.pressure.min() >= 0.0
    total = sum(side.force.sum(axis=0) for side in one.sides)
    assert np.abs(total).max() < 1e-10 * np.abs(one.resultant).max()


@pytest.mark.long
@pytest.mark.parametrize("disc", [hertz2d.half_disc, hertz_meshes.disc_of_quads])
def test_hertz(disc, monkeypatch):
    """Pressure at the nodes of both sides, by their own integrals where they are now, under a small
    load: none pulls, and none is off by more than in linear problems."""
    a, p0 = hertz2d.hertz("cylinders", load=0.0025)
    growth = 0.12 if disc is hertz2d.half_disc else 1.2
    monkeypatch.setattr(hertz2d, "half_disc", disc)
    monkeypatch.setattr(llm, "ContactProblem", nonlinear)
    problem = hertz2d.problem("cylinders", (8, 12), load=0.0025, growth=growth, degree=2)
    problem.solve()
    (result,) = problem.results
    sides = [(s.X, np.einsum("ni,ni->n", s.density, s.normal)) for s in result.sides]
    for x, p in (*sides, (result.frame_drawn, result.pressure)):
        x, p = x[:, 0] / a, p / p0
        inner = np.abs(x) < 0.8
        off = p[inner] - np.sqrt(1.0 - x[inner] ** 2)
        assert p.min() >= -1e-12
        assert np.abs(off).max() <= 5.5e-3 and np.sqrt(np.mean(off**2)) <= 2e-3
        assert hertz2d.fit(x[inner], p[inner])[0] == pytest.approx(1.0, abs=1.5e-3)


@pytest.mark.parametrize(("kind", "n", "law"), [
    (TRI, (10, 13), llm.Coulomb(0.3)), (TRI, (10, 13), llm.Tied()),
    (TRI, (10, 13), llm.Frictionless()), (HEX, (4, 5), llm.Tied()),
    longer(HEX, (4, 5), llm.Coulomb(0.3)), longer(HEX, (4, 5), llm.Frictionless()),
], ids=str)  # fmt: skip
def test_tractions_of_facets_that_overhang(kind, n, law):
    """As of linear problems, which tell seven to ten times as much no more either."""
    problem = so.overhanging(kind, n, law, nonlinear)
    problem.solve()
    finer, coarser, told = so.largest_pressures(problem.results[0])
    assert max(coarser, told) <= 1.05 * finer


@pytest.mark.parametrize(("kind", "law"), [(TRI, llm.Frictionless()), (HEX, llm.Coulomb(0.3))])
def test_linear_pressure_on_a_rigid_plane(kind, law, monkeypatch):
    monkeypatch.setattr(llm, "ContactProblem", nonlinear)
    gdim = 2 if kind == TRI else 3
    field = Bent(gdim)
    problem = standing(kind, 4 if gdim == 2 else 2, field, law, floor(gdim))
    problem.solve()
    (result,), exact = problem.results, field.pressure(problem.results[0].sides[0].X)
    assert np.abs(result.pressure - exact).max() <= 1e-9 * exact.max()
    assert np.abs(result.traction).max() <= 1e-9 * exact.max()


def incompressible(cells, law, q, kind="triangle", compliance=0.0, **scene):
    """The patch test on blocks in Taylor and Hood's (u, p): p ln J - p²/2 compliance."""
    domain, tags = fd.blocks(cells, kind=kind, **scene)
    W = mixed.mixed_space(domain, *mixed.TAYLOR_HOOD)
    w, mu, c = fem.Function(W), 1000.0 / 3.0, fem.Constant(domain, compliance)
    u, p = ufl.split(w)
    G = ufl.Identity(2) + ufl.grad(u)
    J = ufl.det(G)
    energy = mu / 2 * (ufl.inner(G, G) - 2) + (p - mu) * ufl.ln(J) - c / 2 * p**2
    F = ufl.derivative(energy * ufl.dx(degree=4), w, ufl.TestFunction(W))
    held = []
    for k, marks in ((1, (fd.BOTTOM,)), (0, (fd.LEFT_0, fd.LEFT_1))):
        V = W.sub(0).sub(k)
        zero = fem.Function(V.collapse()[0])
        facets = tags.indices[np.isin(tags.values, marks)]
        dofs = fem.locate_dofs_topological((V, zero.function_space), 1, facets)
        held.append(fem.dirichletbc(zero, dofs, V))
    loads = [
        llm.FreeSurfacePressure(tags, fd.TOP, q),
        llm.FreeSurfacePressure(tags, fd.LOW, q, covered_by=(tags, fd.HIGH)),
    ]
    interface = llm.Interface(tags, (fd.LOW, fd.HIGH), law=law)
    return llm.NonlinearContactProblem(F, w, bcs=held, interfaces=[interface], loads=loads)


@pytest.mark.parametrize(
    "scene",
    [
        longer({"cells": (5, 3), "law": llm.Frictionless(), "widths": (1.0, 0.61)}),
        longer({"cells": (4, 6), "law": llm.Tied(), "kind": "quadrilateral"}),
        {"cells": (3, 4), "law": llm.Coulomb(0.3), "compliance": 1e-4},
    ],
    ids=str,
)
def test_incompressible(scene):
    """Taylor and Hood's (u, p): a homogeneous state, at ν = 0.5 with stretches a and 1/a,
    μ (a² - 1/a²) = q; p is its pressure."""
    q, mu, compliance = 300.0, 1000.0 / 3.0, scene.get("compliance", 0.0)
    problem = incompressible(q=q, **scene)
    w = problem.solve(increments=2)
    a = np.sqrt(q / mu / 2 + np.sqrt((q / mu / 2) ** 2 + 1.0))
    known = np.array([a, 1.0 / a])
    if compliance:
        poisson = 1.0 / (2.0 + 2.0 * mu * compliance)
        known = np.array(finite_patch.stretches(q, 2.0 * mu * (1.0 + poisson), poisson))
    u, p = w.sub(0).collapse(), w.sub(1).collapse()
    x = u.function_space.tabulate_dof_coordinates()[:, :2]
    assert np.abs(u.x.array.reshape(x.shape) - x * (known - 1.0)).max() < 1e-10
    # No traction at the sides: mu (a² - 1) + p = 0.
    assert np.abs(p.x.array + mu * (known[0] ** 2 - 1.0)).max() < 1e-8 * q
    result = problem.results[0]
    pressed = result.frame_area > 1e-9 * result.frame_area.max()
    assert np.abs(result.pressure[pressed] / q - 1.0).max() < 1e-9
    assert max(h["iteration"] for h in problem.history) <= 7
