"""Frame, common area, patch forces and design by weights: plain NumPy, no MPI."""

from types import SimpleNamespace

import curved_scenes as cs
import numpy as np
import paper_data as paper
import pytest
import shapely
from sampling import drawn
from scenes import grid

import dolfinx_llm as llm
from dolfinx_llm.design import weights as design
from dolfinx_llm.design.residual import FrameLoads
from dolfinx_llm.geometry import overlap_flat as patch
from dolfinx_llm.geometry.cells import shape_functions, vector_areas
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.loads import NodalLoads
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.site import places

pytestmark = pytest.mark.quick

CORNERS = {
    2: np.array([[0.0], [1.0]]),
    3: np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
    4: np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]),
}


def triangles(quads):
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def make_frame(k, n=6, seed=23, jitter=0.3):
    """A jittered frame of segments (in the plane), triangles or quads (tilted in space)."""
    rng = np.random.default_rng(seed)
    if k == 2:
        s = np.linspace(0.0, 1.0, n + 1) + rng.uniform(-jitter, jitter, n + 1) / n
        x = np.outer(s, [0.8, 0.6]) + [3.0, -2.0]
        return Frame(x, np.column_stack([np.arange(n), np.arange(1, n + 1)]))
    x, quads = grid(n, n + 1, jitter=jitter, seed=seed)
    Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    x = np.column_stack([x, np.zeros(len(x))]) @ Q.T + [3.0, -2.0, 5.0]
    return Frame(x, quads if k == 4 else triangles(quads))


# Shape functions and location


@pytest.mark.parametrize("k", [2, 3, 4])
def test_shape_functions(k):
    xi = np.random.default_rng(5).uniform(-1.5, 1.5, (200, CORNERS[k].shape[1]))
    N, dN = shape_functions(k, xi)
    assert np.abs(N.sum(axis=1) - 1.0).max() < 1e-14
    assert np.abs(dN.sum(axis=1)).max() < 1e-14
    assert np.abs(N @ CORNERS[k] - xi).max() < 1e-14  # linear fields
    assert np.array_equal(shape_functions(k, CORNERS[k])[0], np.eye(k))
    h = 1e-6
    for d in range(xi.shape[1]):
        step = h * np.eye(xi.shape[1])[d]
        slope = (shape_functions(k, xi + step)[0] - shape_functions(k, xi - step)[0]) / (2 * h)
        assert np.abs(slope - dN[:, :, d]).max() < 1e-9


@pytest.mark.parametrize("k", [2, 3, 4])
@pytest.mark.parametrize("seed", [23, 57, 91])
def test_inverse_mapping(k, seed):
    """Points placed inside known cells are found again."""
    frame = make_frame(k, seed=seed)
    rng = np.random.default_rng(seed)
    cell = np.repeat(np.arange(len(frame.cells)), 5)
    if k == 3:
        xi = rng.dirichlet(np.ones(3), len(cell))[:, 1:] * 0.98 + 0.005
    else:
        low = {2: 0.01, 4: -0.99}[k]
        xi = rng.uniform(low, 0.99, (len(cell), CORNERS[k].shape[1]))
    _, x, _ = frame.evaluate(cell, xi)
    at = frame.locate(x)
    assert np.array_equal(at.cell, cell)
    # The positions carry rounding of 1e-15 over cells of size 0.1.
    assert np.abs(at.xi - xi).max() < 1e-13
    assert at.outside.max() == 0.0
    L = frame.interpolation(at)
    assert np.abs(L @ frame.x - x).max() < 1e-13
    assert np.abs(np.asarray(L.sum(axis=1)) - 1.0).max() < 1e-14


@pytest.mark.parametrize("k", [2, 3, 4])
def test_location_of_frame_nodes(k):
    frame = make_frame(k)
    L = frame.interpolation(frame.locate(frame.x)).toarray()
    assert np.abs(L - np.eye(len(frame.x))).max() < 1e-13


@pytest.mark.parametrize("k", [2, 3, 4])
def test_location_beyond_the_outline(k):
    frame = make_frame(k, jitter=0.15)
    rng = np.random.default_rng(3)
    # In the frame's plane, up to 0.15 (about one cell) beyond it.
    if k == 2:
        s = np.concatenate([rng.uniform(-0.15, -0.06, 20), rng.uniform(1.06, 1.15, 20)])
        x = np.outer(s, [0.8, 0.6]) + [3.0, -2.0]
    else:
        s = rng.uniform(-0.15, 1.15, (400, 2))
        s = s[((s < -0.01) | (s > 1.01)).any(axis=1)]
        corner = frame.x[[0, 6 * 8, 7]]
        x = corner[0] + s @ (corner[1:] - corner[0])
    at = frame.locate(x)
    assert len(x) > 30 and (at.outside > 0.0).all() and at.outside.max() < 3.0
    L = frame.interpolation(at)
    assert np.abs(np.asarray(L.sum(axis=1)) - 1.0).max() < 1e-13
    assert np.abs(L @ frame.x - x).max() < 1e-12


def test_location_beyond_distorted_quads_is_the_closest_point():
    """Against the least distance from the four sides, whose closest points are known."""
    rng = np.random.default_rng(7)
    for _ in range(60):
        corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        corners += rng.uniform(-0.25, 0.25, (4, 2))
        points = rng.uniform(-1.5, 2.5, (30, 2))
        a, edge = corners, np.roll(corners, -1, axis=0) - corners
        along = np.einsum("pei,ei->pe", points[:, None] - a, edge) / (edge**2).sum(axis=1)
        foot = a + np.clip(along, 0.0, 1.0)[..., None] * edge
        least = np.linalg.norm(points[:, None] - foot, axis=2).min(axis=1)
        inside = shapely.contains_xy(shapely.Polygon(corners), *points.T)
        frame = Frame(np.pad(corners, ((0, 0), (0, 1))), [[0, 1, 2, 3]])
        at = frame.locate(np.pad(points, ((0, 0), (0, 1))))
        closest = frame.evaluate(at.cell, at.xi)[1][:, :2]
        distance = np.linalg.norm(points - closest, axis=1)
        assert np.abs(distance - np.where(inside, 0.0, least)).max() < 1e-12


@pytest.mark.parametrize("k", [3, 4])
def test_rows_beyond_the_outline_vary_continuously_along_it(k):
    """Also past the ends of cells; in the middle of a dent no cell is preferred."""
    frame = make_frame(k)
    corner, along = frame.x[0], frame.x[7] - frame.x[0]
    beyond = corner - 0.08 * (frame.x[42] - corner)
    t = np.linspace(-0.2, 1.2, 4001)[:, None]
    at = frame.locate(beyond + t * along)
    N = frame.interpolation(at).toarray()
    assert (at.outside > 0.0).all()
    assert np.abs(np.diff(N, axis=0)).max() < 40.0 * (t[1, 0] - t[0, 0])  # cells of 1/7
    x = [[-1.0, -1e-5, 0.0], [0.0, 0.0, 0.0], [1.0, -1e-5, 0.0]]
    x += [[-1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]]
    cells = {3: [[0, 1, 3], [1, 4, 3], [1, 2, 5], [1, 5, 4]], 4: [[0, 1, 4, 3], [1, 2, 5, 4]]}[k]
    dent = Frame(x, cells)
    N = dent.interpolation(dent.locate([[0.0, -0.5, 0.0]])).toarray()[0]
    np.testing.assert_allclose(N[[2, 5]], N[[0, 3]], rtol=1e-12)
    np.testing.assert_allclose(N @ dent.x, [0.0, -0.5, 0.0], atol=1e-9)


@pytest.mark.parametrize("height", [0.0, 0.3, 20.0])
@pytest.mark.parametrize("k", [3, 4])
def test_location_chooses_the_cell_with_the_closest_point(k, height):
    """On, beyond and above a frame in a plane, against distances from the cells as polygons."""
    x, quads = grid(6, 7, jitter=0.3, seed=23)
    cells = quads if k == 4 else triangles(quads)
    frame = Frame(np.pad(x, ((0, 0), (0, 1))), cells)
    rng = np.random.default_rng(11)
    inner = x[quads[rng.integers(len(quads), size=200)]]
    at_sides = 0.5 * (inner[:, 0] + inner[:, 2])
    points = np.concatenate([rng.uniform(-1.0, 2.0, (1500, 2)), at_sides, 1.7 * x - 0.35])
    distance = shapely.distance(shapely.polygons(x[cells]), shapely.points(points)[:, None])
    least = distance.min(axis=1)
    at = frame.locate(np.pad(points, ((0, 0), (0, 1)), constant_values=height))
    closest = frame.evaluate(at.cell, at.xi)[1][:, :2]
    assert np.abs(np.linalg.norm(points - closest, axis=1) - least).max() < 1e-12
    # Ties go to the first; cells that share the closest point differ by rounding alone.
    assert np.array_equal(at.cell, (distance <= least[:, None] + 1e-12).argmax(axis=1))
    assert ((at.outside == 0.0) == (least < 1e-13)).all()


@pytest.mark.parametrize("k", [2, 3, 4])
def test_location_does_not_depend_on_the_order_of_points_or_the_company_of_others(k):
    frame = make_frame(k)
    rng = np.random.default_rng(17)
    low, high = frame.x.min(axis=0), frame.x.max(axis=0)
    x = np.concatenate([rng.uniform(2.0 * low - high, 2.0 * high - low, (600, len(low))), frame.x])
    at, order = frame.locate(x), rng.permutation(len(x))
    assert np.array_equal(frame.locate(x[order]).cell, at.cell[order])
    assert [frame.locate(p[None]).cell[0] for p in x[::20]] == at.cell[::20].tolist()


def test_location_off_the_plane_is_the_foot_point():
    frame = make_frame(4)
    normal = vector_areas(frame.x, frame.cells)[0]
    normal /= np.linalg.norm(normal)
    _, foot, _ = frame.evaluate(np.arange(len(frame.cells)), np.zeros((len(frame.cells), 2)))
    heights = np.linspace(-0.05, 0.05, len(foot))
    at = frame.locate(foot + np.outer(heights, normal))
    assert np.abs(frame.interpolation(at) @ frame.x - foot).max() < 1e-13


# Quality and checks of a frame


def pairs_of(x, facets):
    """All nodes of a surface as pairs, as far as their own places tell of them."""
    side = cs.surface(x, facets)
    return ContactPairs(side, np.arange(len(x)), *[None] * 6)


@pytest.mark.parametrize("k", [3, 4])
def test_values_of_nodes_beyond_a_rim_are_those_of_its_closest_point(k):
    """Of a square, in any pose; they followed from the cell that was found first,
    clipped along itself."""
    (nodes, quads), rng = grid(4, 5, jitter=0.3), np.random.default_rng(5)
    nodes = np.column_stack([nodes, np.zeros(len(nodes))])
    x = np.column_stack([rng.uniform(-0.4, 1.4, (200, 2)), rng.uniform(-0.1, 0.1, 200)])
    expected = np.column_stack([np.clip(x[:, :2], 0.0, 1.0), np.zeros(200)])
    for angle in (0.0, 0.3, 2.0):
        c, s = np.cos(angle), np.sin(angle)
        Q = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        pairs = pairs_of(nodes @ Q.T, quads if k == 4 else triangles(quads))
        assert np.abs(pairs.interpolation(x @ Q.T) @ nodes - expected).max() < 1e-9


def test_values_above_a_fold_are_the_mean_of_what_is_as_close():
    """Whichever cell comes first."""
    x = np.array([[-1, 0, 1], [0, 0, 0], [1, 0, 1], [-1, 1, 1], [0, 1, 0], [1, 1, 1]], dtype=float)
    for facets in ([[0, 1, 4, 3], [1, 2, 5, 4]], [[1, 2, 5, 4], [0, 1, 4, 3]]):
        N = pairs_of(x, np.array(facets)).interpolation(np.array([[0.0, 0.5, 1.0]])).toarray()[0]
        assert np.abs(N - [0.125, 0.25, 0.125, 0.125, 0.25, 0.125]).max() < 1e-9


def test_quality_of_known_cells():
    square = Frame([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]], [[0, 1, 2, 3]]).quality
    assert (square.min_angle, square.max_angle) == pytest.approx((90.0, 90.0))
    assert (square.min_side, square.min_jacobian) == pytest.approx((2.0, 1.0))
    # Rhombus: angles 60 and 120 degrees, sides 1.
    c, s = 0.5, np.sqrt(0.75)
    rhombus = Frame([[0, 0, 1], [1, 0, 1], [1 + c, s, 1], [c, s, 1]], [[0, 1, 2, 3]]).quality
    assert (rhombus.min_angle, rhombus.max_angle) == pytest.approx((60.0, 120.0))
    assert rhombus.min_jacobian == pytest.approx(1.0)  # a parallelogram
    # 3-4-5 triangle.
    triangle = Frame([[0, 0, 0], [4, 0, 0], [0, 3, 0]], [[0, 1, 2]]).quality
    assert triangle.max_angle == pytest.approx(90.0)
    assert triangle.min_angle == pytest.approx(np.degrees(np.arctan(3 / 4)))
    assert triangle.min_side == pytest.approx(3.0)
    # Trapezium with sides 3 below, 1 above, height 1: corner Jacobians 3 and 1, mean 2.
    trapezium = Frame([[0, 0, 0], [3, 0, 0], [2, 1, 0], [1, 1, 0]], [[0, 1, 2, 3]]).quality
    assert (trapezium.min_angle, trapezium.max_angle) == pytest.approx((45.0, 135.0))
    assert trapezium.min_jacobian == pytest.approx(0.5)
    line = Frame([[0, 0], [3, 4], [3, 5]], [[0, 1], [1, 2]])
    assert line.quality.min_side == pytest.approx(1.0)
    assert line.cell_size == pytest.approx([5.0, 1.0])


X = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]], dtype=float)
QUADS = np.array([[0, 1, 4, 3], [1, 2, 5, 4]])


@pytest.mark.parametrize(
    ("x", "cells", "words"),
    [
        (X[:, :1], QUADS, r"x must be \(m, 2\) or \(m, 3\)"),
        (X, QUADS[:, :2], "cells must be"),
        (X[:, :2], QUADS, "cells must be"),
        (X, QUADS + 1, "cells name nodes 1 to 6"),
        (X, QUADS - 1, "cells name nodes -1"),
        (X, QUADS[:1], r"nodes \[2, 5\] belong to no cell"),
        (np.where(X == 2.0, np.nan, X), QUADS, "2 coordinates are not finite"),
        (X, [[0, 1, 4, 3], [1, 4, 5, 2]], "turned against each other"),
        (X, [[0, 1, 4, 3], [1, 2, 4, 5]], r"cells \[1\] are inverted or degenerate"),
        (X * [1, 0, 1], QUADS, r"cells \[0, 1\] are inverted or degenerate"),
        (np.where(np.arange(6)[:, None] == 4, [0.2, 0.2, 0.0], X), QUADS, "inverted or degenerate"),
        (X[:, :2], [[0, 1], [1, 2], [2, 2], [3, 4], [4, 5]], r"cells \[2\] are inverted"),
        (X[:3, :2], [[0, 1], [2, 1]], "turned against each other"),
        (X[[0, 1, 2]], [[0, 1, 2]], "inverted or degenerate"),
    ],
)  # fmt: skip
def test_bad_frames(x, cells, words):
    with pytest.raises(ValueError, match=words):
        Frame(x, cells)
    with pytest.raises(llm.ContactError):
        Frame(x, cells)


def test_flipped_frame_is_valid_and_turns_its_normal():
    for k in (2, 3, 4):
        frame = make_frame(k)
        area = vector_areas(frame.x, frame.cells).sum(axis=0)
        turned = frame.flipped()
        assert vector_areas(turned.x, turned.cells).sum(axis=0) == pytest.approx(-area)
        if k > 2:
            assert np.linalg.norm(area) == pytest.approx(1.0)  # the unit square, tilted


# Common area and patch forces


def side_of(s, facets, normal=1.0, name="side"):
    """Surface stand-in in the plane z = 0 (y = 0 in 2D)."""
    x = np.column_stack([s, np.zeros(len(s))])
    vector = np.zeros(x.shape[1])
    vector[-1] = normal
    return SimpleNamespace(
        x=x, facets=facets, normal=vector, name=name, diameter=np.linalg.norm(np.ptp(s, axis=0))
    )


def patch_forces(one, two):
    """Positions, nodal forces (of unit pressure on the common area) and the area."""
    sides = [side_of(*one, normal=1.0, name="one"), side_of(*two, normal=-1.0, name="two")]
    plane = patch.common_plane(*sides)
    area = patch.common_area(*sides, plane)
    s = [plane.project(side.x) for side in sides]
    forces = [patch.nodal_forces(side, q, area) for side, q in zip(sides, s, strict=True)]
    return s, forces, area


def polygon_moments(polygon):
    """Area and first moments by the shoelace formulas; holes and parts counted."""
    total = np.zeros(3)
    for part in getattr(polygon, "geoms", [polygon]):
        for k, ring in enumerate([part.exterior, *part.interiors]):
            a = np.asarray(ring.coords)[:, :2]
            cross = a[:-1, 0] * a[1:, 1] - a[1:, 0] * a[:-1, 1]
            moments = np.array(
                [cross.sum() / 2, *((a[:-1] + a[1:]) * cross[:, None]).sum(axis=0) / 6]
            )
            positive = (k == 0) == (moments[0] > 0.0)
            total += moments if positive else -moments
    return total


def agree(s, forces, area, bound=2e-14):
    """Both sides' forces have the polygon's area and first moments."""
    known = polygon_moments(area)
    size = known[0] * max(1.0, np.abs(s[0]).max())
    for q, f in zip(s, forces, strict=True):
        assert np.abs(np.array([f.sum(), *(f @ q)]) - known).max() < bound * size
        assert f.min() >= 0.0


def paper_forces():
    one, two = paper.cross_sections(1)
    return (one[0], two[0]), patch_forces(one, two)


def exact_square_force(node, h, polygon):
    """Integral over a convex polygon of the bilinear hat function of a square grid's node.

    On a square the hat is a polynomial of degree 2: midpoints of a triangle's edges are exact.
    """
    total = 0.0
    for sx in (-1, 1):
        for sy in (-1, 1):
            box = shapely.box(*np.sort([node, node + h * np.array([sx, sy])], axis=0).ravel())
            piece = box.intersection(polygon)
            if piece.area == 0.0:
                continue
            p = np.asarray(piece.exterior.coords)[:-1]
            for a, b in zip(p[1:-1], p[2:], strict=True):
                middle = 0.5 * np.array([p[0] + a, a + b, b + p[0]])
                hat = np.prod(1.0 - np.abs(middle - node) / h, axis=1)
                u, v = a - p[0], b - p[0]
                total += 0.5 * abs(u[0] * v[1] - u[1] * v[0]) * hat.mean()
    return total


def quad_forces(p):
    """Integrals of a quad's shape functions, by 3 x 3 Gauss points (exact)."""
    g, w = np.polynomial.legendre.leggauss(3)
    total = np.zeros(4)
    for a, wa in zip(g, w, strict=True):
        for b, wb in zip(g, w, strict=True):
            N, dN = shape_functions(4, np.array([[a, b]]))
            total += wa * wb * np.linalg.det(dN[0].T @ p) * N[0]
    return total


def test_forces_of_the_paper_against_exact_integration():
    (x0, x1), (_, forces, _) = paper_forces()
    angle = np.arange(14) * np.pi / 7.0
    polygon = shapely.Polygon(np.column_stack([np.cos(angle), np.sin(angle)]))
    known = [np.array([exact_square_force(x, paper.SPACING, polygon) for x in x0]), np.zeros(32)]
    quads = paper.cross_sections(1)[1][1]
    np.add.at(known[1], quads, np.array([quad_forces(p) for p in x1[quads]]))
    for f, exact in zip(forces, known, strict=True):
        assert np.abs(f - exact).max() < 1e-14 * exact.max()
        assert f.sum() == pytest.approx(7.0 * np.sin(np.pi / 7.0), rel=1e-15)  # of the 14-gon


def test_table_4_of_the_paper():
    """Nodal forces of the paper's pressure: within one unit of the last of six decimals.

    The paper's polygon has corners of eight decimals, ours is the regular 14-gon.
    """
    (x0, x1), (_, forces, _) = paper_forces()
    f0, f1 = (paper.PRESSURE * f for f in forces)
    # Foundation: the quarter's nodes that carry force, row by row.
    quarter = np.flatnonzero((x0 > -1e-9).all(axis=1) & (f0 > 0.0))
    quarter = quarter[np.lexsort((x0[quarter, 0].round(6), x0[quarter, 1].round(6)))]
    assert len(quarter) == len(paper.FORCES_FOUNDATION)
    assert np.abs(f0[quarter] - paper.FORCES_FOUNDATION).max() < 1e-6
    near = [int(np.linalg.norm(x1 - p, axis=1).argmin()) for p in paper.PUNCH_NODES]
    assert np.abs(f1[near] - paper.FORCES_PUNCH).max() < 1e-6


@pytest.mark.parametrize("seed", [7, 19, 33])
@pytest.mark.parametrize("kind", [3, 4])
def test_shifted_and_turned_jittered_meshes(seed, kind):
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0.2, 1.2)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    x0, q0 = grid(7, 6, jitter=0.3, seed=seed)
    x1, q1 = grid(5, 8, jitter=0.3, seed=seed + 1)
    shift = rng.uniform(0.3, 0.7, 2)
    x1 = (x1 - 0.5) @ turn.T * 1.1 + shift
    if kind == 3:
        q0, q1 = triangles(q0), triangles(q1)
    s, forces, area = patch_forces((x0, q0), (x1, q1))
    box = shapely.box(0, 0, 1, 1)
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    expected = shapely.Polygon(corners @ turn.T * 1.1 + shift).intersection(box)
    assert area.area == pytest.approx(expected.area, rel=1e-13)
    assert 0.3 < area.area < 1.0
    agree(s, forces, area)


def test_clipped_facets_against_subdivision():
    """One distorted quad under a triangle: brute-force sums over a million sub-cells converge."""
    quad = np.array([[0.0, 0.0], [2.0, 0.3], [1.4, 1.7], [0.2, 1.1]])
    area = shapely.Polygon([[0.4, -0.5], [2.2, 0.9], [0.3, 1.3]])
    got = patch.covered_forces(quad, np.array([[0, 1, 2, 3]]), area)[0]
    n = 1200
    u = (np.arange(n) + 0.5) / n * 2.0 - 1.0
    xi = np.array(np.meshgrid(u, u)).reshape(2, -1).T
    N, dN = shape_functions(4, xi)
    t = np.einsum("gkd,ki->gdi", dN, quad)
    det = t[:, 0, 0] * t[:, 1, 1] - t[:, 0, 1] * t[:, 1, 0]
    x = N @ quad
    inside = shapely.contains_xy(area, x[:, 0], x[:, 1])
    rough = (N * (det * inside)[:, None]).sum(axis=0) * (2.0 / n) ** 2
    assert 0.2 < inside.mean() < 0.8
    assert np.abs(got - rough).max() < 2e-4 * got.sum()
    piece = shapely.Polygon(quad).intersection(area)
    known = polygon_moments(piece)
    assert np.abs([got.sum() - known[0], *(got @ quad - known[1:])]).max() < 1e-14


def shares_in_triangle(quad, corners, n):
    """Integrals of a quad's shape functions over a triangle, by n x n Gauss points in it."""
    t, w = np.polynomial.legendre.leggauss(n)
    t, w = (t + 1.0) / 2.0, w / 2.0
    a, b, c = corners
    x = (a + t[:, None, None] * (b + t[:, None] * (c - b) - a)).reshape(-1, 2)
    weight = np.outer(w * t, w).ravel() * abs(np.linalg.det([b - a, c - a]))
    xi = np.zeros_like(x)
    for _ in range(30):
        N, dN = shape_functions(4, xi)
        step = np.linalg.solve(np.einsum("gkd,ki->gid", dN, quad), (x - N @ quad)[..., None])
        xi += step[..., 0]
    return weight @ shape_functions(4, xi)[0]


@pytest.mark.parametrize("skew", [0.1, 0.2, 0.3])
def test_clipped_distorted_facets_are_integrated_to_rounding(skew):
    """A corner is cut off, along a line that is a curve in reference coordinates."""
    rng = np.random.default_rng(3)
    for _ in range(5):
        quad = np.array([[0.0, 0.0], [1, 0], [1, 1], [0, 1]]) + skew * rng.uniform(-1, 1, (4, 2))
        corners = np.array([quad[0], quad[0] + 0.8 * (quad[1] - quad[0]), quad[3]])
        got = patch.covered_forces(quad, np.array([[0, 1, 2, 3]]), shapely.Polygon(corners))[0]
        assert np.abs(got - shares_in_triangle(quad, corners, 48)).max() < 5e-14


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.1])
def test_facets_covered_but_for_rounding_are_whole(angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    x, quads = grid(5, 4, jitter=0.3, seed=2)
    s, forces, area = patch_forces((x @ turn.T, quads), (grid(3, 7)[0] @ turn.T, grid(3, 7)[1]))
    whole = np.zeros(len(x))
    np.add.at(whole, quads, patch.full_forces(x, quads))
    assert np.abs(forces[0] - whole).max() < 1e-15


def test_clipped_shape_functions_of_a_rectangle_are_exact():
    """On a rectangle the shape functions are products: the clipped integrals are known."""
    a, b, p, q = 2.0, 1.0, 0.7, 0.4
    quad = np.array([[0, 0], [a, 0], [a, b], [0, b]])
    got = patch.covered_forces(quad, np.array([[0, 1, 2, 3]]), shapely.box(0, 0, p, q))[0]
    one, two = (np.array([t - t * t / 2 / c, t * t / 2 / c]) for t, c in ((p, a), (q, b)))
    known = [one[0] * two[0], one[1] * two[0], one[1] * two[1], one[0] * two[1]]
    assert np.abs(got - known).max() < 1e-15


def annulus(inner, outer, n_r, n_t, phase=0.0):
    r = np.linspace(inner, outer, n_r + 1)
    t = phase + np.arange(n_t) * 2 * np.pi / n_t
    x = np.array([[a * np.cos(b), a * np.sin(b)] for a in r for b in t])
    quads = [
        [i * n_t + j, (i + 1) * n_t + j, (i + 1) * n_t + (j + 1) % n_t, i * n_t + (j + 1) % n_t]
        for i in range(n_r)
        for j in range(n_t)
    ]
    return x, np.array(quads)


def test_annulus():
    x0, q0 = grid(9, 9, low=(-1.3, -1.2), high=(1.2, 1.3), jitter=0.2)
    x1, q1 = annulus(0.4, 1.0, 3, 16)
    s, forces, area = patch_forces((x0, q0), (x1, q1))
    # Two regular 16-gons.
    known = 8 * np.sin(np.pi / 8) * (1.0 - 0.4**2)
    assert area.area == pytest.approx(known, rel=1e-14)
    assert forces[0].sum() == pytest.approx(known, rel=1e-14)
    agree(s, forces, area)


def test_hole_leaves_inner_nodes_without_force():
    x0, q0 = grid(20, 20, low=(-1.2, -1.2), high=(1.2, 1.2))
    _, forces, _ = patch_forces((x0, q0), annulus(0.5, 1.0, 2, 24))
    assert forces[0][np.linalg.norm(x0, axis=1) < 0.3].max() == 0.0
    assert forces[0][np.abs(np.linalg.norm(x0, axis=1) - 0.75) < 0.08].min() > 0.0


def test_two_annuli():
    s, forces, area = patch_forces(annulus(0.3, 1.0, 4, 20), annulus(0.45, 1.2, 3, 14, 0.1))
    assert len(area.interiors) == 1
    agree(s, forces, area)


def test_l_shape():
    x0, q0 = grid(8, 8, jitter=0.25)
    centre = x0[q0].mean(axis=1)
    keep = ~(centre > 0.5).all(axis=1)
    nodes, q = np.unique(q0[keep], return_inverse=True)
    x1, q1 = grid(7, 5, low=(-0.1, 0.15), high=(0.9, 1.2), jitter=0.25, seed=5)
    s, forces, area = patch_forces((x0[nodes], q.reshape(-1, 4)), (x1, q1))
    agree(s, forces, area)
    # The same from Shapely's union of the facets.
    union = shapely.union_all(shapely.polygons(x0[q0[keep]]))
    assert area.area == pytest.approx(union.intersection(shapely.box(-0.1, 0.15, 0.9, 1.2)).area)


def test_segments():
    a = np.array([0.0, 0.3, 0.5, 1.1, 1.6])[:, None]
    b = np.array([0.4, 0.9, 1.0, 2.0])[:, None]
    cells = [np.column_stack([np.arange(len(x) - 1), np.arange(1, len(x))]) for x in (a, b)]
    s, forces, area = patch_forces((a, cells[0]), (b, cells[1]))
    assert area[1] - area[0] == pytest.approx(1.2)
    for q, f in zip(s, forces, strict=True):
        assert f.sum() == pytest.approx(1.2, abs=1e-15)
        assert f @ q[:, 0] == pytest.approx(1.2 * sum(area) / 2, abs=1e-15)
    # By hand: [0.4, 0.5] of the segment 0.3..0.5 gives 0.025, 0.075; then 0.6 and 0.5.
    assert forces[0] == pytest.approx([0, 0.025, 0.375, 0.55, 0.25], abs=1e-15)
    # 0.4..0.9, 0.9..1.0 whole; 0.6 of the segment 1..2.
    assert forces[1] == pytest.approx([0.25, 0.3, 0.05 + 0.6 * 0.7, 0.6 * 0.3], abs=1e-15)


def test_matching_meshes_share_forces():
    x, q = grid(5, 4, jitter=0.3)
    _, forces, _ = patch_forces((x, q), (x, q))
    assert np.abs(forces[0] - forces[1]).max() < 1e-16


@pytest.mark.parametrize("shift", [1.0, 1.5])
def test_surfaces_that_do_not_overlap(shift):
    """Touching along an edge is no overlap."""
    x, q = grid(3, 3)
    with pytest.raises(llm.ContactError, match="do not overlap"):
        patch_forces((x, q), (x + [shift, 0.0], q))
    s = np.linspace(0.0, 1.0, 4)[:, None]
    cells = np.column_stack([np.arange(3), np.arange(1, 4)])
    with pytest.raises(llm.ContactError, match="do not overlap"):
        patch_forces((s, cells), (s + shift, cells))


# Design by weights


def scalar_pairs(n0, n1, frame_n, seed, kind=4):
    """Frame, its plane nodes, N, cells and forces of two jittered meshes of the unit square."""
    sides = [grid(n, n, jitter=0.3, seed=seed + i) for i, n in enumerate((n0, n1))]
    _, forces, _ = patch_forces(*sides)
    x, quads = grid(frame_n, frame_n, jitter=0.2, seed=seed + 2)
    frame = Frame(np.column_stack([x, np.zeros(len(x))]), quads if kind == 4 else triangles(quads))
    at = [frame.locate(np.column_stack([s, np.zeros(len(s))])) for s, _ in sides]
    N = [frame.interpolation(a) for a in at]
    return frame, x, N, [a.cell for a in at], forces, [s for s, _ in sides]


COUNTS = (10, 13, 10), (10, 10, 8), (10, 20, 10), (6, 7, 5), (13, 10, 12)


@pytest.mark.parametrize(("counts", "kind", "seed"), drawn(COUNTS, (3, 4), (7, 2001)))
def test_design_weights(counts, kind, seed):
    n0, n1, n = counts
    frame, x, N, cells, forces, nodes = scalar_pairs(n0, n1, n, seed, kind)
    before = np.abs(design.patch_residual(N, forces)).max()
    assert before > 1e-3  # else nothing is tested
    designed = llm.design_weights(frame, x, N, cells, forces)
    # Oracle of (28): dense sums.
    r = designed[0].toarray().T @ forces[0] - designed[1].toarray().T @ forces[1]
    assert np.abs(r).max() / max(f.max() for f in forces) <= 1e-13
    for M, s in zip(designed, nodes, strict=True):
        assert np.abs(np.asarray(M.sum(axis=1)) - 1.0).max() < 1e-14
        assert np.abs(M @ x - s).max() < 1e-14
        assert np.diff(M.tocsr().indptr).max() <= 40  # rows stay local
    sigma = [
        np.linalg.svd(np.vstack([m.toarray() for m in M]), compute_uv=False) for M in (N, designed)
    ]
    assert sigma[1][-1] > 0.5 * sigma[0][-1] > 0.0
    change = max(abs(a - b).max() for a, b in zip(N, designed, strict=True))
    assert change < 0.35
    loading = FrameLoads.of(frame, x, N, [NodalLoads.of_forces(f) for f in forces])
    rows, residual, largest = design.balanced_rows(frame, loading, N, None)  # tells the same
    assert all(abs(a - b).max() == 0.0 for a, b in zip(rows, designed, strict=True))
    assert residual == np.abs(loading.residual(designed)).max()
    assert abs(largest - change) < 1e-15


def test_design_weights_leaves_a_passing_frame_alone():
    """Matching sides on their own mesh: nothing to correct."""
    x, q = grid(6, 6, jitter=0.3)
    _, forces, _ = patch_forces((x, q), (x, q))
    frame = Frame(np.column_stack([x, np.zeros(len(x))]), q)
    at = frame.locate(frame.x)
    N = frame.interpolation(at)
    designed = llm.design_weights(frame, x, [N, N], [at.cell, at.cell], forces)
    assert all(abs(M - N).max() < 1e-14 for M in designed)


def test_design_weights_refuses_what_it_cannot_do():
    """A frame of one cell has no freedom but the affine one: its bilinear mode cannot pass."""
    frame, x, N, cells, forces, _ = scalar_pairs(5, 7, 1, 7)
    N[0] = N[0].copy()
    if np.abs(design.patch_residual(N, forces)).max() > 1e-6:
        try:
            designed = llm.design_weights(frame, x, N, cells, forces)
        except llm.ContactError as error:
            assert "frame nodes" in str(error)
        else:
            assert np.abs(design.patch_residual(designed, forces)).max() <= 1e-13


def test_all_of_a_surface_is_that_surface():
    """What it knows of itself is found once; other parts have nodes of their own."""
    x, q = grid(3, 2)
    n = len(x)
    side = Surface(np.column_stack([x, np.zeros(n)]), q, np.arange(n), np.zeros(n), "tag 1")
    assert side.part(np.arange(len(q))) is side
    assert side.part(np.arange(len(q))[::-1]) is not side
    few = side.part(np.array([0]))
    assert len(few.x) == 4 and np.array_equal(places(side, few), few.dofs)
    assert np.array_equal(places(side, side), side.dofs)


def test_frames_and_surfaces_move():
    """From where they were drawn, there and back; the cells stay."""
    frame, rng = make_frame(4), np.random.default_rng(23)
    v = 0.01 * rng.standard_normal(frame.x.shape)
    moved = frame.moved(v)
    assert np.array_equal(moved.x, frame.x + v) and moved.cells is frame.cells
    np.testing.assert_allclose(moved.moved(-v).x, frame.x, atol=1e-15)
    surface = cs.surface(frame.x, frame.cells)
    there = surface.moved(v)
    assert np.array_equal(there.x, frame.x + v) and there.X is surface.X is surface.x
    assert np.array_equal(there.moved(0.0 * v).x, surface.x)
