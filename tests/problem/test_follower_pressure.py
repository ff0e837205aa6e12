"""A pressure that follows a surface: what covers it comes and goes; beside contact of curved
surfaces; facets that bend."""

from functools import partial

import bent_rings
import finite_patch
import folding
import gmsh
import numpy as np
import pytest
import test_finite_deformation as fd
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import NonlinearContactProblem, compat
from dolfinx_llm.geometry.cells import vector_areas

P = 50.0


def covered(cells, p=P, lid=False):
    """A block under pressure where another one, held at its top, leaves it free, or a lid far away
    if so wished; and its motion."""
    domain, tags = fd.blocks(cells, (1.0, 0.6), shift=0.17)
    V, u, F = fd.bodies_of(domain)
    down = fem.Constant(domain, 0.0)
    held = []
    for tag, value in ((fd.BOTTOM, (0.0, 0.0)), (fd.TOP, (0.0, down))):
        for k in (0, 1):
            dofs = fem.locate_dofs_topological(V.sub(k), 1, tags.indices[tags.values == tag])
            held.append(fem.dirichletbc(value[k], dofs, V.sub(k)))
    covers, law = [(tags, fd.HIGH)], llm.Frictionless()
    interfaces = [llm.Interface(tags, (fd.LOW, fd.HIGH), law=law)]
    if lid:
        covers.append(llm.RigidPlane((0.0, 9.0), (0.0, -1.0)))
        interfaces.append(llm.Interface(tags, (fd.LOW, covers[1]), law=law))
    load = llm.FreeSurfacePressure(tags, fd.LOW, p, covered_by=covers if lid else covers[0])
    problem = llm.NonlinearContactProblem(F, u, bcs=held, interfaces=interfaces, loads=[load])
    return problem, u, down


@pytest.mark.parametrize("cells", [longer((6, 8)), (9, 4)])
def test_cover_arrives_and_leaves_in_one_step(cells):
    """Lifted at once the surface bears all of the pressure, whose resultant follows from where it
    ends; put back at once the state is that of a cover that never left. Solving again changes
    nothing."""
    problem, u, down = covered(cells)
    states = []
    for motion in (-0.04, 0.6, -0.04):
        down.value = motion
        for _ in range(2):
            problem.solve()
            states.append(u.x.array.copy())
        assert len(problem.history) == 1
        if motion > 0.0:
            x = u.function_space.tabulate_dof_coordinates()[:, :2]
            lower = x[:, 1] <= 1.0 + 1e-12
            ends = [
                np.flatnonzero(np.linalg.norm(x - at, axis=1) < 1e-9) for at in ([0, 1], [1, 1])
            ]
            ends = [e[0] for e in ends]
            chord = (x + u.x.array.reshape(x.shape))[ends]
            side = chord[1] - chord[0]
            force = problem.pushed.reshape(x.shape)[lower].sum(axis=0)
            assert np.abs(force - P * np.array([side[1], -side[0]])).max() < 1e-10 * P
    for again in (1, 3, 5):
        assert np.abs(states[again] - states[again - 1]).max() < 1e-10
    assert np.abs(states[4] - states[0]).max() < 1e-10


@pytest.mark.parametrize("gap", [longer(0.16), 0.2])
def test_surface_that_is_pulled_to_its_cover(gap):
    """A suction that draws it so near that it is covered, and without which it is not: no state is
    both. The step ends, and ends in the same state again."""
    problem, u, down = covered((6, 8), -100.0)
    down.value = gap
    problem.solve()
    found = u.x.array.copy()
    problem.solve()
    assert len({h["part"] for h in problem.history}) == 1
    assert np.abs(u.x.array - found).max() < 1e-10


class HalfDisc:
    """A half disc of radius 1 on a block, of triangles of given sizes, moved down by its flat, and
    what fluid presses on its round side."""

    def __init__(self, sizes, turn=0.0, sides=(1, 4), law=None, degree=1):
        gmsh.initialize()
        gmsh.option.setNumber("General.Terminal", 0)
        geo = gmsh.model.geo
        round_, block = (
            [geo.addPoint(*p, 0, h) for p in points]
            for h, points in zip(sizes, (
                ((0, 1), (-1, 1), (0, 0), (1, 1)),
                ((-1.6, -0.6), (1.6, -0.6), (1.6, 0), (-1.6, 0)),
            ), strict=True)
        )  # fmt: skip
        middle, left, low, right = round_
        arcs = [geo.addCircleArc(left, middle, low), geo.addCircleArc(low, middle, right)]
        flat = [geo.addLine(right, middle), geo.addLine(middle, left)]
        box = [geo.addLine(block[i], block[(i + 1) % 4]) for i in range(4)]
        bodies = [geo.addPlaneSurface([geo.addCurveLoop(edges)]) for edges in ([*arcs, *flat], box)]
        geo.synchronize()
        named = ((1, arcs, 1), (1, flat, 2), (1, [box[0]], 3), (1, [box[2]], 4), (2, bodies, 1))
        for dim, entities, tag in named:
            gmsh.model.addPhysicalGroup(dim, entities, tag)
        gmsh.model.mesh.generate(2)
        domain, _, tags, *_ = compat.model_to_mesh(gmsh.model, MPI.COMM_SELF, 0, gdim=2)
        gmsh.finalize()
        self.Q = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        domain.geometry.x[:, :2] = domain.geometry.x[:, :2] @ self.Q.T
        V = compat.function_space(domain, degree=degree, shape=(2,))
        self.u = fem.Function(V)
        self.motion, self.p = fem.Constant(domain, (0.0, 0.0)), fem.Constant(domain, 0.0)
        top, bottom = (
            fem.locate_dofs_topological(V, 1, tags.indices[tags.values == tag]) for tag in (2, 3)
        )
        self.problem = llm.NonlinearContactProblem(
            finite_patch.residual(self.u, *finite_patch.lame(100.0, 0.3), degree),
            self.u,
            bcs=[fem.dirichletbc(self.motion, top, V), fem.dirichletbc(np.zeros(2), bottom, V)],
            interfaces=[llm.Interface(tags, sides, law=law or llm.Frictionless())],
            loads=[llm.FreeSurfacePressure(tags, 1, self.p, covered_by=(tags, 4))],
        )
        self.disc = sides.index(1)

    def solve(self, down, p):
        """Width over which the pressure is missing, that of the nodes in contact, and their force;
        as if not turned."""
        self.motion.value, self.p.value = self.Q @ [0.0, -down], p
        self.problem.solve(increments=1)
        side, Q = self.problem.results[0].sides[self.disc], self.Q
        closed, push = (side.x @ Q)[side.status > 0], self.problem.pushed.reshape(-1, 2)
        width = 2.0 - (push.sum(axis=0) @ Q)[1] / p  # contact's own forces cancel
        return width, np.ptp(closed[:, 0]), (side.force.sum(axis=0) @ Q)[1]


@pytest.mark.parametrize(
    ("sizes", "more"),
    [
        ((0.05, 0.07), {}),
        longer((0.07, 0.05), {}),
        longer((0.05, 0.07), {"turn": 0.7, "sides": (4, 1)}),
        longer((0.05, 0.07), {"law": llm.Coulomb(0.3)}),
        longer((0.1, 0.13), {"degree": 2}),
    ],
)
def test_fluid_beside_a_round_contact(sizes, more):
    """It presses on all that does not touch, also where the gap closes like a wedge: the resultant
    is p times the chord but for the width of contact, to a facet at each end. The same whether the
    fluid comes first or the motion."""
    scene = HalfDisc(sizes, **more)
    missing, closed, force = scene.solve(0.1, 5.0)
    assert len(scene.problem.history) <= 20 and scene.problem.history[-1]["part"] == 1.0
    step = max(sizes) / more.get("degree", 1)
    assert -2.0 * step < missing - closed < 1e-9
    assert abs(missing - 0.527) < max(sizes)
    assert force == pytest.approx(-5.05, rel=0.03)  # sizes of 0.012 and 0.03
    if "law" not in more:
        other = HalfDisc(sizes, **more)
        other.solve(0.1, 1e-9)
        again = other.solve(0.1, 5.0)  # rows are designed where a step starts
        assert np.abs(np.subtract(again, (missing, closed, force))).max() < 5e-3


def folded(monkeypatch, kind, mu, last, p, covering):
    """A hairpin pressed flat, at last to a way, under a pressure inside of it, which parts that
    touch may cover: its problem and all displacements."""
    domain, tags = folding.hairpin(MPI.COMM_SELF, kind=kind)
    covered_by = (tags, folding.INSIDE) if covering else None
    load = llm.FreeSurfacePressure(tags, folding.INSIDE, p, covered_by=covered_by)
    loaded = partial(NonlinearContactProblem, loads=[load])
    with monkeypatch.context() as patch:
        patch.setattr(llm, "NonlinearContactProblem", loaded)
        problem, jaws = folding.problem(domain, tags, mu)
    found = []
    for way in (0.5, 0.8, 0.96, last):
        for jaw, side in zip(jaws, (1.0, -1.0), strict=True):
            jaw.value = side * way
        problem.solve()
        found.append(problem.u.x.array.copy())
    return problem, np.array(found)


@pytest.mark.parametrize(
    ("kind", "mu", "last"), [("quad", 0.0, 1.02), longer("hex", 0.3, 1.01)], ids=["quad", "hex"]
)
def test_a_surface_that_covers_itself(kind, mu, last, monkeypatch):
    """A pressure on both of two parts that touch does what contact that bears as much more does:
    the same displacements, and forces of contact that differ by it. Legs of hexahedra want
    friction: without they slip off each other to either side, by rounding."""
    p, of = 0.02, (monkeypatch, kind, mu, last)
    (pressed, before), (covered, after) = (folded(*of, p, c) for c in (False, True))
    assert np.abs(after - before).max() < 1e-9
    for less, side in zip(pressed.results[0].sides, covered.results[0].sides, strict=True):
        touch = side.facets[(side.status > 0)[side.facets].all(axis=1)]
        area = np.linalg.norm(vector_areas(side.x, touch), axis=1).sum()
        added = (side.normal_force - less.normal_force).sum()
        assert added == pytest.approx(p * area, rel=1e-3)
    assert len({entry["part"] for entry in covered.history}) == 1


def squeezed(kind, degree, covering):
    """A block under a pressure on all of its surface, between a floor and a lid that may cover it;
    and which of these bear what."""
    gdim = 2 if kind == mesh.CellType.quadrilateral else 3
    corners = [np.array([-1.0] * (gdim - 1) + [0.0]), np.ones(gdim)]
    make = mesh.create_rectangle if gdim == 2 else mesh.create_box
    domain = make(MPI.COMM_SELF, corners, [4] * gdim, kind)
    skin = np.sort(mesh.locate_entities_boundary(domain, gdim - 1, lambda x: x[0] < 2.0))
    tags = mesh.meshtags(domain, gdim - 1, skin, np.ones(len(skin), dtype=np.int32))
    V = compat.function_space(domain, degree=degree, shape=(gdim,))
    up = np.eye(gdim)[-1]
    floor, lid = llm.RigidPlane(0.0 * up, up), llm.RigidPlane(up, -up, displacement=-0.05 * up)
    bcs = []
    for k in range(gdim - 1):
        space, _ = V.sub(k).collapse()
        middle = fem.locate_dofs_geometrical(
            (V.sub(k), space), lambda x, k=k: np.isclose(x[k], 0.0)
        )
        bcs.append(fem.dirichletbc(fem.Function(space), middle, V.sub(k)))
    u = fem.Function(V)
    load = llm.FreeSurfacePressure(tags, 1, 5.0, covered_by=[floor, lid] if covering else None)
    problem = llm.NonlinearContactProblem(
        finite_patch.residual(u, *finite_patch.lame(100.0, 0.3), degree), u, bcs=bcs,
        interfaces=[llm.Interface(tags, (1, o), law=llm.Frictionless()) for o in (floor, lid)],
        loads=[load],
    )  # fmt: skip
    problem.solve()
    side = problem.results[0].sides[0]
    area = np.prod(np.ptp(side.x[side.status > 0][:, :-1], axis=0))
    return u.x.array.copy(), area, [result.resultant @ up for result in problem.results]


@pytest.mark.parametrize(
    ("kind", "degree"),
    [
        (mesh.CellType.quadrilateral, 1),
        longer(mesh.CellType.quadrilateral, 2),
        (mesh.CellType.hexahedron, 1),
        longer(mesh.CellType.tetrahedron, 2),
    ],
)
def test_obstacles_that_cover(kind, degree):
    """What contact bears more is the pressure that is left out."""
    (u, area, less), (same, _, more) = (squeezed(kind, degree, c) for c in (False, True))
    assert np.abs(u - same).max() < 1e-9
    assert np.subtract(less, more) == pytest.approx([5.0 * area, -5.0 * area], rel=1e-9)


def test_covers_of_both_kinds():
    """An obstacle that never touches covers nothing, beside a surface that does; one that no
    interface has is an error."""
    found = []
    for several in (False, True):
        problem, u, down = covered((6, 4), lid=several)
        down.value = -0.04
        problem.solve()
        found.append(u.x.array.copy())
    assert np.abs(found[1] - found[0]).max() < 1e-12
    domain, tags = fd.blocks((2, 2), (1.0, 0.6), shift=0.17)
    V, u, F = fd.bodies_of(domain)
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    load = llm.FreeSurfacePressure(tags, fd.LOW, 1.0, covered_by=plane)
    with pytest.raises(llm.ContactInputError, match="and RigidPlane, and contact tells"):
        llm.NonlinearContactProblem(F, u, loads=[load])
    with pytest.raises(llm.ContactInputError, match="covered_by"):
        llm.FreeSurfacePressure(tags, fd.LOW, 1.0, covered_by=[plane, tags])


def test_parts_of_a_surface_that_meets_itself():
    """A cover that has a part of the loaded facets is no surface across."""
    domain, tags = folding.hairpin(MPI.COMM_SELF)
    legs = mesh.locate_entities_boundary(
        domain, 1, lambda x: np.isclose(np.abs(x[1]), folding.RADIUS) & (x[0] < 1e-9)
    )
    legs = mesh.meshtags(domain, 1, legs, np.ones(len(legs), dtype=np.int32))
    load = llm.FreeSurfacePressure(legs, 1, 0.1, covered_by=(tags, folding.INSIDE))
    V = compat.function_space(domain, shape=(2,))
    u = fem.Function(V)
    F = finite_patch.residual(u, *finite_patch.lame(100.0, 0.3), 1)
    with pytest.raises(llm.ContactInputError, match=f"have {len(legs.indices)} facets in common"):
        llm.NonlinearContactProblem(
            F, u, interfaces=[llm.SelfContact(tags, folding.INSIDE)], loads=[load]
        )


@pytest.mark.parametrize("gdim", [2, longer(3)])
def test_bore_of_second_order(gdim):
    """Under pressure it is in equilibrium with UFL's own load on the boundary as it bends."""
    domain, tags = bent_rings.ring(8, 0.5, 1.0, 0.0, layers=gdim - 2)
    V, p = compat.function_space(domain, degree=2, shape=(gdim,)), 60.0
    u, v = fem.Function(V), ufl.TestFunction(V)
    F = finite_patch.residual(u, *finite_patch.lame(100.0, 0.3), 2)
    outer = fem.locate_dofs_topological(V, gdim - 1, tags.indices[tags.values == 2])
    zero = fem.Function(V)
    bcs = [fem.dirichletbc(zero, outer)]
    loads = [llm.FreeSurfacePressure(tags, 1, p)]
    llm.NonlinearContactProblem(F, u, bcs=bcs, loads=loads).solve(increments=2)
    grown, n = ufl.Identity(gdim) + ufl.grad(u), ufl.FacetNormal(domain)
    ds = ufl.Measure("ds", domain=domain, subdomain_data=tags, metadata={"quadrature_degree": 8})
    push = p * ufl.inner(ufl.det(grown) * ufl.inv(grown).T * n, v) * ds(1)
    left, whole = (fem.petsc.assemble_vector(fem.form(form)).array for form in (F + push, push))
    left.reshape(-1, gdim)[outer] = 0.0
    assert np.abs(u.x.array).max() > 0.05
    assert np.abs(left).max() < 1e-9 * np.abs(whole).max()
