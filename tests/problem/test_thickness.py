"""Bodies in the plane with a thickness, and axisymmetric ones, whose thickness is 2 pi r."""

import numpy as np
import pytest
import ufl
from around_axis import (
    LOWER,
    OUTER,
    TOP,
    UPPER,
    Cylinders,
    around,
    ball_in_shell,
    block,
    gradient,
    lame,
)
from conftest import run_mpi_json
from dolfinx import fem
from mpi4py import MPI
from sampling import longer
from scenes import two_blocks

import dolfinx_llm as llm
from dolfinx_llm.interface.build import build_interface

COMM = MPI.COMM_SELF
LAWS = llm.Frictionless(), longer(llm.Tied()), longer(llm.Coulomb(0.3))


def even(problem, p):
    """Largest error of the pressure at frame nodes that are covered, and of the traction."""
    result = problem.results[0]
    on = result.frame_area > 1e-9 * result.frame_area.max()
    return max(np.abs(result.pressure[on] - p).max(), np.abs(result.traction[on]).max()) / p


@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize("solver", ["saddle", longer("condensed")])
@pytest.mark.parametrize(("cell", "degree"), [
    ("quadrilateral", 1), ("triangle", 2), longer("triangle", 1), longer("quadrilateral", 2),
])  # fmt: skip
@pytest.mark.parametrize(("upper", "bore"), [(1.0, 0.0), (0.6, 0.0), longer(1.0, 0.5)])
def test_a_constant_pressure_passes_around_an_axis(upper, bore, cell, degree, solver, law):
    """Also where the upper cylinder covers a part, and at the axis, where nodes bear least."""
    scene = Cylinders(COMM, (4, 3), upper, bore, cell, degree)
    problem, stretch = scene.linear(law, solver=solver)
    assert scene.off(problem.solve(), stretch) <= 1e-10 * 2e-3
    assert even(problem, 1.0) <= 1e-9
    ends = bore, bore + upper
    assert problem.results[0].frame_area.sum() == pytest.approx(
        np.pi * (ends[1] ** 2 - ends[0] ** 2)
    )
    problem.destroy()


@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize(("cell", "degree"), [
    ("quadrilateral", 1), ("triangle", 2), longer("triangle", 1), longer("quadrilateral", 2),
])  # fmt: skip
@pytest.mark.parametrize(("upper", "n"), [(0.6, (4, 3)), longer(1.0, (5, 7))])
def test_finite_patch_around_an_axis(upper, n, cell, degree, law):
    """Stretches of 1.14 and 0.72, follower pressure on what is free; four iterations a step."""
    scene = Cylinders(COMM, n, upper, 0.0, cell, degree)
    problem, stretch = scene.finite(law)
    for part in (0.25, 0.5, 0.75, 1.0):
        for load in scene.load:
            load.value = 300.0 * part
        problem.solve()
        assert problem.history[-1]["iteration"] <= 5
    assert scene.off(problem.u, stretch) <= 1e-10
    assert even(problem, 300.0) <= 1e-9
    result = problem.results[0]
    force = 300.0 * np.pi * (upper * stretch[0]) ** 2
    assert abs(result.resultant[1]) == pytest.approx(force, rel=1e-10)
    problem.destroy()


@pytest.mark.parametrize("kind", ["linear", "finite"])
def test_a_sheet_of_any_thickness(kind):
    """Forms over ten times the thickness, and the thickness given, have the same pressures and ten
    times the force; with a cohesion, which is one per area, all of it."""
    found = []
    for factor in (1.0, 10.0):
        low, high = (block(COMM, n, *ends, tags) for n, ends, tags in (
            (4, ((0.0, 0.0), (1.0, 1.0)), (1, LOWER, OUTER)),
            (3, ((0.2, 1.0), (0.9, 2.0)), (UPPER, TOP, OUTER))))  # fmt: skip
        found.append(sheet(kind, (low, high), factor))
    one, ten = found
    np.testing.assert_allclose(ten[0], one[0], rtol=1e-8, atol=1e-8 * np.abs(one[0]).max())
    np.testing.assert_allclose(ten[1], 10.0 * one[1], rtol=1e-8)
    assert np.ptp(one[0]) > 0.1 * np.abs(one[0]).max() > 0.0


def sheet(kind, built, factor):
    """Pressures and resultant of blocks pressed and dragged by their top."""
    mu, lam = lame(1000.0, 0.3)
    (V, _), (W, _) = built
    forms, loads, u = [], [], [fem.Function(space) for space in (V, W)]
    for space, w in zip((V, W), u, strict=True):
        trial, test = ufl.TrialFunction(space), ufl.TestFunction(space)
        e = ufl.sym(ufl.grad(trial if kind == "linear" else w))
        sigma = 2 * mu * e + lam * ufl.tr(e) * ufl.Identity(2)
        forms.append(factor * ufl.inner(sigma, ufl.grad(test)) * ufl.dx)
        zero = fem.Constant(space.mesh, (0.0, 0.0))
        loads.append(ufl.inner(zero, test) * ufl.dx)
    top = fem.Function(W)
    top.interpolate(lambda x: np.stack([0.004 + 0 * x[0], -0.02 + 0 * x[0]]))
    at = [fem.locate_dofs_geometrical(space, lambda x, z=z: np.isclose(x[1], z))
          for space, z in ((V, 0.0), (W, 2.0))]  # fmt: skip
    bcs = [fem.dirichletbc(fem.Function(V), at[0]), fem.dirichletbc(top, at[1])]
    law = llm.Coulomb(0.2, cohesion=0.5)
    sides = tuple((tags, tag) for (_, tags), tag in zip(built, (LOWER, UPPER), strict=True))
    chosen = {"bcs": bcs, "interfaces": [llm.Interface(None, sides, law=law, thickness=factor)]}
    if kind == "linear":
        problem = llm.ContactProblem(forms, loads, **chosen)
    else:
        problem = llm.NonlinearContactProblem(forms, u, **chosen)
    problem.solve()
    result = problem.results[0]
    density = np.concatenate([result.pressure, *result.traction.T])
    return density, result.resultant


@pytest.mark.parametrize("kind", ["linear", "finite"])
def test_on_a_rigid_plane(kind):
    """A cylinder with a bore on a rigid plane: the pressure at its nodes is even, and the mean
    displacement that is asked of its mantle is one by area."""
    E, nu, p = 1000.0, 0.3, 1.0
    mu, lam = lame(E, nu)
    V, tags = block(COMM, 4, (0.5, 0.0), (1.5, 1.0), (LOWER, TOP, OUTER))
    r, u = ufl.SpatialCoordinate(V.mesh)[0], fem.Function(V)
    test = ufl.TestFunction(V)
    of = ufl.TrialFunction(V) if kind == "linear" else u
    e, d = (ufl.sym(gradient(v, r)) for v in (of, test))
    form = ufl.inner(2 * mu * e + lam * ufl.tr(e) * ufl.Identity(3), d)
    form = form * 2 * np.pi * r * ufl.dx(degree=6)
    ds = ufl.Measure("ds", domain=V.mesh, subdomain_data=tags)
    load = -fem.Constant(V.mesh, p) * 2 * np.pi * r * test[1] * ds(TOP, degree=6)
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    mean = llm.MeanDisplacement((nu * p / E * 1.5, None))
    interfaces = [
        llm.Interface(tags, (LOWER, plane), law=llm.Frictionless(), thickness=around),
        llm.Interface(tags, (OUTER, mean), law=llm.Tied(), thickness=around),
    ]
    if kind == "linear":
        problem = llm.ContactProblem(form, load, interfaces=interfaces)
        u = problem.solve()
    else:
        problem = llm.NonlinearContactProblem(form - load, u, interfaces=interfaces)
        problem.solve()
    x = V.tabulate_dof_coordinates()[:, :2]
    exact = x * [nu * p / E, -p / E]
    assert np.abs(u.x.array.reshape(-1, 2) - exact).max() <= 1e-9 * p / E
    result = problem.results[0]
    pressed = result.pressure[result.frame_area > 0.0]
    now = (1.0 + nu * p / E) ** 2 if kind == "finite" else 1.0  # of the area as drawn
    assert np.abs(pressed - p / now).max() <= 1e-8
    assert problem.results[1].resultant == pytest.approx([0.0, 0.0], abs=1e-8)


@pytest.mark.parametrize(("law", "order", "bounds"), [
    (llm.Tied(), 1, [(0.02, 0.03), (0.012, 0.015), (0.005, 0.005)]),
    longer(llm.Frictionless(), 1, [(0.025, 0.04), (0.008, 0.008), (0.003, 0.002)]),
    longer(llm.Tied(), 2, [(2e-3, 0.02), (1e-4, 5e-3), (5e-5, 2e-3)]),
    longer(llm.Frictionless(), 2, [(0.03, 0.2), (5e-3, 0.04), (2e-3, 8e-3)]),
])  # fmt: skip
def test_curved_about_an_axis(law, order, bounds):
    """As good as facets are, also at the poles, where nodes have next to no area."""
    for h, most in zip((0.3, 0.15, 0.075), bounds, strict=True):
        found = ball_in_shell(COMM, (h, h / 1.5), law, order)
        assert (np.array(found) <= most).all(), found


def test_what_is_no_thickness():
    scene = Cylinders(COMM, (2, 3))
    for thickness, words in (
        (0.0, "thickness=0"), (lambda x: x[:, 0] - 2.0, "not positive"),
        (lambda x: np.sin(x[:, 0]) + 1.0, "linear"), (lambda x: x, "of shape"),
        ("1", "thickness='1'"), (float("nan"), "nan"),
        (ufl.SpatialCoordinate(scene.spaces[0].mesh)[0], "or a function of positions"),
    ):  # fmt: skip
        with pytest.raises(llm.ContactInputError, match=words):
            scene.linear(llm.Tied(), thickness=thickness)
    V, tags = two_blocks(COMM)
    with pytest.raises(llm.ContactInputError, match="in the plane"):
        build_interface(llm.Interface(tags, (2, 3), thickness=2.0), [V])


def test_all_of_a_problem_have_a_thickness():
    """A pressure would count by area on one surface and by length on another; 1.0 can be said."""
    scene, law = Cylinders(COMM, (2, 3), bore=0.5), llm.Frictionless()
    a, L, u = [], [], [fem.Function(V) for V in scene.spaces]
    for V in scene.spaces:
        v, r = ufl.TestFunction(V), ufl.SpatialCoordinate(V.mesh)[0]
        e, d = (ufl.sym(gradient(f, r)) for f in (ufl.TrialFunction(V), v))
        a.append(ufl.inner(e, d) * 2 * np.pi * r * ufl.dx(degree=6))
        L.append(ufl.inner(fem.Constant(V.mesh, (0.0, 0.0)), v) * ufl.dx)
    F = [ufl.action(form, w) for form, w in zip(a, u, strict=True)]

    def beside(thickness):
        wall = OUTER, llm.RigidPlane((1.5, 0.0), (-1.0, 0.0))
        wall = llm.Interface(scene.tags[0], wall, law=law, thickness=thickness)
        return {"bcs": scene.bcs, "interfaces": [scene.interface(law), wall]}

    said = r"interfaces\[1\], 13 . RigidPlane, has no thickness, interfaces\[0\], .* 1 of 2"
    for problem, forms in ((llm.ContactProblem, (a, L)), (llm.NonlinearContactProblem, (F, u))):
        with pytest.raises(llm.ContactInputError, match=said):
            problem(*forms, **beside(None))
        problem(*forms, **beside(1.0)).destroy()
    loads = [llm.FreeSurfacePressure(scene.tags[1], TOP, 1.0)]
    with pytest.raises(llm.ContactInputError, match=r"loads\[0\], tag 12, has no thickness"):
        llm.NonlinearContactProblem(F, u, loads=loads, **beside(around))


def test_a_ring_by_itself_in_time():
    """Hoop stresses turn no ring about: its motion is the same whether or not an interface far away
    tells that it lies around the axis."""
    moved = []
    for told in (False, True):
        built = [block(COMM, 3, *ends, tags) for ends, tags in (
            (((1.0, 0.0), (2.0, 1.0)), (1, LOWER, OUTER)),
            (((1.0, 1.1), (2.0, 2.0)), (UPPER, TOP, OUTER)),
            (((4.0, 0.0), (5.0, 1.0)), (21, 22, 23)))]  # fmt: skip
        F, rho, u = [], [], [fem.Function(V) for V, _ in built]
        for (V, _), w in zip(built, u, strict=True):
            r = ufl.SpatialCoordinate(V.mesh)[0]
            D = ufl.Identity(3) + gradient(w, r)
            W = 250.0 * (ufl.tr(D.T * D) - 3 - 2 * ufl.ln(ufl.det(D)) + ufl.ln(ufl.det(D)) ** 2)
            F.append(ufl.derivative(W * 2 * np.pi * r * ufl.dx(degree=6), w))
            rho.append(2 * np.pi * r)
        sides = [(tags, tag) for (_, tags), tag in zip(built, (LOWER, UPPER), strict=False)]
        floor = llm.RigidPlane((0.0, -9.0), (0.0, 1.0))
        pairs = [(None, tuple(sides)), (built[2][1], (21, floor))][: 1 + told]
        interfaces = [llm.Interface(*p, llm.Frictionless(), thickness=around) for p in pairs]
        stepper = llm.TimeStepper(rho, F, u, dt=5e-3, interfaces=interfaces, scheme="newmark")
        stepper.v[2].interpolate(lambda x: np.stack([0.5 + x[1], 0.0 * x[0]]))
        for _ in range(5):
            stepper.step()
        moved.append(stepper.u[2].x.array.copy())
    np.testing.assert_allclose(moved[0], moved[1], rtol=0.0, atol=1e-12)


@pytest.mark.mpi
def test_on_two_ranks():
    """Errors of the patch tests, linear and finite."""
    found = run_mpi_json("around_axis_ranks.py", 2)
    assert max(found.values()) <= 1e-9
