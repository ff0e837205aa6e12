"""Rigid obstacles at finite deformation: exact states, motions, obstacles of one's own."""

import itertools
from dataclasses import replace

import finite_patch
import hertz2d
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from own_law import Glue, Soft
from sampling import longer, some_of
from scipy.spatial.transform import Rotation
from tangents import tangent_errors
from upright_blocks import FOOT, KINDS, TOP, block

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.finite.obstacles import obstacle_contact, pose
from dolfinx_llm.finite.own_laws.law_contact import LawOnObstacle, LawOnPressed
from dolfinx_llm.finite.pairs.friction_law import in_plane
from dolfinx_llm.finite.pairs.terms import Origin
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.laws.rows import CLOSED, SLIP, STICK, LawNodes
from dolfinx_llm.problem.nonlinear_parts import AGAINST

COMM = MPI.COMM_SELF
ROUGH = llm.Coulomb(0.3)
SOFT, GLUE = Soft(30.0, 0.05), Glue(4000.0, ratio=0.5, first=0.05, last=0.6)


class Floor(llm.Obstacle):
    """The plane y = 0 in 2D, by a rough estimate of the distance: right where it is 0."""

    def clearance(self, x):
        into = np.zeros_like(x)
        into[:, -1] = -1.0
        return x[:, -1] * (1.0 + 0.3 * x[:, -1]), into


def rolled(V, axes):
    """Conditions that hold the faces x_k = 0."""
    bcs = []
    for k in axes:
        Vk, _ = V.sub(k).collapse()
        dofs = fem.locate_dofs_geometrical((V.sub(k), Vk), lambda p, k=k: np.isclose(p[k], 0.0))
        bcs.append(fem.dirichletbc(fem.Function(Vk), dofs, V.sub(k)))
    return bcs


def test_a_surface_drawn_the_other_way():
    """A cap whose facets look into it, narrower than the body above: nothing could touch it."""
    _, tags, V, u, F = block("quad", cells=8)
    angle = np.linspace(-0.1, 0.1, 13)
    x = np.array([0.5, 0.0]) + 2.0 * np.stack([np.sin(angle), np.cos(angle) - 1.0], axis=1)
    up = np.stack([np.arange(12), np.arange(1, 13)], axis=1)

    def on(cells):
        cap = llm.RigidSurface(llm.Frame(x, cells))
        interface = llm.Interface(tags, (FOOT, cap), law=llm.Frictionless())
        return llm.NonlinearContactProblem(F, u, bcs=rolled(V, (0,)), interfaces=[interface])

    on(up).destroy()
    with pytest.raises(llm.ContactError, match="of tag 1 lie on the RigidSurface .* none faces it"):
        on(up[:, ::-1])


@pytest.mark.parametrize("obstacle", ["plane", "own"])
def test_patch(obstacle):
    """A block pressed on a plane by a follower pressure: homogeneous, in few iterations."""
    _, tags, V, u, F = block("quad")
    floor = llm.RigidPlane((0.0, 0.0), (0.0, 1.0)) if obstacle == "plane" else Floor()
    problem = llm.NonlinearContactProblem(
        F,
        u,
        bcs=rolled(V, (0,)),
        interfaces=[llm.Interface(tags, (FOOT, floor), law=llm.Frictionless())],
        loads=[llm.FreeSurfacePressure(tags, TOP, 300.0)],
    )
    problem.solve(increments=2)
    x = V.tabulate_dof_coordinates()[:, :2]
    known = np.array([1.171006012193, 0.778273721944]) - 1.0
    assert np.abs(u.x.array.reshape(x.shape) - x * known).max() < 1e-10
    result = problem.results[0]
    assert result.frame is None and len(result.sides) == 1 and "no frame" in str(problem)
    assert np.abs(result.pressure / 300.0 - 1.0).max() < 1e-9
    assert np.allclose(result.resultant, [0.0, -300.0 * 1.171006012193], atol=1e-7)
    assert max(h["iteration"] for h in problem.history) <= 5


@pytest.mark.parametrize(
    "law", [longer(llm.Frictionless()), llm.Coulomb(0.3, cohesion=5.0)], ids=str
)
def test_moved_and_turned_in_3d(law):
    """A plane that comes from afar, presses and turns by 40° with the block's top: the same forces
    in the turned base as without turning, and no slip."""
    found = []
    for turn in ((0.0,), (20.0, 40.0)):
        domain, tags, V, u, F = block("tet", 3)
        plane = llm.RigidPlane((0.0, 0.0, -0.2), (0.0, 0.0, 1.0), pivot=(0.5, 0.5, 1.0))
        g = fem.Function(V)
        top = fem.locate_dofs_topological(V, 2, tags.indices[tags.values == TOP])
        problem = llm.NonlinearContactProblem(
            F,
            u,
            bcs=[fem.dirichletbc(g, top)],
            interfaces=[llm.Interface(tags, (FOOT, plane), law=law)],
        )
        plane.displacement = (0.0, 0.0, 0.3)
        problem.solve()
        x = V.tabulate_dof_coordinates()
        for angle in np.deg2rad(turn):
            R = Rotation.from_rotvec([angle, 0.0, 0.0]).as_matrix()
            g.x.array[:] = ((x - [0.5, 0.5, 1.0]) @ (R.T - np.eye(3))).ravel()
            plane.rotation, plane.displacement = (angle, 0.0, 0.0), R @ (0.0, 0.0, 0.3)
            problem.solve()
            side = problem.results[0].sides[0]
            assert np.abs(side.slip).max() < 1e-9
        found.append(side.force @ R)
    assert found[0][:, 2].max() < -1.0
    assert np.abs(found[0] - found[1]).max() < 1e-9 * np.abs(found[0]).max()


@pytest.mark.parametrize(("kind", "mu"), [("quad", 0.1), longer("quad", 0.3), ("tet", 0.3)])
def test_slope(kind, mu):
    """A block under its weight on a slope, pushed along x: F / G = (tan + mu) / (1 - mu tan)."""
    domain, tags, V, u, F = block(kind, 3)
    gdim, tan = V.mesh.geometry.dim, 0.1
    bcs = rolled(V, range(gdim - 1))
    weight = fem.Constant(domain, np.eye(gdim)[-1])
    ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
    F += ufl.inner(weight, ufl.TestFunction(V)) * ds(TOP)
    along, normal = (
        np.eye(gdim)[0] + tan * np.eye(gdim)[-1],
        np.eye(gdim)[-1] - tan * np.eye(gdim)[0],
    )
    x = domain.geometry.x
    turned = x[:, [0]] * along + x[:, [gdim - 1]] * normal
    turned[:, 1 : gdim - 1] = x[:, 1 : gdim - 1]
    x[:, :gdim] = turned
    slope = llm.RigidPlane(np.zeros(gdim), normal)
    problem = llm.NonlinearContactProblem(
        F, u, bcs=bcs, interfaces=[llm.Interface(tags, (FOOT, slope), law=llm.Coulomb(mu))]
    )
    for distance in (0.7, 1.4):
        bcs[0].g.x.array[:] = distance
        problem.solve(increments=2)
        side = problem.results[0].sides[0]
        force = side.force.sum(axis=0)
        assert abs(-force[0] / force[-1] * (1.0 - mu * tan) / (tan + mu) - 1.0) < 1e-6
        assert set(side.status) == {2}
        assert np.abs(side.slip - 0.7 * along).max() < 1e-2


@pytest.mark.parametrize(
    ("law", "degree"),
    [
        longer(llm.Frictionless(), 1),
        (llm.Frictionless(), 2),
        (llm.Coulomb(0.2), 1),
        longer(llm.Coulomb(0.2), 2),
    ],
    ids=str,
)
def test_two_that_touch_a_node(law, degree):
    """A plane and the lowest point of a ball, both on a node at first, pushed in by unlike amounts:
    the deeper one bears it, as where the plane starts a little off."""
    found = []
    for off in (0.0, 0.01):
        domain = mesh.create_rectangle(
            COMM, [[0.0, 0.0], [4.0, 1.0]], [8, 3], mesh.CellType.quadrilateral
        )
        V = compat.function_space(domain, degree=degree, shape=(2,))
        u = fem.Function(V)
        F = finite_patch.residual(u, 4.0, 6.0, degree)
        low, high = (
            mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y))
            for y in (0.0, 1.0)
        )
        tags = mesh.meshtags(domain, 1, np.sort(high), np.full(len(high), 1, dtype=np.int32))
        held = fem.dirichletbc(fem.Function(V), fem.locate_dofs_topological(V, 1, low))
        plane = llm.RigidPlane((0.0, 1.0 + off), (0.0, -1.0))
        ball = llm.RigidSphere((2.0, 1.5), 0.5)
        interfaces = [llm.Interface(tags, (1, one), law=law) for one in (plane, ball)]
        problem = llm.NonlinearContactProblem(F, u, bcs=[held], interfaces=interfaces)
        plane.displacement, ball.displacement = (0.0, -0.03 - off), (0.0, -0.1)
        problem.solve()
        assert len(problem.history) <= 8
        (flat,), (round_,) = (result.sides for result in problem.results)
        middle = np.argmin(np.abs(flat.X[:, 0] - 2.0))
        assert flat.status[middle] == 0 and round_.status[middle] != 0
        assert flat.gap[middle] == pytest.approx(0.07, abs=1e-3 * (degree > 1) + 1e-9)
        found.append([result.resultant for result in problem.results])
    assert np.abs(np.subtract(*found)).max() <= 1e-8 * np.abs(found).max()


def test_carried():
    """A block that only friction and a pressure hold on a plane moves and turns with it, and the
    plane's own points count: it slips by nothing."""
    domain, tags, V, u, F = block("quad", 3)
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0), pivot=(0.3, -1.0))
    problem = llm.NonlinearContactProblem(
        F,
        u,
        interfaces=[llm.Interface(tags, (FOOT, plane), law=llm.Coulomb(1.0))],
        loads=[llm.FreeSurfacePressure(tags, TOP, 30.0)],
    )
    problem.solve()
    before = problem.results[0].sides[0]
    plane.rotation, plane.displacement = 1.2, (0.4, 0.2)
    problem.solve(increments=6)
    after = problem.results[0].sides[0]
    Q = Rotation.from_rotvec([0.0, 0.0, 1.2]).as_matrix()[:2, :2]
    assert (
        np.abs(after.x - ((before.x - plane.pivot) @ Q.T + plane.pivot + (0.4, 0.2))).max() < 1e-9
    )
    assert np.abs(after.force - before.force @ Q.T).max() < 1e-9 * np.abs(before.force).max()
    assert np.abs(after.slip).max() < 1e-10 and set(after.status) == {1}


@pytest.mark.parametrize("law", [llm.Frictionless(), longer(llm.Coulomb(1e-10))], ids=str)
def test_slip_while_all_turns(law):
    """A block that is pressed on a plane and shifted along it while both turn, in any increments:
    the shift, turned."""
    turned = []
    for increments in (1, 3):
        domain, tags, V, u, F = block("quad", 3)
        plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0), pivot=(0.5, 1.0))
        g, X = fem.Function(V), V.tabulate_dof_coordinates()[:, :2]
        facets = tags.indices[tags.values == TOP]
        held = fem.dirichletbc(g, fem.locate_dofs_topological(V, 1, facets))
        interface = llm.Interface(tags, (FOOT, plane), law=law)
        problem = llm.NonlinearContactProblem(F, u, bcs=[held], interfaces=[interface])
        plane.displacement = 0.0, 0.02
        problem.solve()
        assert np.abs(problem.results[0].sides[0].slip[:, 1]).max() < 1e-9
        R = pose.Rotation.from_rotvec([0.0, 0.0, 0.4]).as_matrix()[:2, :2]
        g.x.array[:] = ((X - plane.pivot + [0.1, 0.0]) @ R.T + plane.pivot - X).ravel()
        plane.rotation, plane.displacement = 0.4, R @ [0.0, 0.02]
        problem.solve(increments)
        side = problem.results[0].sides[0]
        assert (side.status > 0).all() and np.abs(side.slip - R @ [0.1, 0.0]).max() < 1e-8
        turned.append(side.slip)
    assert np.abs(turned[0] - turned[1]).max() < 1e-8


@pytest.mark.parametrize("degree", [1, longer(2)])
def test_as_a_body_that_does_not_yield(degree):
    """Partial slip of a block that is dragged over the plane, and over a coarser body of which all
    is prescribed: the same forces, pair by pair."""
    found = []
    for rigid in (True, False):
        domain, tags, V, u, F = block("quad", 6, degree)
        g = fem.Function(V)
        facets = tags.indices[tags.values == TOP]
        bcs = [fem.dirichletbc(g, fem.locate_dofs_topological(V, 1, facets))]
        below, marks, W, w, G = block("quad", 2, degree)
        below.geometry.x[:, :2] = (below.geometry.x[:, :2] - [0.3, 1.0]) * [2.0, 1.0]
        every = np.arange(W.dofmap.index_map.size_local, dtype=np.int32)
        bcs.append(fem.dirichletbc(fem.Function(W), every))
        plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
        sides = (tags, FOOT), (plane if rigid else (marks, TOP))
        interface = llm.Interface(None, sides, law=llm.Coulomb(0.3, cohesion=3.0))
        problem = llm.NonlinearContactProblem(
            F if rigid else [F, G],
            u if rigid else [u, w],
            bcs=bcs[:1] if rigid else bcs,
            interfaces=[interface],
        )
        for moved in ((0.0, -0.05), (0.012, -0.05), (0.02, -0.06)):
            g.x.array[:] = np.tile(moved, len(g.x.array) // 2)
            problem.solve()
        found.append(problem.results[0].sides[0])
    assert set(found[0].status) == {1, 2}
    assert np.abs(found[0].force - found[1].force).max() < 1e-9 * np.abs(found[0].force).max()
    assert np.abs(found[0].slip - found[1].slip).max() < 1e-11


def patch(rng, gdim):
    """Six nodes of a surface near the top of a sphere of radius 2 around -3 along the last axis."""
    x = rng.uniform(-0.4, 0.4, (6, gdim))
    x[:, -1] = -1.0 + 0.01 * x[:, 0]
    facets = np.arange(6).reshape(-1, gdim)[:, ::-1]
    return Surface(x, facets, np.arange(6), np.zeros(6, dtype=int), "patch")


@pytest.mark.parametrize("status", [CLOSED, STICK, SLIP])
@pytest.mark.parametrize(
    ("gdim", "force"), [(2, None), (2, (None, 2.0)), (3, None), (3, (None, 3.0, 2.0))], ids=str
)
def test_tangent_is_the_derivative(gdim, status, force, monkeypatch):
    """Differences of the clearance against those of force, gap, law and balance, on a turned
    sphere."""
    monkeypatch.setattr(obstacle_contact, "TURNED_AWAY", -2.0)  # all nodes take part
    rng = np.random.default_rng(5)
    surface = patch(rng, gdim)
    x = surface.x
    ball = llm.RigidSphere(
        np.eye(gdim)[-1] * -3.0, 2.0, rotation=0.3 if gdim == 2 else (0.3, 0, 0), force=force
    )
    rubs = [] if status == CLOSED else [np.full(6, 0.3), rng.uniform(0.0, 2.0, 6)]
    contact = AGAINST[bool(rubs), force is not None].of(surface, ball, *rubs)
    q, held = np.zeros(contact.size), replace(contact.hold(x.ravel()), scale=5.0)
    on = np.full(6, status)
    q[:6], q[6 + x.size * bool(rubs) :] = rng.uniform(0.5, 1.5, 6), 0.03
    if rubs:
        place = contact.place(x.ravel(), q, held)
        points = contact.here(place) + 0.05 * rng.standard_normal(x.shape)
        held = replace(held, origin=Origin(points, place.gap, on > 0))
        tau = 0.2 * rng.standard_normal(x.shape)
        if status == SLIP:  # where the law holds the derivative is exact
            way = in_plane(place.normal, contact.way(place, held.origin)[0])
            bound = 0.3 * q[:6] + rubs[1] * place.areas[0]
            tau = way * (bound / np.linalg.norm(way, axis=1))[:, None]
        q[6 : 6 + x.size] = tau.ravel()
    assert tangent_errors(contact, x.ravel(), q, on, held, rng)[:, 0].max() < 1e-8


@pytest.mark.parametrize(
    ("gdim", "force"), [(2, None), (2, (None, 2.0)), (3, None), (3, (None, 3.0, 2.0))], ids=str
)
@pytest.mark.parametrize("law", [Soft(30.0, 0.05), Glue(40.0, first=1e-3, last=5.0)], ids=str)
def test_tangent_of_own_laws(gdim, force, law, monkeypatch):
    """The same of laws of one's own."""
    monkeypatch.setattr(obstacle_contact, "TURNED_AWAY", -2.0)
    rng = np.random.default_rng(8)
    surface = patch(rng, gdim)
    x = surface.x
    ball = llm.RigidSphere(np.eye(gdim)[-1] * -3.0, 2.0, force=force)
    kind = LawOnObstacle if force is None else LawOnPressed
    contact = kind.under(law, LawNodes(x, *(np.ones(6),) * 7), surface, ball)
    z = (x + 0.03 * rng.standard_normal(x.shape) - 0.15 * np.eye(gdim)[-1]).ravel()
    q, on = np.zeros(contact.size), np.full(6, STICK)
    q[:6], q[6:] = rng.uniform(0.5, 1.5, 6), 0.2 * rng.standard_normal(len(q) - 6)
    q[6 + x.size * law.slips :] = 0.03
    held = replace(contact.hold(z), scale=5.0)
    place = contact.place(z, q, held)
    if not law.slips:  # rows of a layer, over its stiffness, are exact where it holds
        q[:6] = place.areas[0] * law.p0 * np.expm1(-place.gap / law.h)
    points = contact.here(place) + 0.05 * rng.standard_normal(x.shape)
    held = replace(held, origin=Origin(points, place.gap, on > 0))
    errors, sizes = tangent_errors(contact, z, q, on, held, rng).T
    assert (errors < 1e-6 * sizes).all()


@pytest.mark.parametrize(
    ("kind", "law"),
    some_of(
        list(itertools.product(KINDS, (llm.Frictionless(), ROUGH, SOFT, GLUE))),
        [
            ("quad", ROUGH),
            ("quad", llm.Frictionless()),
            ("tet", llm.Frictionless()),
            ("quad", GLUE),
            ("tet", SOFT),
        ],
    ),
    ids=str,
)
def test_pressed_by_a_force(kind, law):
    """A ball drawn above a block, or under friction a plane, pressed onto it, and the plane along
    it, by forces: the block answers with them, and where the obstacle is moved to the same places
    the same forces arise. (Slip of pairs that close counts from where iterates meet.)"""
    places, found = [], []
    for moved in (False, True):
        _, tags, V, u, F = block(kind, 6)
        gdim = V.mesh.geometry.dim
        high = np.eye(gdim)[-1]
        press = (
            llm.RigidPlane(high, -high) if law.slips else llm.RigidSphere(0.5 + 2.05 * high, 1.5)
        )
        if not moved:
            press.force = (0.0 if law.slips else None,) * (gdim - 1) + (0.0,)
        foot = fem.locate_dofs_topological(V, gdim - 1, tags.indices[tags.values == FOOT])
        problem = llm.NonlinearContactProblem(
            F,
            u,
            bcs=[fem.dirichletbc(fem.Function(V), foot)],
            interfaces=[llm.Interface(tags, (TOP, press), law=law)],
        )
        for k, (down, along) in enumerate(((-40.0, 0.0), (-60.0, 8.0))):
            force = np.array([along * law.slips] + [0.0] * (gdim - 2) + [down])
            if moved:
                press.displacement = places[k]
            else:
                press.force = tuple(np.where([f is None for f in press.force], None, force))
            problem.solve()
            result = problem.results[0]
            places.append(result.displacement)
            assert np.abs(result.resultant + force)[-1 if not law.slips else 0 :].max() < 1e-8
        found.append(result.sides[0])
    status, known = set(found[0].status), {ROUGH: {1, 2}, GLUE: {1}, SOFT: {3}}
    assert status - {0} == known.get(law, {3}) and (0 in status) <= (not law.slips)
    assert np.abs(found[0].u - found[1].u).max() < 1e-10
    assert np.abs(found[0].force - found[1].force).max() < 1e-8


def test_refused():
    domain, tags, V, u, F = block("quad")
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    for law, floor, text in [
        (llm.Frictionless(), llm.RigidPlane((0, 0), (0, 1), moment=1.0), "is of the rigid end"),
        (llm.Frictionless(), llm.MeanDisplacement((None, 0.1)), "prescribed with law=Tied"),
        (llm.Coulomb(np.full(3, 0.2)), plane, "for each of 5 nodes"),
        (llm.Frictionless(), llm.RigidPlane((0, 0, 0), (0, 0, 1)), "lies in 3D"),
    ]:
        interface = llm.Interface(tags, (FOOT, floor), law=law)
        with pytest.raises(llm.ContactInputError, match=text):
            llm.NonlinearContactProblem(F, u, interfaces=[interface])
    pressed = llm.RigidPlane((0.0, 0.0), (0.0, 1.0), force=(1.0, 20.0))
    top = fem.locate_dofs_topological(V, 1, tags.indices[tags.values == TOP])
    problem = llm.NonlinearContactProblem(
        F,
        u,
        bcs=[fem.dirichletbc(fem.Function(V), top)],
        interfaces=[llm.Interface(tags, (FOOT, pressed), law=llm.Frictionless())],
    )
    with pytest.raises(llm.ContactError, match="nothing resists the part"):
        problem.solve()
    pressed.force = (None, 20.0)
    with pytest.raises(llm.ContactInputError, match="prescribed by component as"):
        problem.solve()


@pytest.mark.parametrize(
    ("law", "force", "stands"),
    [
        (llm.Frictionless(), (None, 10.0), 0.5),
        (ROUGH, (5.0, -10.0), 0.6),
        longer(ROUGH, (-3.0, -10.0), 1.0),
        (llm.Coulomb(0.3, cohesion=50.0), (5.0, -10.0), 1.0),
        longer(llm.Sliding(), (None, 10.0), 1.0),
        (llm.Tied(), (None, 10.0), 1.0),
    ],
    ids=str,
)
def test_forces_that_pull_a_plane_off(law, force, stands):
    """Told in a sentence, without Newton's iteration going astray in each increment; the state is
    that of what contact bears, from which a force within it goes on."""
    _, tags, V, u, F = block("quad")
    held = fem.locate_dofs_topological(V, 1, tags.indices[tags.values == FOOT])
    before = (None if force[0] is None else 0.0, -10.0)
    lid = llm.RigidPlane((0.0, 1.0), (0.0, -1.0), force=before)
    interface = llm.Interface(tags, (TOP, lid), law=law)
    bcs = [fem.dirichletbc(fem.Function(V), held)]
    problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=[interface])
    problem.solve()
    lid.force = force
    if stands == 1.0:
        problem.solve()
    else:
        with pytest.raises(llm.ContactError, match=r"does not balance the force .*RigidPlane"):
            problem.solve()
    now, then = (np.array([f or 0.0 for f in a]) for a in (force, before))
    [result] = problem.results
    borne = then + stands * (now - then)
    bound = 20.0 / 256.0 + 1e-9  # the smallest increment of a step of 20
    sign = np.where([f is None for f in force], 0.0, -1.0)
    assert np.abs(sign * result.resultant - borne).max() <= (bound if stands < 1.0 else 1e-9)
    assert len(problem.history) <= 40
    if stands < 1.0:
        lid.force = before
        problem.solve()
        assert np.abs(sign * problem.results[0].resultant - then).max() <= 1e-9


def pressed_disc(a, n=8):
    """Forces on a half disc whose diameter is pressed down by a²/R onto a plane, with n elements
    over the half-width a: of the linear and of the nonlinear problem."""
    domain, tags = hertz2d.half_disc(COMM, a, n, 1, growth=0.3)
    V = compat.function_space(domain, shape=(2,))
    u, trial, w = fem.Function(V), ufl.TrialFunction(V), ufl.TestFunction(V)
    F = finite_patch.residual(u, *finite_patch.lame(hertz2d.E, hertz2d.NU))
    top = tags.indices[tags.values == hertz2d.DIAMETER]
    down = fem.Constant(domain, -a * a / hertz2d.R)
    held = fem.locate_dofs_topological(V.sub(1), 1, top)
    bcs = [hertz2d.hold(V, 0, lambda x: np.isclose(x[0], 0.0))]
    bcs.append(fem.dirichletbc(down, held, V.sub(1)))
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    interface = llm.Interface(None, ((tags, hertz2d.CONTACT), plane), law=llm.Frictionless())
    stiffness = ufl.inner(hertz2d.stress(trial), ufl.grad(w)) * ufl.dx
    nothing = ufl.inner(fem.Constant(domain, (0.0, 0.0)), w) * ufl.dx
    linear = llm.ContactProblem(stiffness, nothing, bcs=bcs, interfaces=[interface])
    finite = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=[interface])
    for problem in (linear, finite):
        problem.solve()
    pairs = [p.results[0].sides[0].status > 0 for p in (linear, finite)]
    assert (pairs[0] == pairs[1]).all()
    return [abs(p.results[0].resultant[1]) for p in (linear, finite)]


def test_hertz_at_small_load():
    """Forces differ from those of the linear problem by a part that falls as the strain under the
    disc does, p0 / E ~ a / R, which is the root of the load: by its power 3/2 themselves."""
    linear, finite = np.array([pressed_disc(a) for a in (0.1, 0.05)]).T
    differences = np.abs(finite - linear)
    slope = np.log(differences[0] / differences[1]) / np.log(linear[0] / linear[1])
    assert differences[-1] < 1e-4 * linear[-1] and abs(slope - 1.5) < 0.1
