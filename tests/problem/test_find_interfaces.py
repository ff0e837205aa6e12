"""Interfaces that are found by themselves, against lists by hand."""

import contact_scenes as scenes
import numpy as np
import pytest
import ufl
import wall_scenes as walls
from curved_scenes import FACE_0, FACE_1, rings
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.geometry.facets_near import Polygons, facing_pairs
from dolfinx_llm.operators.bodies import Bodies

COMM = MPI.COMM_SELF


def wall_of(blocks, kind="quadrilateral", **options):
    counts = np.random.default_rng(5).integers(2, 5, (len(blocks), blocks.shape[2]))
    return walls.Wall(COMM, blocks, counts, kind, **options)


def block_of(wall):
    """Block of each body, by its place."""
    low = Bodies([wall.V]).low
    return [int(np.abs(wall.blocks[:, 0] - x).sum(axis=1).argmin()) for x in low]


def named(wall, found):
    """Pairs of blocks of interfaces."""
    block = block_of(wall)
    return sorted(tuple(sorted(block[tag] for _, tag in i.tagged_sides())) for i in found)


@pytest.mark.parametrize(
    ("blocks", "kind"),
    [
        (walls.courses(4, 5), "quadrilateral"),
        (walls.courses(3, 3, bond=0.3), "triangle"),
        (walls.cubes(2, 2, 2), "tetrahedron"),
        (walls.courses(3, 2, depth=0.7), "hexahedron"),
    ],
)
def test_all_and_none_besides(blocks, kind):
    """Neither blocks that meet at an edge or a corner alone, nor those further on."""
    wall = wall_of(blocks, kind)
    found = llm.find_interfaces(None, wall.V)
    assert named(wall, found) == sorted(tuple(sorted((i, j))) for i, _, j in wall.faces)
    assert all(isinstance(interface.law, llm.Tied) for interface in found)
    of_a_list = llm.find_interfaces([None], [wall.V])
    assert str(of_a_list) == str(found) and f"Interface({found[0].name}, law=Tied" in str(found)
    names = [interface.name for interface in found]
    assert names == [f"{a} | {b}" for a, b in (name.split(" | ") for name in names)]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("degree", [1, 2])
def test_they_pass_a_constant_stress(degree):
    """As the pairs of whole faces do; facets that nothing touches are left out."""
    wall = wall_of(walls.courses(2, 3), turn=0.3, degree=degree)
    stress = np.array([[1.0, 0.4], [0.4, -0.7]])
    a, L = wall.forms(stress)
    with llm.ContactProblem(
        a, L, bcs=wall.supports(), interfaces=llm.find_interfaces(wall.tags, wall.V)
    ) as problem:
        assert wall.stress_error(problem.solve(), stress) <= 1e-11


@pytest.mark.parametrize(("gap", "near"), [(0.01, True), (0.2, False), (-0.01, True)])
def test_distance(gap, near):
    """Two blocks apart or in each other: within a tenth of a facet, or within what is asked for."""
    blocks = np.array([[[0.0, 0.0], [1.0, 0.5]], [[0.3, 0.5 + gap], [1.3, 1.0]]])
    wall = wall_of(blocks, faces=[])
    if near:
        assert len(llm.find_interfaces(None, wall.V)) == 1
    else:
        with pytest.raises(llm.ContactError, match="no two of the 2 bodies .* a tenth"):
            llm.find_interfaces(None, wall.V)
    assert len(llm.find_interfaces(None, wall.V, distance=1.01 * abs(gap))) == 1
    with pytest.raises(llm.ContactError, match="no two of the 2 bodies"):
        llm.find_interfaces(None, wall.V, distance=0.99 * abs(gap))


def test_angle():
    """A block that stands on its edge line, tilted by 0.2: its lower face is off by as much."""
    blocks = np.array([[[0.0, 0.0], [1.0, 0.5]], [[0.0, 0.5], [1.0, 1.0]]])
    wall = wall_of(blocks, faces=[])
    x, turn = wall.domain.geometry.x, 0.2
    nodes = np.unique(walls.compat.cell_dofs(wall.domain.geometry)[wall.body == 1])
    x[nodes, 1] += np.tan(turn) * x[nodes, 0]
    assert len(llm.find_interfaces(None, wall.V, None, None, None, 1.01 * turn)) == 1
    with pytest.raises(llm.ContactError, match="no two of the 2 bodies"):
        llm.find_interfaces(None, wall.V, angle=0.99 * turn)


def test_laws_by_cell_tags():
    """Blocks of a wall are of two kinds; a law for each pair of kinds, or for some of them."""
    wall = wall_of(walls.courses(3, 3, bond=0.0))
    cells = np.arange(len(wall.body), dtype=np.int32)
    kind = np.array([0, 1, 0, 0, 1, 1, 0, 1, 0])
    tags = mesh.meshtags(wall.domain, 2, cells, (10 + kind[wall.body]).astype(np.int32))
    laws = {(10, 11): llm.Coulomb(0.3), (11, 11): llm.Frictionless()}
    for law in (None, llm.Tied()):
        found = llm.find_interfaces(None, wall.V, law=law, laws=laws, cell_tags=tags)
        expected = {}
        for i, _, j in wall.faces:
            pair = tuple(sorted((i, j)))
            chosen = laws.get(tuple(sorted((10 + kind[i], 10 + kind[j]))), law)
            if chosen is not None:
                expected[pair] = chosen
        assert named(wall, found) == sorted(expected)
        for interface in found:
            (pair,) = named(wall, [interface])
            assert interface.law is expected[pair]


def test_two_meshes():
    """Bodies on meshes of their own, of other kinds of cells."""
    low, high = np.split(walls.courses(2, 2, bond=0.3), [2])
    one, other = wall_of(low, faces=[]), wall_of(high, "triangle", faces=[])
    found = llm.find_interfaces(None, [one.V, other.V])
    bodies = Bodies([one.V, other.V])
    pairs = [tuple(bodies.low[[tag for _, tag in i.tagged_sides()]].ravel()) for i in found]
    assert len(pairs) == 1 + 2 + 4 and len(set(pairs)) == 7
    apart = [i for i in found if i.tagged_sides()[0][0] is not i.tagged_sides()[1][0]]
    assert len(apart) == 4
    with pytest.raises(llm.ContactInputError, match=r"give one for each of the 2"):
        llm.find_interfaces(one.tags, [one.V, other.V])


def test_ring_in_a_ring():
    """Curved surfaces whose meshes do not match: all round, of both the facets of the circle."""
    V, tags = rings(COMM, ((24, 2), (31, 2)), degrees=360.0)
    (found,) = llm.find_interfaces(None, V)
    marked = {tuple(own.find(tag)) for own, tag in found.tagged_sides()}
    assert marked == {tuple(tags.find(FACE_0)), tuple(tags.find(FACE_1))}


@pytest.mark.parametrize("kind", ["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def test_nothing_is_found_through_a_plate(kind):
    """Sheets much thinner than their facets, looked at within three sheets: neighbours alone, by
    the faces that touch alone, not by their far sides."""
    depth, thin = ([1.0], 0.02) if kind in ("hexahedron", "tetrahedron") else ([], 0.02)
    ends = np.array([0.0, 0.5, *(0.5 + thin * np.arange(1, 4)), 1.0 + 3 * thin])
    blocks = [([0.0, a, *[0.0] * len(depth)], [1.0, b, *depth]) for a, b in zip(ends, ends[1:])]
    wall = wall_of(np.array(blocks), kind)
    found = llm.find_interfaces(None, wall.V, distance=3.5 * thin)
    assert named(wall, found) == [(k, k + 1) for k in range(4)]
    block = block_of(wall)
    for interface in found:
        level = ends[1 + min(block[tag] for _, tag in interface.tagged_sides())]
        for own, tag in interface.tagged_sides():
            at = mesh.compute_midpoints(wall.domain, wall.gdim - 1, own.find(tag))[:, 1]
            assert len(at) and np.abs(at - level).max() < 1e-9


def test_faces_of_a_slot():
    """A block in a slot, with play at its flanks: each face has its plane. As one interface the
    normal was rounded off at the edges, and forces arose where nothing presses."""
    at = [(0, 0), (1, 0), (2, 0), (0, 1), (2, 1)]
    squares = [2.0 * np.array(at), 2.0 * np.array([(1, 1)])]
    points, cells, play = [], [], 0.05
    for low, n in zip(squares, (4, 5), strict=True):
        for corner in low:
            s, t = (a.ravel() for a in np.meshgrid(*[np.linspace(0.0, 2.0, n + 1)] * 2))
            x = corner + np.column_stack([s, t])
            if n == 5:
                x = np.column_stack([play + 2.0 + (1.0 - play) * s, x[:, 1]])
            i, j = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(n)))
            first = sum(map(len, points)) + (n + 1) * j + i
            cells.append(np.column_stack([first, first + 1, first + n + 1, first + n + 2]))
            points.append(x)
    joined = 5 * 25  # of the slot: squares share their nodes
    x, number = np.unique(np.concatenate(points)[:joined].round(9), axis=0, return_inverse=True)
    number = np.concatenate([number.ravel(), len(x) + np.arange(36)])
    x = np.concatenate([x, points[-1]])
    domain = compat.create_mesh(COMM, number[np.concatenate(cells)], x, "quadrilateral")
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    load = fem.Constant(domain, np.zeros(2))
    pushed = ufl.inner(load, w) * ufl.dx
    a = ufl.inner(scenes.stress(u), ufl.grad(w)) * ufl.dx + 1e-3 * ufl.inner(u, w) * ufl.dx
    bcs = scenes.hold_all(V, lambda p: p[1] < 1e-9, lambda p: 0.0 * p)
    found = llm.find_interfaces(None, V, llm.Frictionless(), distance=0.2)
    assert len(found) == 3
    with llm.ContactProblem(a, pushed, bcs=bcs, interfaces=found) as problem:
        for down in (0.0, -1.0):
            load.value = [0.0, down]
            problem.solve()
            across = [np.abs(side.force).sum(axis=0) for r in problem.results for side in r.sides]
            assert np.max(across, axis=0)[0] < 1e-9
            assert down or not np.any(across)


def test_distance_of_facets_that_cross():
    """Triangles at random whose corners lie beside each other, against points all over them."""
    rng, limit, told = np.random.default_rng(11), 0.3, []
    share = rng.dirichlet([0.7] * 3, 4000)
    for _ in range(150):
        p, q = rng.normal(size=(2, 3, 3)) * [1.0, 1.0, 0.15]
        q[:, 2] += rng.uniform(0.1, 0.6)
        n, m = np.cross(p[1] - p[0], p[2] - p[0]), np.cross(q[1] - q[0], q[2] - q[0])
        p, n = (p, n) if n[2] > 0.0 else (p[::-1], -n)
        q, m = (q, m) if m[2] < 0.0 else (q[::-1], -m)
        n, m = n / np.linalg.norm(n), m / np.linalg.norm(m)
        along = (n - m) / np.linalg.norm(n - m)
        x = share @ p
        gap = ((q[0] - x) @ m) / (along @ m)
        inside = np.linalg.solve(q.T, (x + gap[:, None] * along).T).min(axis=0) > 0.0
        least = np.abs(gap[inside]).min(initial=np.inf)
        parts = [Polygons(np.array([p, q]), np.array([n, m]))]
        found = len(facing_pairs(parts, np.arange(2), limit, 1.2)[0]) > 0
        if abs(least - limit) > 0.03 and inside.sum() > 20 and -n @ m > np.cos(1.2):
            told.append((found, least <= limit))
    assert len(told) > 50 and len(set(told)) == 2 and all(a == b for a, b in told)
