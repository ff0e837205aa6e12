"""States carried over to other meshes: the same one, finer ones, and what is refused."""

import curved_scenes as curved
import finite_patch
import friction_block
import numpy as np
import pytest
import rolling_disc
import ufl
from conftest import run_mpi_json
from dolfinx import fem, mesh
from friction_block import BOTTOM, TOP, body, stress
from hertz2d import hold
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM = MPI.COMM_SELF


def dragged(elements, *ways):
    scene = friction_block.Dragged(0.3, elements)
    for way in ways:
        scene.top.g.x.array[:] = way
        scene.problem.solve()
    return scene


def friction(scene):
    return scene.problem.results[0].resultant[0]


def test_same_mesh_goes_on_as_if_nothing_had_been():
    """Displacement, forces, slip; in the next steps what stuck goes on from there."""
    old, new = dragged((8, 11), 0.0, 0.0005), dragged((8, 11))
    llm.transfer(old.problem, new.problem)
    for way in (None, 0.0007, 0.0004):
        for scene in (old, new) if way is not None else ():
            scene.top.g.x.array[:] = way
            scene.problem.solve()
        (one,), (two,) = old.problem.results, new.problem.results
        size = np.abs(one.sides[0].force).max()
        for a, b in zip(one.sides, two.sides, strict=True):
            np.testing.assert_allclose(b.force, a.force, rtol=0.0, atol=1e-12 * size)
            np.testing.assert_array_equal(b.status, a.status)
        for a, b in zip(old.problem.u, new.problem.u, strict=True):
            far = np.abs(a.x.array).max()
            np.testing.assert_allclose(b.x.array, a.x.array, rtol=0.0, atol=1e-12 * far)


@pytest.mark.parametrize("k", [1, longer(2), longer(4)])
def test_a_finer_mesh_keeps_the_tangential_force(k):
    """As carried, solved again without any change, and a step later against all steps there."""
    old, new = dragged((8 * k, 11 * k), 0.0, 0.0005), dragged((10 * k, 15 * k))
    first = dragged((10 * k, 15 * k), 0.0, 0.0005)
    llm.transfer(old.problem, new.problem)
    assert abs(friction(new) / friction(old) - 1.0) <= 0.02  # peaks at the ends
    new.top.g.x.array[:] = 0.0005
    new.problem.solve()
    assert abs(friction(new) / friction(first) - 1.0) <= 0.02 / k
    for scene in (new, first):
        scene.top.g.x.array[:] = 0.0008
        scene.problem.solve()
    assert abs(friction(new) / friction(first) - 1.0) <= 0.02 / k


@pytest.mark.parametrize(("before", "now"), [((20, 30), (32, 22)), ((30, 20), (22, 32))])
def test_a_curved_frame_that_the_other_side_carries_then(before, now):
    """Slips are those from before, as forces are; the frame goes with the other side. It ended in
    a ValueError, and slips were told of the frame of before."""
    (old, pull), (new, go), (direct, known) = (curved.drum(0.3, n) for n in (before, now, now))
    assert old.geometries[0].site.carrier != new.geometries[0].site.carrier
    expected = [pull(0.02, 0.02), pull(0.06, -0.02)][-1]
    llm.transfer(old, new)
    told = new.results[0]
    for one, other in zip(told.sides, expected.sides, strict=True):
        slips = [np.linalg.norm(side.slip, axis=1).max() for side in (one, other)]
        assert abs(slips[0] / slips[1] - 1.0) < 0.1
    size = np.abs(expected.resultant).max()
    assert np.abs(told.resultant - expected.resultant).max() < 0.05 * size
    known(0.02, 0.02), known(0.06, -0.02)
    last = known(0.03, 0.0)
    assert np.abs(go(0.03, 0.0).resultant - last.resultant).max() < 0.02 * size
    for problem in (old, new, direct):
        problem.destroy()


def stuck(kind, cells, degree=1):
    """A block that a plane holds by friction, pressed from above; both are pushed apart."""
    domain, tags = body(COMM, (0.0, 0.0), (2.0, 1.0), cells)
    V = compat.function_space(domain, degree=degree, shape=(2,))
    w, top = ufl.TestFunction(V), lambda x: np.isclose(x[1], 1.0)
    down, along = hold(V, 1, top), hold(V, 0, top)
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    interfaces = [llm.Interface(tags, (BOTTOM, plane), law=llm.Coulomb(0.5))]
    options = {"bcs": [down, along], "interfaces": interfaces}
    if kind == "linear":
        a = ufl.inner(stress(ufl.TrialFunction(V), 10.0, 0.3), ufl.grad(w)) * ufl.dx
        zero = ufl.inner(fem.Constant(domain, (0.0, 0.0)), w) * ufl.dx
        problem = llm.ContactProblem(a, zero, **options)
    else:
        u = fem.Function(V)
        F = ufl.inner(stress(u, 10.0, 0.3), ufl.grad(w)) * ufl.dx
        problem = llm.NonlinearContactProblem(F, u, **options)

    def go(depth, way):
        down.g.x.array[:], along.g.x.array[:] = -depth, 0.5 * way
        plane.displacement = np.array([-0.5 * way, 0.0])
        problem.solve()
        side = problem.results[0].sides[0]
        return side.force.sum(axis=0), (side.status == 1).sum()

    return problem, go


@pytest.mark.parametrize(
    ("kind", "degree"), [("linear", 1), longer("nonlinear", 1), ("nonlinear", 2)]
)
def test_what_sticks_on_an_obstacle_stays(kind, degree):
    """Pushed, carried over and let back: the force along the plane is there, and gone again."""
    old, go = stuck(kind, (8, 4), degree)
    go(0.02, 0.0)
    before, sticks = go(0.02, 0.0032)
    assert sticks >= 6 and abs(before[0]) > 0.02
    new, there = stuck(kind, (12, 6), degree)
    llm.transfer(old, new)
    after, _ = there(0.02, 0.0032)
    np.testing.assert_allclose(after, before, rtol=0.03)
    whole, anew = stuck(kind, (12, 6), degree)
    anew(0.02, 0.0)
    anew(0.02, 0.0032)
    expected, _ = anew(0.02, 0.001)
    np.testing.assert_allclose(there(0.02, 0.001)[0], expected, rtol=0.03)
    assert whole is not new


def by_means(cells):
    """A block on a plane with friction, pressed and pushed by the mean displacement of its top."""
    domain, tags = body(COMM, (0.0, 0.0), (2.0, 1.0), cells)
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    mean = llm.MeanDisplacement((0.0, -0.02))
    a = ufl.inner(stress(u, 10.0, 0.3), ufl.grad(w)) * ufl.dx
    L = ufl.inner(fem.Constant(domain, (0.0, 0.0)), w) * ufl.dx
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    interfaces = [
        llm.Interface(tags, (BOTTOM, plane), law=llm.Coulomb(0.5)),
        llm.Interface(tags, (TOP, mean), law=llm.Tied()),
    ]
    problem = llm.ContactProblem(a, L, interfaces=interfaces)
    return problem, mean


def test_a_mean_displacement_goes_on():
    """What moves about it are all of a surface's nodes but one: a ValueError."""
    found = []
    for first, then in (((12, 6), (12, 6)), ((8, 4), (12, 6))):
        (old, mean), (new, other) = by_means(first), by_means(then)
        for mean.mean in ((0.0, -0.02), (0.002, -0.02)):
            old.solve()
        other.mean = mean.mean
        llm.transfer(old, new)
        carried = new.results[1].resultant
        np.testing.assert_allclose(carried, old.results[1].resultant, rtol=0.02)
        other.mean = (0.001, -0.02)
        new.solve()
        found.append(new.results[1].resultant)
        old.destroy(), new.destroy()
    np.testing.assert_allclose(found[1], found[0], rtol=0.02)


def pressed(cells, degree):
    """Hyperelastic blocks under friction, the upper one pressed down and pushed: the problem, and
    (gdim,) force of a step to such a depth and way, with how many nodes stick."""
    gdim = len(cells[0])
    places = (0.2, 0.6, 1.0), (0.0, 1.0, 0.0)  # corner and size sideways, bottom
    forms, displacements, sides = [], [], []
    for (corner, size, bottom), n in zip(places, cells, strict=True):
        low, sizes = (corner,) * (gdim - 1) + (bottom,), (size,) * (gdim - 1) + (1.0,)
        x, quads = friction_block.brick(low, sizes, n, False)
        kind = {2: "quadrilateral", 3: "hexahedron"}[gdim]
        domain = compat.create_mesh(COMM, quads, x, kind)
        at = mesh.locate_entities_boundary(domain, gdim - 1, lambda p: np.isclose(p[gdim - 1], 1.0))
        tags = mesh.meshtags(domain, gdim - 1, np.sort(at), np.full(len(at), 1, dtype=np.int32))
        V = compat.function_space(domain, degree=degree, shape=(gdim,))
        u = fem.Function(V)
        forms.append(finite_patch.residual(u, *finite_patch.lame(10.0, 0.3), degree))
        displacements.append(u)
        sides.append((tags, 1))
    V, W = (u.function_space for u in displacements)
    ends = lambda p: abs(p[gdim - 1] - 1.0) > 1.0 - 1e-9  # noqa: E731
    moved, held = ([hold(X, k, ends) for k in range(gdim)] for X in (V, W))
    problem = llm.NonlinearContactProblem(
        forms,
        displacements,
        bcs=[*moved, *held],
        interfaces=[llm.Interface(None, tuple(sides), law=llm.Coulomb(0.3))],
    )

    def go(depth, way):
        moved[0].g.x.array[:], moved[-1].g.x.array[:] = way, -depth
        problem.solve()
        side = problem.results[0].sides[0]
        return side.force.sum(axis=0), (side.status == 1).sum()

    return problem, go


@pytest.mark.parametrize(
    ("cells", "other", "degree"),
    [
        (((4, 4), (5, 4)), ((7, 5), (6, 4)), 1),  # the other body has the frame
        longer(((4, 4), (5, 4)), ((7, 5), (6, 4)), 2),
        longer(((3, 3, 2), (4, 4, 2)), ((4, 4, 2), (5, 5, 2)), 1),
        longer(((2, 2, 2), (3, 3, 2)), ((3, 3, 2), (4, 4, 2)), 2),
    ],
)
def test_bodies_go_on_to_stick_at_finite_deformation(cells, other, degree):
    """On the same mesh as if nothing had been, on another one as if all had been there."""
    way = (0.05, 0.0), (0.05, 0.008)
    for new_cells, allowed in ((cells, 1e-10), (other, 5e-3)):
        old, go = pressed(cells, degree)
        (new, there), (whole, anew) = (pressed(new_cells, degree) for _ in range(2))
        sticks = [go(*at)[1] for at in way][-1]
        assert sticks >= 3 and whole is not new
        for at in way:
            anew(*at)
        llm.transfer(old, new)
        for at in (way[-1], (0.05, 0.02), (0.05, 0.006)):
            force, _ = anew(*at)
            size = np.abs(force).max()
            np.testing.assert_allclose(there(*at)[0], force, rtol=0.0, atol=allowed * size)
            assert np.linalg.norm(force[:-1]) > 0.01 * size


def test_bodies_that_touch_are_told_apart():
    """Nodes of two bodies at one place, whose displacements differ."""
    from dolfinx_llm.problem.transfer import found_elsewhere

    spaces = []
    for n in (4, 7):
        x, quads = friction_block.brick((0.0, 0.0), (1.0, 1.0), (n, n), False)
        y, more = friction_block.brick((0.0, 1.0), (1.0, 1.0), (n + 1, n), False)
        domain = compat.create_mesh(
            COMM, np.vstack([quads, more + len(x)]), np.vstack([x, y]), "quadrilateral"
        )
        spaces.append(compat.function_space(domain, shape=(2,)))
    from dolfinx_llm.operators.bodies import body_labels

    old, new = spaces
    u, (label, _) = fem.Function(old), body_labels(old)
    x = old.tabulate_dof_coordinates()[:, :2]
    upper = np.array([x[label == k, 1].mean() for k in (0, 1)]) > 1.0
    u.x.array[:] = np.where(upper[label][:, None], 5.0 + 2.0 * x, x).ravel()
    (found,) = found_elsewhere([old], [new], [[u]])
    label, _ = body_labels(new)
    x = new.tabulate_dof_coordinates()[:, :2]
    upper = np.array([x[label == k, 1].mean() for k in (0, 1)]) > 1.0
    expected = np.where(upper[label][:, None], 5.0 + 2.0 * x, x).ravel()
    np.testing.assert_allclose(found, expected, atol=1e-13)


def test_velocities_go_on():
    """A disc that slides on a plane, on another mesh half way."""
    old, new = (rolling_disc.Disc(elements=n, steps=10, comm=COMM) for n in (4, 5))
    rows = old.run(0.5)
    llm.transfer(old.stepper, new.stepper)
    assert new.stepper.t == old.stepper.t
    after = new.run(1.0)
    exact = 1.0 - after[:, 0] / 3.0
    impulse = 0.1 / 3.0  # of friction in a step
    assert np.abs(rows[:, 1] - 1.0 + rows[:, 0] / 3.0).max() <= 0.02 * impulse  # from the first on
    assert np.abs(after[:, 1] - exact).max() <= 0.2 * impulse
    np.testing.assert_allclose(np.diff(after[:, 1]), -impulse, rtol=0.1)


def test_other_bodies_are_refused():
    old, _ = stuck("linear", (4, 2))
    _, go = stuck("linear", (4, 2))
    with pytest.raises(llm.ContactError, match="nothing has been solved"):
        llm.transfer(old, old)
    go = stuck("linear", (4, 2))
    go[1](0.02, 0.0)
    with pytest.raises(llm.ContactInputError, match="differ: give the same kind"):
        llm.transfer(go[0], stuck("nonlinear", (4, 2))[0])
    with pytest.raises(llm.ContactInputError, match="give a ContactProblem"):
        llm.transfer(go[0], None)
    other, tags = body(COMM, (0.0, 0.0), (3.0, 1.0), (4, 2))
    V = compat.function_space(other, shape=(2,))
    w = ufl.TestFunction(V)
    a = ufl.inner(stress(ufl.TrialFunction(V), 10.0, 0.3), ufl.grad(w)) * ufl.dx
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    longer_one = llm.ContactProblem(
        a,
        ufl.inner(fem.Constant(other, (0.0, 0.0)), w) * ufl.dx,
        bcs=[hold(V, k, lambda x: np.isclose(x[1], 1.0)) for k in (0, 1)],
        interfaces=[llm.Interface(tags, (BOTTOM, plane), law=llm.Coulomb(0.5))],
    )
    with pytest.raises(llm.ContactInputError, match="6 nodes of the new mesh lie outside"):
        llm.transfer(go[0], longer_one)


@pytest.mark.parametrize("n", [2, longer(3)])
def test_on_ranks(n):
    """Cells and nodes of the two meshes are on other ranks."""
    one, several = (run_mpi_json("carried.py", ranks)["found"] for ranks in (1, n))
    np.testing.assert_allclose(several, one, atol=1e-10)
    assert one[1][0] > one[0][0] > 0.05
