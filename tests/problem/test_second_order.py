"""Second-order bodies: stresses that are constant or linear pass between any two meshes."""

import bent_rings
import hertz2d
import hertz_meshes
import numpy as np
import pytest
import second_order_blocks as so
import ufl
from conftest import run_mpi_json
from dolfinx import fem
from dolfinx.mesh import meshtags
from mpi4py import MPI
from sampling import longer
from scipy.interpolate import griddata
from scipy.spatial.transform import Rotation

import dolfinx_llm as llm
from dolfinx_llm.geometry.element import ELEMENTS, element_of
from dolfinx_llm.geometry.loads import NodalLoads, covered_loads
from dolfinx_llm.geometry.overlap_flat import common_area, common_plane
from dolfinx_llm.geometry.surface import extract_surface
from dolfinx_llm.interface.density import kinks
from dolfinx_llm.interface.site import say_straight

COMM = MPI.COMM_SELF
TRI, QUAD, TET, HEX = "triangle", "quadrilateral", "tetrahedron", "hexahedron"
LOW = {2: ((0, 0), (0, 1)), 3: ((0, 0, 0), (0, 0, 1))}
HIGH = {2: ((1, 1), (1, 2)), 3: ((1, 1, 1), (1, 1, 2))}
PARTS = {  # where the upper block begins and ends
    2: [(0.137, 0.871), (0.27, 1.31)],
    3: [((0.137, 0.21), (0.871, 0.93)), ((0.27, -0.3), (1.31, 0.8))],
}
TURN = Rotation.from_euler("xyz", [0.3, 0.5, 0.7]).as_matrix()


def scene(kinds, n, part=None, **chosen):
    gdim = 2 if kinds[0] in (TRI, QUAD) else 3
    low, high = LOW[gdim], HIGH[gdim]
    if part is not None:
        start, end = PARTS[gdim][part]
        low = low[0], (*np.atleast_1d(start), 1)
        high = high[0], (*np.atleast_1d(end), 2)
    return so.blocks(COMM, kinds, n, low, high, **chosen)


def solved(kinds, n, part=None, degree=2, interface=None, **chosen):
    spaces, tags = scene(kinds, n, part, **chosen)
    field = so.Polynomial(degree, spaces[0].mesh.geometry.dim)
    problem = so.patch_problem(spaces, tags, field, interface)
    return problem, field, so.largest_error(problem.solve(), field)


def check_patch(problem, field, found, degree=2):
    """Require the exact answer, and the exact traction at the nodes of both sides."""
    bound = 1e-11 if degree == 1 else 1e-10
    assert found <= bound
    result, (geometry,) = problem.results[0], problem.geometries
    assert geometry.certificate.residual <= 1e-13
    surfaces = [p.surface for p in geometry.pairs]
    for p, side, other in zip(geometry.pairs, result.sides, surfaces[::-1], strict=True):
        exact = -so.covered_forces(p.surface, other, field)[p.nodes]
        assert np.abs(side.force - exact).max() <= bound * np.abs(exact).max()
        traction = -np.einsum("nij,nj->ni", field.stress(side.x), side.normal)
        assert np.abs(side.density - traction).max() <= 1e-8 * np.abs(traction).max()


@pytest.mark.parametrize(("kinds", "n", "part", "chosen"), [
    ((TRI, QUAD), (4, 7), None, {"turn": TURN[:2, :2] / np.sqrt(np.linalg.det(TURN[:2, :2]))}),
    ((QUAD, TRI), (6, 8), 0, {}),
    ((TRI, TRI), (8, 6), 1, {}),
    ((TET, HEX), (2, 3), None, {"turn": TURN}),
    ((HEX, TET), (3, 3), 0, {}),
    ((TET, TET), (3, 2), 1, {}),
])  # fmt: skip
def test_linear_stress_passes(kinds, n, part, chosen):
    """Any two meshes, also where only a part is covered, and however they are turned."""
    check_patch(*solved(kinds, n, part, **chosen))


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("part", [None, 0, 1])
@pytest.mark.parametrize("kinds", [
    (TRI, TRI), (TRI, QUAD), (QUAD, TRI), (QUAD, QUAD),
    (TET, TET), (TET, HEX), (HEX, TET), (HEX, HEX),
])  # fmt: skip
def test_stresses_pass(kinds, part, degree):
    n = (12, 17) if kinds[0] in (TRI, QUAD) else (4, 3)
    check_patch(*solved(kinds, n, part, degree), degree)


@pytest.mark.parametrize("degrees", [(1, 2), (2, 1)])
@pytest.mark.parametrize(("kinds", "n"), [((TRI, QUAD), (4, 6)), ((TET, TET), (3, 2))])
def test_constant_stress_passes_between_bodies_of_first_and_second_order(kinds, n, degrees):
    problem, _, found = solved(kinds, n, degree=1, degrees=degrees)
    assert found <= 1e-11
    assert problem.results[0].frame.element.order == 1


def test_without_a_design_linear_stress_does_not_pass():
    _, _, found = solved((TRI, QUAD), (4, 7), interface={"design": None})
    assert found > 1e-4


def test_third_order_in_displacement_second_in_stress_and_traction():
    errors = []
    for n in ((8, 12), (16, 24)):
        field, (spaces, tags) = so.Waves(2), scene((TRI, QUAD), n)
        problem = so.manufactured_problem(spaces, tags, field)
        found = so.errors(problem.solve(), field)
        errors.append([*found, *so.traction_errors(problem.results[0], field)])
    rates = np.log2(np.divide(*errors))
    assert (rates >= [2.9, 1.95, 1.85, 1.85]).all(), rates


@pytest.mark.long
@pytest.mark.parametrize("kind", [TRI, QUAD, TET, HEX])
def test_no_worse_than_matching_meshes(kind):
    """Meshes 2:3 against those of the coarser side's size on both: of third order in displacement,
    of second in its gradient and in tractions, those of both read by the integrals of the shape
    functions' products alone. What the package reads is better still. Between hexahedra of one size
    pressures of degree 2 pass, and tractions are of third order; by the integrals alone those of a
    finer side, which is held to the coarser one's polynomials, stay of second."""
    gdim = 2 if kind in (TRI, QUAD) else 3
    sizes = (8, 16, 24, 48) if gdim == 2 else (3, 4, 6, 8)

    def found(*n):
        field, (spaces, tags) = so.Waves(gdim), scene((kind, kind), n)
        problem = so.manufactured_problem(spaces, tags, field)
        errors = so.errors(problem.solve(), field)
        (result,), (geometry,) = problem.results, problem.geometries
        own = so.traction_errors(result, field, geometry)
        return np.array([*errors, *own, *so.traction_errors(result, field)])

    errors = np.array([found(n, 3 * n // 2) for n in sizes])
    matching = np.array([found(n, n) for n in sizes])
    most = np.array([1.2, 1.2, 1.2, 2.0 if kind == HEX else 1.2])
    assert (errors[:, :4] <= most * matching[:, :4]).all()
    assert (errors[:, 4:] <= most[2:] / 1.2 * matching[:, 2:4]).all()
    rates = np.log(errors[0] / errors[-1]) / np.log(sizes[-1] / sizes[0])
    assert (rates[:4] >= [2.9, 1.95, 1.9, 1.9]).all(), rates


@pytest.mark.parametrize(("kind", "n", "jitter"), [
    (TRI, (16, 24), 0.0), (QUAD, (24, 16), 0.15), (HEX, (4, 6), 0.15), longer(TET, (4, 6), 0.0),
])  # fmt: skip
def test_tractions_of_the_finer_side(kind, n, jitter):
    """As exact as between meshes that match, as fine as the coarser side, and those of the coarser
    side nearly; by themselves finer sides tell 1.1 to 1.8 times as much. Resultants and moments are
    those of the forces."""
    gdim = 2 if kind in (TRI, QUAD) else 3

    def found(*n):
        spaces, tags = scene((kind, kind), n, jitter=jitter)
        problem = so.manufactured_problem(spaces, tags, field)
        problem.solve()
        return problem

    field, finer = so.Waves(gdim), int(n[1] > n[0])
    problem, matching = found(*n), found(min(n), min(n))
    errors = so.traction_errors(problem.results[0], field)
    assert errors[finer] <= so.traction_errors(matching.results[0], field)[finer]
    assert errors[finer] <= 1.1 * errors[1 - finer]
    (geometry,), (result,) = problem.geometries, problem.results
    for pairs, side in zip(geometry.pairs, result.sides, strict=True):
        acts = pairs.loads.mass @ side.density
        arms = np.einsum("ni,nj->ij", side.x, acts - side.force)
        assert np.abs((acts - side.force).sum(axis=0)).max() <= 1e-12 * np.abs(acts).sum()
        assert np.abs(arms - arms.T).max() <= 1e-12 * np.abs(acts).sum()


def test_tractions_where_rows_need_larger_corrections():
    """Half as far off as between meshes that match, at most, also where rows are corrected by 0.19:
    stencils of one ring of nodes are enough, with two errors were 3 times as large."""
    field, found = so.Waves(2), []
    for n in ((16, 24), (16, 16)):
        spaces, tags = scene((QUAD, QUAD), n, jitter=0.3, seed=18)
        problem = so.manufactured_problem(spaces, tags, field)
        problem.solve()
        found.append(max(so.traction_errors(problem.results[0], field)))
    assert found[0] <= 0.5 * found[1]


@pytest.mark.parametrize("n", [(16, 24), (24, 16), (64, 96)])
def test_tractions_of_the_finer_ring(n):
    """Along a circle: 1.1 to 2.7 times those between meshes that match were told."""
    finer = int(n[1] > n[0])
    problem, matching = bent_rings.tied(n, 0.1), bent_rings.tied((min(n), min(n)), 0.0)
    errors = bent_rings.errors(problem)[2:]
    assert errors[finer] <= max(bent_rings.errors(matching)[2:])


def test_steep_ends_are_told_by_the_finer_side():
    """Of a soft body on a stiff one, whose tractions rise steeply at its edges: a coarser side
    tells less of these."""
    spaces, tags = scene((QUAD, QUAD), (16, 64), jitter=0.0)
    V, gdim = spaces[0], 2
    x, u, w = ufl.SpatialCoordinate(V.mesh), ufl.TrialFunction(V), ufl.TestFunction(V)
    soft = ufl.conditional(ufl.lt(x[1], 1.0), 1.0, 0.01)
    a = soft * ufl.inner(so.stress(u), ufl.grad(w)) * ufl.dx
    L = ufl.dot(fem.Constant(V.mesh, np.zeros(gdim)), w) * ufl.dx
    ends = so.held_ends(V, tags[0], so.Pressed(gdim))
    interface = llm.Interface(tags[0], (2, 3), law=llm.Tied())
    problem = llm.ContactProblem(a, L, bcs=[ends], interfaces=[interface])
    problem.solve()
    coarser, finer = (np.abs(s.density[:, 1]).max() for s in problem.results[0].sides)
    assert finer >= 1.3 * coarser


@pytest.mark.parametrize("part", [False, True])
def test_pressures_of_degree_2_pass_between_hexahedra(part):
    """At every frame node, rough facets that cover each other, or in part."""
    low, high = ((0, 0, 0), (0.3 * part, 0.4 * part, 1)), ((1, 1, 1), (1, 1, 2))
    spaces, tags = so.blocks(MPI.COMM_SELF, (HEX, HEX), (4, 6), low, high)
    problem = so.manufactured_problem(spaces, tags, so.Waves(3))
    (geometry,) = problem.geometries
    for p in (lambda x: x[:, 0] ** 2 - x[:, 0] * x[:, 1], lambda x: x[:, 1] ** 2 + x[:, 0]):
        forces = [pairs.N.T @ (pairs.loads.mass @ p(pairs.x)) for pairs in geometry.pairs]
        assert np.abs(forces[0] - forces[1]).max() <= 1e-12 * np.abs(forces).max()


def test_tractions_between_regular_hexahedra():
    """Of the coarser side as exact as between meshes that match: 6 to 8 times as much was left."""

    def found(*n):
        field = so.Waves(3)
        spaces, tags = so.blocks(MPI.COMM_SELF, (HEX, HEX), n, jitter=0.0)
        problem = so.manufactured_problem(spaces, tags, field)
        problem.solve()
        return np.array(so.traction_errors(problem.results[0], field, *problem.geometries))

    assert (found(4, 6) <= [1.2, 2.4] * found(4, 4)).all()


@pytest.mark.parametrize(("kind", "n"), [(QUAD, (12, 13)), (HEX, (4, 5))])
@pytest.mark.parametrize("law", [llm.Coulomb(0.3), llm.Tied(), llm.Frictionless()], ids=str)
def test_tractions_of_facets_that_overhang(kind, n, law):
    """Coarser facets that the finer side covers in part, where tractions rise steeply towards its
    end: they tell no multiple of its own; ten times as much was told."""
    problem = so.overhanging(kind, n, law)
    problem.solve()
    finer, coarser, told = so.largest_pressures(problem.results[0])
    assert max(coarser, told) <= 1.05 * finer


@pytest.mark.parametrize("kind", ELEMENTS)
def test_shape_functions(kind):
    """One at their own node, of sum one, with linear and quadratic fields, and their slopes."""
    element, rng = element_of(*kind), np.random.default_rng(2001)
    corners = {2: [[0], [1]], 3: [[0, 0], [1, 0], [0, 1]], 4: [[-1, -1], [1, -1], [1, 1], [-1, 1]]}
    x = element.linear @ np.array(corners[element.corners], float)
    assert np.abs(element.shape(x)[0] - np.eye(element.nodes)).max() < 1e-14
    xi, c = rng.uniform(-0.7, 0.9, (40, kind[0])), rng.uniform(-1, 1, (3, kind[0]))
    N, dN = element.shape(xi)

    def polynomial(p):
        return 0.3 + p @ c[0] + (element.order > 1) * (p @ c[1]) * (p @ c[2])

    assert np.abs(N @ polynomial(x) - polynomial(xi)).max() < 1e-14
    for a, step in enumerate(1e-6 * np.eye(kind[0])):
        slope = (element.shape(xi + step)[0] - element.shape(xi - step)[0]) / 2e-6
        assert np.abs(slope - dN[..., a]).max() < 1e-8
    turned = np.arange(element.corners)[None, ::-1]
    order = element.permuted(np.arange(element.nodes)[None], turned)[0]
    assert np.abs(x[order] - element.linear @ x[turned[0]]).max() < 1e-15


@pytest.mark.parametrize("kinds", [(TRI, TRI), (TET, HEX), (HEX, TET)])
def test_forces_and_moments_of_clipped_facets(kinds):
    """Against sums over many small parts: of both sides they have the same resultants under
    pressures 1, s and, since shape functions reproduce them, work on polynomials of degree 2."""
    problem, *_ = solved(kinds, (3, 4), 1)
    (geometry,) = problem.geometries
    plane, totals = geometry.parts[0].piece.plane, []
    for pairs in geometry.pairs:
        s, load = plane.project(pairs.x), pairs.loads
        pi = [np.ones(len(s)), *s.T, *(s[:, i] * s[:, j] for i in (0, -1) for j in (0, -1))]
        first = load.moments + s * load.forces[:, None]
        totals.append([[p @ load.forces, *(p @ first)] for p in pi])
        ones = np.ones(len(s))
        assert np.abs(load.mass @ ones - load.forces).max() <= 1e-15
        assert np.abs(load.mass @ s - first).max() <= 1e-15
        assert np.isclose(load.shares.sum(), load.forces.sum(), rtol=1e-13)
    assert np.abs(np.subtract(*totals)).max() <= 1e-14


@pytest.mark.parametrize(("kinds", "turn"), [
    ((TRI, QUAD), TURN[:2, :2] / np.sqrt(np.linalg.det(TURN[:2, :2]))), ((TET, HEX), TURN),
])  # fmt: skip
def test_jumps_of_slopes(kinds, turn):
    """Quadratic fields have none; one with a jump of 2 over a line has those of its edges, and one
    over an edge of the body is not counted."""
    spaces, tags = scene(kinds, (5, 4), jitter=0.0, turn=turn)
    for V, own, tag in zip(spaces, tags, (2, 3), strict=True):
        side = extract_surface(V, own, tag)
        x, element = side.x @ np.linalg.inv(turn).T, side.element
        n = 5 if tag == 2 else 4
        S, size = kinks(side.x, side.cells, element), np.linalg.norm(turn[:, 0]) / n
        smooth = x[:, 0] ** 2 - 2.0 * x[:, 0] * x[:, -2] + x[:, -2]
        assert np.abs(S @ smooth).max() <= 1e-12
        bent = np.abs(x[:, 0] - 2 / n)
        slope = 2.0 / np.linalg.norm(turn[:, 0])
        assert bent @ S @ bent == pytest.approx(slope**2 * size**3 * (size * n) ** (len(turn) - 2))
        folded = x.copy()
        folded[:, -1] += 2.0 * np.maximum(x[:, 0] - 2 / n, 0.0)
        assert np.abs(kinks(folded, side.cells, element) @ bent).max() <= 1e-12


def test_frame_of_second_order():
    x = np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0], [1, 0, 0], [1, 0.5, 0], [0, 0.5, 0.0]])
    frame = llm.Frame(x, [[0, 1, 2, 3, 4, 5]])
    assert np.allclose(frame.interpolation(frame.locate(x)).toarray(), np.eye(6), atol=1e-14)
    there = frame.flipped()
    assert there.cells.tolist() == [[2, 1, 0, 4, 3, 5]]
    point = np.array([[0.7, 0.2, 0.3]])
    N = [f.interpolation(f.locate(point)).toarray() for f in (frame, there)]
    assert np.abs(N[0] - N[1]).max() < 1e-15
    bent = x + 0.1 * np.eye(6)[3][:, None] * [0, 0, 1]
    with pytest.raises(llm.ContactError, match="curved"):
        llm.Frame(bent, [[0, 1, 2, 3, 4, 5]])


class Glue(llm.Law):
    """Opens and closes by springs."""

    opens, gives, components = False, True, "local"

    def start(self, nodes):
        raise AssertionError("is refused before")


@pytest.mark.parametrize(("interface", "words"), [
    ({"law": Glue()}, "Glue.* first-order"), ({"design": "positions"}, "positions"),
])  # fmt: skip
def test_what_is_not_there_is_refused(interface, words):
    with pytest.raises(llm.ContactError, match=words):
        solved((TRI, QUAD), (3, 4), interface=interface)


# Curved surfaces


@pytest.mark.parametrize("kinds", [(TRI, QUAD), (TET, TET), (HEX, TET)], ids=str)
@pytest.mark.parametrize("part", [0, 1])
def test_flat_surfaces_taken_for_curved_ones(kinds, part):
    """What each covers of the other, also where facets are cut: the same integrals."""
    spaces, tags = scene(kinds, (4, 6), part)
    ends = zip((0, -1), (so.TOP[0], so.BOTTOM[1]), strict=True)
    sides = [extract_surface(spaces[k], tags[k], tag) for k, tag in ends]
    plane = common_plane(*sides)
    area = common_area(*sides, plane)
    for side, other in (sides, sides[::-1]):
        known = NodalLoads.on(side, plane.project(side.x), area, 2)
        found, vectors = covered_loads(side, other, np.inf, 2, as_is=True)
        size = known.forces.sum()
        assert np.abs(found.forces - known.forces).max() < 1e-13 * size
        assert abs(found.mass - known.mass).max() < 1e-13 * size
        along = found.moments @ plane.base[: known.moments.shape[1]].T
        assert np.abs(along - known.moments).max() < 1e-13 * size
        assert np.abs(np.linalg.norm(vectors, axis=1) - np.abs(known.forces)).max() < 1e-13 * size


@pytest.mark.parametrize(("coarse", "fine"), [
    ((16, 24), (32, 48)), longer((32, 48), (64, 96)),
])  # fmt: skip
def test_third_order_on_curved_meshes(coarse, fine):
    """A ring in a ring on meshes that do not match: no worse than on meshes that do, the tractions
    of which are read by the integrals of the shape functions' products alone."""
    n = fine[0]
    first, found = (bent_rings.errors(bent_rings.tied(c, 0.13)) for c in (coarse, fine))
    assert (np.log2(first / found) >= [2.8, 1.9, 1.9, 1.9]).all()
    if n > 32:
        assert (found <= 1.2 * bent_rings.errors(bent_rings.tied((n, n), 0.0), True)).all()


@pytest.mark.long
@pytest.mark.parametrize("cells", [bent_rings.shell, bent_rings.bricks])
def test_curved_surfaces_in_space(cells):
    """Along a cylinder, tetrahedra or hexahedra: no worse than on meshes that match."""
    for h in (0.5, 0.25):
        problems = (bent_rings.tied_shells(sizes, cells) for sizes in ((h, h / 1.5), (h, h)))
        found, matching = (bent_rings.errors(p, k > 0) for k, p in enumerate(problems))
        assert (found[:2] <= matching[:2]).all() and (found <= 1.2 * matching).all()


@pytest.mark.long
@pytest.mark.parametrize("degrees", [(1, 2), (2, 1)], ids=str)
def test_first_and_second_order_along_a_circle(degrees):
    """The rates of first order, and less error than between bodies of first order."""
    coarse, fine = (
        bent_rings.errors(bent_rings.tied(c, 0.13, degrees=degrees)) for c in ((16, 24), (32, 48))
    )
    assert (np.log2(coarse / fine) >= [1.8, 1.0]).all()
    assert (fine < bent_rings.errors(bent_rings.tied((32, 48), 0.13, degrees=(1, 1)))).all()


def test_straight_frame_between_curved_bodies_is_refused():
    t = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    corners = np.column_stack([np.cos(t), np.sin(t)])
    middle = 0.5 * (corners + np.roll(corners, -1, axis=0))
    n = np.arange(16)
    frame = llm.Frame(np.vstack([corners, middle]), np.column_stack([n, (n + 1) % 16, n + 16]))
    with pytest.raises(llm.ContactError, match="straight cells of second order"):
        bent_rings.tied((16, 24), 0.13, frame=frame)


# Bodies that may part


DIRECT = {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"}
FORMS = {"own": {}, "condensed": {"solver": "condensed", "petsc_options": DIRECT}}


@pytest.mark.parametrize(("kinds", "n", "law", "form"), [
    ((TRI, QUAD), (5, 7), llm.Frictionless(), "own"),
    ((QUAD, TRI), (7, 5), llm.Coulomb(0.3), "condensed"),
    ((TET, HEX), (3, 2), llm.Frictionless(), "condensed"),
    ((TET, TET), (2, 3), llm.Coulomb(0.3), "own"),
])  # fmt: skip
def test_uniform_pressure_on_a_part_of_facets(kinds, n, law, form):
    """What cut facets carry at nodes may be zero or negative; contact still holds."""
    spaces, tags = scene(kinds, n, 0)
    field = so.Pressed(spaces[0].mesh.geometry.dim)
    problem = so.patch_problem(spaces, tags, field, {"law": law}, **FORMS[form])
    assert so.largest_error(problem.solve(), field) <= 1e-12
    result, pressure = (
        problem.results[0],
        -field.stress(np.zeros((1, len(field.linear))))[0, -1, -1],
    )
    for side in result.sides:
        assert np.abs(side.normal_force - pressure * side.area).max() <= 1e-12 * pressure
        assert (side.status != 0).all()
    assert np.abs(result.pressure - pressure).max() <= 1e-8 * pressure
    for side in result.sides:
        assert np.abs(side.density[:, -1]).max() <= (1.0 + 1e-8) * pressure


def blocks_moved(kinds, n, law, top):
    """A small block on a larger one, held below, the last one's top moved by a function of x."""
    spaces, tags = scene(kinds, n, 0)
    gdim, forms, zero, bcs = spaces[0].mesh.geometry.dim, [], [], []
    for V, own, motion in zip(spaces, tags, (lambda x: 0.0 * x[:gdim], top), strict=True):
        known = fem.Function(V)
        known.interpolate(motion)
        tag = so.BOTTOM[0] if motion is not top else so.TOP[1]
        dofs = fem.locate_dofs_topological(V, gdim - 1, own.find(tag))
        bcs.append(fem.dirichletbc(known, dofs))
        forms.append(so.elasticity(V))
        none = fem.Constant(V.mesh, np.zeros(gdim))
        zero.append(ufl.inner(none, ufl.TestFunction(V)) * ufl.dx)
    interface = llm.Interface(None, ((tags[0], 2), (tags[1], 3)), law=law)
    return llm.ContactProblem(forms, zero, bcs=bcs, interfaces=[interface])


@pytest.mark.parametrize(("kinds", "n"), [
    ((TRI, QUAD), (7, 5)), pytest.param((TET, HEX), (4, 3), marks=pytest.mark.long)
])  # fmt: skip
def test_block_dragged(kinds, n):
    """In full slip friction is μ N at every node of the frame. In 3D its directions differ by up to
    2°, as the surfaces grow sideways while they slip."""

    def along(x):
        gdim = 2 if kinds[0] == TRI else 3
        return np.outer([0.02, *[0.0] * (gdim - 2), -0.002], np.ones(x.shape[1]))

    problem = blocks_moved(kinds, n, llm.Coulomb(0.3), along)
    problem.solve(increments=3)
    result = problem.results[0]
    assert (result.frame_status == 2).all()
    force, friction = result.resultant, np.linalg.norm(result.frame_friction, axis=1).sum()
    assert friction / (0.3 * abs(force[-1])) == pytest.approx(1.0, abs=1e-10)
    assert abs(force[0] / (0.3 * force[-1])) == pytest.approx(1.0, abs=1e-3)
    total = sum(side.force.sum(axis=0) for side in result.sides)
    assert np.abs(total).max() <= 1e-12 * np.abs(force).max()


@pytest.mark.parametrize(("kinds", "n"), [((TRI, QUAD), (9, 7)), ((TET, HEX), (4, 3))])
def test_block_pulled_off_on_one_side(kinds, n):
    """Control values of gaps and of forces are none negative, and of each pair one is zero."""

    def tilted(x):
        gdim = 2 if kinds[0] == TRI else 3
        return np.vstack([0.0 * x[: gdim - 1], 0.004 * (0.5 - x[:1])])

    problem = blocks_moved(kinds, n, llm.Frictionless(), tilted)
    problem.solve()
    pairs, sides = problem.geometries[0].pairs, problem.results[0].sides
    size = max(side.normal_force.max() for side in sides)
    motion = max(np.abs(side.u).max() for side in sides)
    for p, side in zip(pairs, sides, strict=True):
        force = p.control.T @ side.normal_force / size
        gap = np.linalg.solve(p.control.toarray(), side.frame_gap) / motion
        assert force.min() >= -1e-10 and gap.min() >= -1e-7
        assert np.minimum(np.abs(force), np.abs(gap)).max() <= 1e-7
        assert (force > 1e-3).any() and (gap > 1e-3).any()
        assert (side.gap >= 0.0).all()
    for side, other in (sides, sides[::-1]):  # closed nodes are where the other body is
        along, (x, there) = slice(0, -1), (side.x + side.u, other.x + other.u)
        opposite = griddata(there[:, along].squeeze(), there[:, -1], x[:, along].squeeze())
        apart = (opposite - x[:, -1]) * side.normal[:, -1]
        known = np.isfinite(apart)
        assert (np.abs(side.gap - apart)[known] <= 0.02 * motion).all()
        assert (side.status[known & (apart > 0.02 * motion)] == 0).all()


@pytest.mark.parametrize(("elements", "reach", "quads"), [
    ((8, 12), 1.3, False), longer((8, 12), 1.25, False), longer((8, 12), 1.25, True),
    longer((8, 12), 1.35, True), longer((12, 17), 1.3, False),
], ids=str)  # fmt: skip
def test_hertz_on_second_order_meshes(elements, reach, quads, monkeypatch):
    """Pressure at the nodes of both sides, by their own integrals, against the ellipse of the discs
    themselves, which are no half-spaces: that of 32 and 47 elements over a, growth=0.015. Contact
    ends elsewhere in a facet where another part of the surface, ``reach``, is divided."""
    a, p0 = hertz2d.hertz("cylinders")
    a, p0 = 1.00202 * a, 0.99843 * p0
    monkeypatch.setattr(hertz2d, "REACH", reach)
    if quads:
        monkeypatch.setattr(hertz2d, "half_disc", hertz_meshes.disc_of_quads)
    problem = hertz2d.problem("cylinders", elements, growth=1.2 if quads else 0.12, degree=2)
    problem.solve()
    for side in problem.results[0].sides:
        x, p = side.x[:, 0] / a, np.einsum("ni,ni->n", side.density, side.normal) / p0
        assert p.min() >= -1e-12  # also where contact ends
        inner = np.abs(x) < 0.8
        off = p[inner] - np.sqrt(1.0 - x[inner] ** 2)
        assert np.abs(off).max() <= 4e-3 and np.sqrt(np.mean(off**2)) <= 1e-3
        assert hertz2d.fit(x[inner], p[inner])[0] == pytest.approx(1.0, abs=5e-4)


@pytest.mark.long
@pytest.mark.parametrize("meshes", [((12, 1, 0.2), (6, 2, 1.0)), ((17, 1, 0.3), (8, 2, 1.0))])
def test_hertz_in_space(meshes):
    """Tetrahedra of second order against those of first order with more unknowns."""
    first, second = (hertz_meshes.ball_on_plane(*mesh) for mesh in meshes)
    for problem in (first, second):
        problem.solve()
    assert second.unknowns["u"] <= first.unknowns["u"]
    found, known = (np.array(hertz_meshes.ball_errors(p)) for p in (second, first))
    assert (found < known).all(), (found, known)


@pytest.mark.long
def test_long_interfaces_balance():
    """With 332 facets smooth multipliers are next to none in the equations of the corrections."""
    (geometry,) = hertz2d.problem("cylinders", (64, 95), growth=0.12, degree=2).geometries
    assert geometry.certificate.residual <= 1e-13


def test_straight_facets_of_a_curved_surface_are_said():
    a, _ = hertz2d.hertz("cylinders")
    domain, tags = hertz2d.half_disc(COMM, a, 4, 1, 0.3)
    V = so.compat.function_space(domain, degree=2, shape=(2,))
    side, notes = extract_surface(V, tags, hertz2d.CONTACT), []
    say_straight(llm.Interface(tags, (1, llm.RigidPlane((0, 0), (0, 1)))), (side,), notes)
    assert len(notes) == 1 and "setOrder" in notes[0]


def test_a_box_is_no_curve():
    """Tagged all over, its facets are straight as it is; a warning asked for second order."""
    (V,), (tags,) = so.blocks(COMM, (QUAD, QUAD), (2, 3), LOW[2], HIGH[2], jitter=0.0)
    same = np.full_like(tags.values, so.LATERAL)
    tags = meshtags(V.mesh, tags.dim, tags.indices, same)
    skin, notes = extract_surface(V, tags, so.LATERAL), []
    plane = llm.RigidPlane((0, 0), (0, 1))
    say_straight(llm.Interface(tags, (so.LATERAL, plane)), (skin,), notes)
    assert not notes


def test_ranks():
    data = run_mpi_json("second_order_ranks.py", 2)
    assert max(data.values()) <= 1e-10


# Rigid obstacles


class Bent:
    """A body that stands on the plane where its last coordinate is 0, and presses it by a pressure
    that falls along the first: u = (-b z² / 2, ..., z (a + b x))."""

    def __init__(self, gdim, a=-2e-3, b=1e-3):
        self.gdim, self.a, self.b = gdim, a, b

    def __call__(self, x):
        x = x[: self.gdim]
        u = 0.0 * x
        u[0], u[-1] = -0.5 * self.b * x[-1] ** 2, x[-1] * (self.a + self.b * x[0])
        return u

    def pressure(self, x):
        return -(2 * so.MU + so.LAMBDA) * (self.a + self.b * x[:, 0])


def standing(kind, n, field, law, obstacle, **options):
    """A block on an obstacle, with the forces of ``field``, prescribed at its top, at its sides."""
    gdim = 2 if kind in (TRI, QUAD) else 3
    low, high = [(0,) * gdim, (0,) * (gdim - 1) + (9,)], [(1,) * gdim, (1,) * (gdim - 1) + (10,)]
    (V,), (tags,) = so.blocks(COMM, (kind, kind), (n, 1), low, high)
    a, side = so.elasticity(V), extract_surface(V, tags, so.BOTTOM[0])
    load = so.outer_forces(V, a, [], [side], field)
    foot = NodalLoads.whole(side, np.arange(len(side.facets))).mass @ field.pressure(side.x)
    load.x.array[side.dofs * gdim + gdim - 1] -= foot
    known = fem.Function(V)
    known.interpolate(field)
    at = np.sort(np.concatenate([tags.find(tag) for tag in (so.TOP[0], so.BOTTOM[1], so.TOP[1])]))
    bc = fem.dirichletbc(known, fem.locate_dofs_topological(V, gdim - 1, at.astype(np.int32)))
    none = ufl.inner(fem.Constant(V.mesh, np.zeros(gdim)), ufl.TestFunction(V)) * ufl.dx
    interface = llm.Interface(tags, (so.BOTTOM[0], obstacle), law=law)
    return llm.ContactProblem(
        a, none, bcs=[bc], interfaces=[interface], nodal_loads=[load], **options
    )


def floor(gdim, **moved):
    return llm.RigidPlane(np.zeros(gdim), np.eye(gdim)[-1], **moved)


@pytest.mark.parametrize(("kind", "law", "form"), [
    (TRI, llm.Frictionless(), "own"), (QUAD, llm.Coulomb(0.3), "condensed"),
    (TET, llm.Frictionless(), "condensed"), (HEX, llm.Tied(), "own"),
])  # fmt: skip
def test_linear_pressure_on_a_rigid_plane(kind, law, form):
    gdim = 2 if kind in (TRI, QUAD) else 3
    field = Bent(gdim)
    problem = standing(kind, 4 if gdim == 2 else 2, field, law, floor(gdim), **FORMS[form])
    assert so.largest_error(problem.solve(), field) <= 1e-11
    result, (side,) = problem.results[0], problem.results[0].sides
    exact = field.pressure(side.x)
    assert np.abs(result.pressure - exact).max() <= 1e-9 * exact.max()
    assert np.abs(result.traction).max() <= 1e-9 * exact.max()
    assert side.gap.max() == 0.0


@pytest.mark.parametrize(("kind", "n", "law", "form"), [
    (TRI, 5, llm.Frictionless(), "condensed"), (HEX, 3, llm.Coulomb(0.2), "own"),
])  # fmt: skip
def test_ball_pressed_into_a_block(kind, n, law, form):
    """By a force: control values of gaps and forces are none negative, and of each pair one is
    zero; friction holds for them."""
    gdim = 2 if kind == TRI else 3
    up = np.eye(gdim)[-1]
    push = np.append(np.zeros(gdim - 1), 2.0)
    ball = llm.RigidSphere(0.4 * (1 - up) - 1.5 * up, 1.5, force=(*[None] * (gdim - 1), push[-1]))
    problem = standing(kind, n, Bent(gdim, 0.0, 0.0), law, ball, **FORMS[form])
    problem.solve()
    result, (pairs,) = problem.results[0], problem.geometries[0].pairs
    (side,) = result.sides
    assert result.resultant[-1] == pytest.approx(-push[-1], rel=1e-9)
    force = pairs.control.T @ side.force / side.normal_force.max()
    normal = np.einsum("ni,ni->n", force, side.normal)
    gap = np.linalg.solve(pairs.control.toarray(), side.gap)
    assert normal.min() >= -1e-9 and gap.min() >= -1e-9
    assert (normal * gap).max() <= 1e-12 and (gap > 1e-6).any() and (normal > 1e-2).sum() > 2
    tangential = np.linalg.norm(force - normal[:, None] * side.normal, axis=1)
    assert (tangential <= getattr(law, "mu", 0.0) * normal + 1e-9).all()


def test_block_dragged_by_a_turned_plane():
    """In full slip, friction is μ N; the plane's small rotation is met by the nodes' heights."""
    field = Bent(2, -2e-3, 0.0)
    plane = floor(2, displacement=(0.02, 0.0))
    problem = standing(QUAD, 4, field, llm.Coulomb(0.3), plane)
    problem.solve(increments=2)
    force = problem.results[0].resultant
    assert (problem.results[0].sides[0].status == 2).all()
    assert force[0] / (0.3 * force[1]) == pytest.approx(1.0, abs=1e-10)
    plane.rotation, plane.displacement = 1e-3, np.zeros(2)
    problem = standing(QUAD, 4, field, llm.Frictionless(), plane)
    problem.solve()
    (side,) = problem.results[0].sides
    assert np.abs(side.x[:, 1] + side.u[:, 1] - 1e-3 * side.x[:, 0]).max() <= 1e-12
