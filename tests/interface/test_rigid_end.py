"""A body tied to an obstacle that has a force, a motion, or some of each: a rigid end."""

import numpy as np
import pairs
import pytest
import ufl
from contact_scenes import ABOVE, BELOW, hold_all, rectangle
from dolfinx import fem, mesh
from mpi4py import MPI
from rigid_scenes import stack

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM, E, FORMS = MPI.COMM_SELF, 200.0, ("saddle", "condensed")


def column(plane, solver="auto"):
    """A column of height 4 and section 1, clamped at its foot, its end tied to a plane; ν = 0."""
    gdim = len(plane.point)
    low, high = np.zeros(gdim), np.ones(gdim)
    high[-1] = 4.0
    if gdim == 2:
        domain, tags = rectangle(COMM, (3, 8), low, high, "quadrilateral")
    else:
        domain, tags = pairs.block(COMM, (2, 2, 4), low, high, "hexahedron")
    V = compat.function_space(domain, shape=(gdim,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    return llm.ContactProblem(
        E * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * ufl.dx,
        ufl.inner(fem.Constant(domain, np.zeros(gdim)), w) * ufl.dx,
        bcs=hold_all(V, lambda p: p[gdim - 1] < 1e-9, lambda p: 0.0 * p),
        interfaces=llm.Interface(tags, (ABOVE, plane), law=llm.Tied()),
        solver=solver,
    )


def top(gdim, **motion):
    axis = np.eye(gdim)[-1]
    return llm.RigidPlane(tuple(4.0 * axis), tuple(-axis), **motion)


@pytest.mark.parametrize(
    ("gdim", "form"),
    [(2, "saddle"), (2, "condensed"), *(pytest.param(3, f, marks=pytest.mark.long) for f in FORMS)],
)
def test_force_or_motion(gdim, form):
    """Pulled and pushed aside: stretched as F l / E A; what moves it aside takes the same force."""
    aside = (0.3,) + (0.0,) * (gdim - 2)
    plane = top(gdim, force=(*aside, 5.0))
    problem = column(plane, form)
    for pull in (5.0, -2.0):
        plane.force = (*aside, pull)
        u, result = problem.solve(), problem.results[0]
        assert result.displacement[-1] == pytest.approx(4.0 * pull / E, rel=1e-11)
        assert result.resultant == pytest.approx([*(-np.array(aside)), -pull], abs=1e-11)
        end = u.function_space.tabulate_dof_coordinates()[:, gdim - 1] > 4.0 - 1e-9
        assert np.ptp(u.x.array.reshape(-1, gdim)[end], axis=0).max() < 1e-12
    moved = top(
        gdim, displacement=(*result.displacement[:-1], 0.0), force=(*[None] * (gdim - 1), -2.0)
    )
    other = column(moved)
    other.solve()
    assert other.results[0].resultant == pytest.approx(result.resultant, abs=1e-10)


@pytest.mark.parametrize(("aside", "said"), [(0.0, "2; .* 100%"), (3.0, "5; .* 40%")])
def test_dragged_off(aside, said):
    """A block that friction bears 0.9 of on a floor, its end dragged with 2, and itself with a load
    besides: both are told, and whose the work is."""
    domain, tags = rectangle(COMM, (3, 3), (0.0, 0.0), (1.0, 1.0), "quadrilateral")
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    floor, end = llm.RigidPlane((0, 0), (0, 1)), llm.RigidPlane((0, 1), (0, -1), force=(2.0, -3.0))
    problem = llm.ContactProblem(
        E * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * ufl.dx,
        ufl.inner(fem.Constant(domain, (aside, 0.0)), w) * ufl.dx,
        interfaces=[
            llm.Interface(tags, (BELOW, floor), law=llm.Coulomb(0.3)),
            llm.Interface(tags, (ABOVE, end), law=llm.Tied()),
        ],
    )
    with pytest.raises(llm.ContactError, match=rf"along \[1.0, 0.0\], force along it {said}"):
        problem.solve()


def test_refused():
    """Nothing holds the body."""
    domain, tags = rectangle(COMM, (2, 2), (0.0, 0.0), (1.0, 1.0), "quadrilateral")
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    floor = llm.RigidPlane((0.0, 0.0), (0.0, 1.0), force=(None, 1.0))
    with pytest.raises(llm.ContactError, match="held by no support"):
        llm.ContactProblem(
            ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * ufl.dx,
            ufl.inner(fem.Constant(domain, (0.0, 0.0)), w) * ufl.dx,
            interfaces=llm.Interface(tags, (BELOW, floor), law=llm.Tied()),
        )


def test_moments_are_of_rigid_ends():
    with pytest.raises(llm.ContactInputError, match="is of the rigid end of a body, law=Tied"):
        stack((llm.Tied(), llm.Frictionless()), "saddle", top(2, force=(0.0, 1.0), moment=1.0))


def beam(end, gdim=2, order=2, form="auto"):
    """A bar [0, 4] x [-.5, .5] (x [-.5, .5]), held at x = 0, its end tied to what ``end`` makes of
    the plane there; ν = 0."""
    low, high = np.full(gdim, -0.5), np.full(gdim, 0.5)
    low[0], high[0] = 0.0, 4.0
    kind = mesh.CellType.quadrilateral if gdim == 2 else mesh.CellType.hexahedron
    make = mesh.create_rectangle if gdim == 2 else mesh.create_box
    domain = make(COMM, [low, high], [4, 2, 1][:gdim], kind)
    at = np.sort(mesh.locate_entities_boundary(domain, gdim - 1, lambda x: np.isclose(x[0], 4.0)))
    tags = mesh.meshtags(domain, gdim - 1, at, np.full(len(at), 1, dtype=np.int32))
    V = compat.function_space(domain, degree=order, shape=(gdim,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    axis = np.eye(gdim)[0]
    plane = llm.RigidPlane(tuple(4.0 * axis), tuple(-axis), **end)
    problem = llm.ContactProblem(
        E * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * ufl.dx,
        ufl.inner(fem.Constant(domain, np.zeros(gdim)), w) * ufl.dx,
        bcs=hold_all(V, lambda p: p[0] < 1e-9, lambda p: 0.0 * p),
        interfaces=llm.Interface(tags, (1, plane), law=llm.Tied()),
        solver=form,
    )
    return problem, plane


@pytest.mark.parametrize("scale", [1.0, 1e3])
def test_pure_bending(scale):
    """Bernoulli's beam is exact in second order: θ = M l / E I, the end moves by θ l / 2."""
    moment = 0.3 * scale
    problem, plane = beam({"force": (0.0, 0.0), "moment": moment})
    problem.solve()
    result, theta = problem.results[0], moment * 4.0 / (E / 12.0)
    assert result.rotation == pytest.approx([theta], rel=1e-10)
    assert result.displacement == pytest.approx([0.0, 2.0 * theta], rel=1e-10, abs=1e-9 * theta)
    assert result.moment((4.0, 0.0)) == pytest.approx(-moment, rel=1e-9)
    plane.moment = -moment  # another one in the next step
    problem.solve()
    assert problem.results[0].rotation == pytest.approx([-theta], rel=1e-10)


@pytest.mark.parametrize(
    ("gdim", "order", "form"), [(2, 1, "saddle"), (3, 1, "condensed"), (3, 2, "saddle")]
)
def test_moved_and_loaded_are_one(gdim, order, form):
    """The force and moment that a motion takes, given back, make that motion."""
    rng = np.random.default_rng(7)
    shift, turn = rng.normal(size=gdim) / 50, rng.normal(size=1 if gdim == 2 else 3) / 50
    pivot = (4.2, *rng.normal(size=gdim - 1) / 5)  # the reference point
    rotation = turn[0] if gdim == 2 else turn
    moved = beam({"displacement": shift, "rotation": rotation, "pivot": pivot}, gdim, order)[0]
    expected = moved.solve().x.array
    force, moment = -moved.results[0].resultant, -moved.results[0].moment(pivot)
    loads = {"force": tuple(force), "moment": moment[0] if gdim == 2 else tuple(moment)}
    loaded = beam(loads | {"pivot": pivot}, gdim, order, form)[0]
    np.testing.assert_allclose(loaded.solve().x.array, expected, atol=1e-10)
    np.testing.assert_allclose(loaded.results[0].displacement, shift, atol=1e-10)
    np.testing.assert_allclose(loaded.results[0].rotation, turn, atol=1e-10)
    if gdim == 3:  # some of each
        loads = {"moment": (moment[0], None, moment[2]), "rotation": (0.0, turn[1], 0.0)}
        loads |= {"force": (None, force[1], None), "displacement": (shift[0], 0.0, shift[2])}
        mixed = beam(loads | {"pivot": pivot}, gdim, order, form)[0]
        np.testing.assert_allclose(mixed.solve().x.array, expected, atol=1e-10)
        np.testing.assert_allclose(mixed.results[0].rotation, turn, atol=1e-10)


@pytest.mark.parametrize(
    "form",
    ["saddle", *(pytest.param(f, marks=pytest.mark.long) for f in ("flexibility", "condensed"))],
)
def test_rigid_end_of_a_stack(form):
    """A block that contact with friction alone holds, pressed and tilted by its rigid end: the
    forces that a motion takes make that motion."""
    laws, shift, turn = (llm.Coulomb(0.2), llm.Tied()), (0.006, -0.02), 0.008
    plane = llm.RigidPlane((0.0, 2.0), (0.0, -1.0), displacement=shift, rotation=turn)
    problem, expected = stack(laws, form, plane)
    seat, end = problem.results
    assert {1, 2} <= set(seat.sides[0].status)  # sticks and slips
    forces = {"force": tuple(-end.resultant), "moment": -end.moment((0.0, 2.0))[0]}
    problem, u = stack(laws, form, llm.RigidPlane((0.0, 2.0), (0.0, -1.0), **forces))
    np.testing.assert_allclose(u, expected, atol=1e-8)
    np.testing.assert_allclose(problem.results[1].displacement, shift, atol=1e-8)
    np.testing.assert_allclose(problem.results[1].rotation, [turn], atol=1e-8)
