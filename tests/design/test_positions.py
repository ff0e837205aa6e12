"""Frame design by positions: the paper's scene (section 5), invariances, failure, derivatives."""

from types import SimpleNamespace

import numpy as np
import paper_data as data
import pytest
from scipy.spatial.transform import Rotation

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.design.positions import design_positions
from dolfinx_llm.design.positions_scene import search_scenes
from dolfinx_llm.design.positions_search import least_squares
from dolfinx_llm.geometry import overlap_flat as patch
from dolfinx_llm.geometry.frame import Frame

MIN_SIDE = 0.06


def lattice(x, y):
    """Nodes (n, 3) in the plane z = 1 and quads of a tensor grid."""
    n = len(y)
    nodes = np.array([[a, b, 1.0] for a in x for b in y])
    corner = np.array([[i, j] for i in range(len(x) - 1) for j in range(n - 1)])
    first = corner[:, 0] * n + corner[:, 1]
    return nodes, np.column_stack([first, first + n, first + n + 1, first + 1])


def contact_forces(x0, cells0, x1, cells1):
    """Positions and forces of unit pressure of both sides' nodes in contact."""
    sides = [
        SimpleNamespace(x=x, facets=c, name=name, diameter=3.0, normal=np.array([0.0, 0.0, sign]))
        for x, c, name, sign in ((x0, cells0, "a", 1.0), (x1, cells1[:, ::-1], "b", -1.0))
    ]
    plane = patch.common_plane(*sides)
    area = patch.common_area(*sides, plane)
    forces = [patch.nodal_forces(s, plane.project(s.x), area) for s in sides]
    return [s.x[f > 0] for s, f in zip(sides, forces, strict=True)], [f[f > 0] for f in forces]


def flat_frame(quarter):
    nodes, cells = data.frame_mesh(quarter)
    return Frame(np.column_stack([nodes, np.ones(len(nodes))]), cells)


@pytest.fixture(scope="module")
def paper():
    """Prediction of Table 2, positions, forces."""
    punch, quads = data.mirror(data.PUNCH_NODES, data.PUNCH_QUADS, data.PUNCH_AXIS_EDGES)
    grid = data.SPACING * np.arange(-4, 5)
    punch = np.column_stack([punch, np.ones(len(punch))])
    return flat_frame(data.FRAME_PREDICTION), *contact_forces(*lattice(grid, grid), punch, quads)


@pytest.fixture(scope="module")
def designed(paper):
    return design_positions(*paper, min_side=MIN_SIDE)


def dense_L(frame, x):
    return [frame.interpolation(frame.locate(p)).toarray() for p in x]


def residual(frame, x, forces):
    L = dense_L(frame, x)
    return np.abs(L[0].T @ forces[0] - L[1].T @ forces[1]).max() / max(f.max() for f in forces)


def corner_angles(frame):
    """Corner angles in degrees by the law of cosines."""
    p = frame.x[frame.cells]
    a, b = np.roll(p, -1, axis=1) - p, np.roll(p, 1, axis=1) - p
    cosine = (a * b).sum(-1) / np.linalg.norm(a, axis=-1) / np.linalg.norm(b, axis=-1)
    return np.degrees(np.arccos(cosine))


def test_paper_scene_passes(paper, designed):
    assert residual(*paper) > 1e-2
    assert residual(designed, *paper[1:]) <= 1e-13


def test_paper_constraints(paper, designed):
    Y, X = paper[0].x, designed.x
    angles = corner_angles(designed)
    assert angles.min() >= 25.0 and angles.max() <= 155.0
    p = X[designed.cells]
    assert np.linalg.norm(np.roll(p, -1, axis=1) - p, axis=2).min() >= MIN_SIDE
    np.testing.assert_array_equal(X[:, 2], Y[:, 2])
    for i in (0, 1):
        edge = np.abs(Y[:, i]) == 1.05
        np.testing.assert_allclose(X[edge, i], Y[edge, i], atol=1e-14)
    for mirror in ([-1, 1, 1], [1, -1, 1]):
        image = [int(np.argmin(np.abs(Y - y).sum(1))) for y in Y * mirror]
        np.testing.assert_allclose(X[image], X * mirror, atol=1e-13)
    assert all(designed.locate(x).outside.max() < 1e-9 for x in paper[1])


def test_paper_rank(paper, designed):
    s = np.linalg.svd(np.vstack(dense_L(designed, paper[1])), compute_uv=False)
    assert len(s) == 42 and s[-1] / s[0] >= 0.02


def test_printed_frame_is_only_polished(paper):
    """Table 2's optimised frame, printed to 8 digits, moves by rounding of its digits only."""
    printed = flat_frame(data.FRAME_OPTIMISED)
    frame = design_positions(printed, *paper[1:], min_side=MIN_SIDE)
    assert np.abs(frame.x - printed.x).max() < 1e-6
    assert residual(frame, *paper[1:]) <= 1e-13


def moved(paper, scale, shift):
    """The paper's scene turned, shifted and in other units, and the map."""
    R = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    move = lambda x: scale * (x @ R.T + shift)  # noqa: E731
    frame, x, forces = paper
    frame = Frame(move(frame.x), frame.cells)
    return move, frame, [move(p) for p in x], [scale**2 * f for f in forces]


@pytest.mark.long
def test_order_orientation_and_units_do_not_matter(paper, designed):
    """Sides and nodes in another order, the frame turned over, lengths in thousands."""
    move, frame, x, forces = moved(paper, 1e3, 0.0)
    order = np.random.default_rng(5).permutation(len(x[0]))
    args = (x[1], x[0][order]), (forces[1], forces[0][order])
    swapped = design_positions(frame.flipped(), *args, min_side=MIN_SIDE * 1e3)
    assert residual(swapped, *args) <= 1e-13
    np.testing.assert_allclose(swapped.x, move(designed.x), atol=1e-10 * 1e3)


@pytest.mark.long
def test_far_from_the_origin(paper, designed):
    """At 100 diameters from the origin the coordinates' rounding, 1e-14 of the frame's size,
    limits the residual: the tolerance there is 20 eps max|x| / size."""
    move, frame, *args = moved(paper, 1e-3, 300.0)
    found = design_positions(frame, *args, min_side=MIN_SIDE * 1e-3)
    assert residual(found, *args) <= 3e-12
    np.testing.assert_allclose(found.x, move(designed.x), atol=1e-10 * 1e-3)


def jittered():
    """A scene without symmetry: frame 3 x 3 between jittered meshes 4 x 4 and 5 x 5."""
    rng, meshes = np.random.default_rng(11), []
    for n in (4, 5):
        x, cells = lattice(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, n + 1))
        inner = np.abs(x[:, :2]).max(axis=1) < 0.99
        x[inner, :2] += rng.uniform(-0.4 / n, 0.4 / n, size=(inner.sum(), 2))
        meshes += [x, cells]
    g = np.linspace(-1, 1, 4)
    return Frame(*lattice(g, g)), *contact_forces(*meshes)


@pytest.mark.long
def test_scene_without_symmetry():
    frame, x, forces = jittered()
    designed = design_positions(frame, x, forces)
    assert residual(frame, x, forces) > 1e-2
    assert residual(designed, x, forces) <= 1e-13
    assert designed.quality.min_side >= 0.3 * frame.quality.min_side


def test_failure_says_numbers_and_way_out():
    frame, x, forces = jittered()
    with pytest.raises(ContactError, match=r"none of 20 starts.*left .*design='weights'"):
        design_positions(frame, x, forces, min_angle=85.0, max_angle=95.0, starts=20)


def test_uncovered_points_and_curved_frame(paper):
    frame, x, forces = paper
    with pytest.raises(ContactError, match="outside the frame"):
        design_positions(Frame(0.8 * frame.x + [0, 0, 0.2], frame.cells), x, forces)
    bent = frame.x + np.column_stack([np.zeros((42, 2)), 0.1 * frame.x[:, 0] ** 2])
    with pytest.raises(ContactError, match="flat"):
        design_positions(Frame(bent, frame.cells), x, forces)


@pytest.mark.parametrize("triangles", [False, True])
def test_derivatives(paper, triangles):
    """Analytic derivatives of residual and active constraints against central differences."""
    frame, x, forces = paper
    if triangles:
        cells = np.concatenate([frame.cells[:, [0, 1, 2]], frame.cells[:, [0, 2, 3]]])
        frame = Frame(frame.x, cells)
    bounds = np.array([np.radians(88.0), np.radians(92.0), 0.5])
    scene = search_scenes(frame, x, forces, bounds)[0]
    assert triangles or scene.Z.shape[1] == 14
    q = np.random.default_rng(7).normal(size=(2, scene.Z.shape[1])) * 0.05
    J, h = least_squares(scene, q)[1], 1e-6
    steps = [least_squares(scene, q + s * h * e)[0] for e in np.eye(q.shape[1]) for s in (1, -1)]
    fd = np.stack(
        [(a - b) / (2 * h) for a, b in zip(steps[::2], steps[1::2], strict=True)], axis=-1
    )
    np.testing.assert_allclose(J, fd, atol=2e-8)
