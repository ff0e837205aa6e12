"""What can touch, facet by facet: whole surfaces tagged, any orientation, bodies that overlap."""

from dataclasses import replace

import contact_scenes as cs
import curved_scenes
import facing_scenes as fs
import numpy as np
import pytest
import scenes
from conftest import run_mpi_json
from dolfinx import mesh
from facing_scenes import apart, ring, solved
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.design.predict import predict_frame
from dolfinx_llm.geometry.facing import facing_facets, separation
from dolfinx_llm.geometry.overlap_flat import common_area, nodal_forces
from dolfinx_llm.geometry.pieces import touching_pieces
from dolfinx_llm.interface.build import build_interface
from dolfinx_llm.interface.touching import find_pieces

COMM = MPI.COMM_SELF
LAWS = [llm.Frictionless(), llm.Coulomb(0.3)]


# Facets alone


def box(low, high, n, name="box"):
    """The whole boundary of a box as quads, n cells along every edge."""
    corners, quads = [], []
    grid = np.stack(np.meshgrid(*[np.arange(n + 1) / n] * 2, indexing="ij"), -1).reshape(-1, 2)
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    cells = first[:, None] + [0, n + 1, n + 2, 1]
    for axis in range(3):
        for end in (0.0, 1.0):
            x = np.insert(grid, axis, end, axis=1)
            out = cells if (end == 1.0) == (axis != 1) else cells[:, ::-1]
            quads.append(out + sum(map(len, corners)))
            corners.append(x)
    x, same = np.unique(np.concatenate(corners).round(9), axis=0, return_inverse=True)
    x = np.asarray(low) + x * (np.asarray(high, float) - low)
    return curved_scenes.surface(x, same.ravel()[np.concatenate(quads)], name)


def turned(surface, R, shift=0.0):
    return curved_scenes.surface(surface.x @ R.T + shift, surface.facets, surface.name)


def found(sides):
    apart = separation(sides[0], sides[1]), separation(sides[1], sides[0])
    return facing_facets(sides, apart), apart


def heights(side, facing, axis=2):
    return side.x[side.facets[facing.facets]][..., axis]


@pytest.mark.parametrize("gap", [0.0, 0.03, -0.02, 0.7])
@pytest.mark.parametrize("thin", [1.0, 0.05])
def test_whole_boxes_face_with_top_and_bottom(gap, thin):
    """Also thin sheets, whose other sides lie within a facet of each other."""
    gap = min(gap, 2.0) if thin == 1.0 or gap >= 0.0 else -0.02
    sides = box((-1, -1, 0), (1, 1, thin), 7), box((-0.6, -0.5, thin + gap), (0.5, 0.7, 2), 5)
    (low, high), _ = found(sides)
    assert np.ptp(heights(sides[0], low)) == 0.0 and heights(sides[0], low).max() == thin
    np.testing.assert_allclose(heights(sides[1], high), thin + gap, atol=1e-12)
    assert len(high.facets) == 25 and 9 <= len(low.facets) <= 49


def test_nothing_faces():
    """Side by side, and the same way."""
    one = box((0, 0, 0), (1, 1, 1), 3)
    top = one.part(np.flatnonzero((one.x[one.facets][..., 2] == 1.0).all(axis=1)))
    for other in (turned(one, np.eye(3), [1.5, 0.0, 0.9]).part([0]), turned(top, np.eye(3), 0.2)):
        facing, _ = found((top, other))
        assert not len(facing[0].facets) and not len(facing[1].facets)


@pytest.mark.parametrize("n, cells", [(12, 30), (40, 6), (250, 9)])
def test_both_sides_cover_the_same(n, cells):
    """However fine the one, all that it faces of the other is found: unit pressure balances."""
    sides = fs.roller(n), box((-2, -1, -1), (2, 2, 0), cells)
    _, distances = found(sides)
    (piece,) = touching_pieces(sides, distances, True)
    parts = [side.part(facets) for side, facets in zip(sides, piece.facets, strict=True)]
    area = common_area(*parts, piece.plane)
    moments = []
    for part in parts:
        s = piece.plane.project(part.x)
        f = nodal_forces(part, s, area)
        moments.append([f.sum(), *(f @ s)])
    np.testing.assert_allclose(moments[0], moments[1], atol=1e-12)
    width = np.abs(parts[0].x[:, 0]).max()
    assert moments[0][0] == pytest.approx(2.0 * width) and 0.7 < width < np.sin(1.0) + 4.0 / n


@pytest.mark.parametrize("seed", [3, longer(5), longer(7)])
def test_the_same_facets_in_any_orientation(seed):
    """Boxes and balls, turned and shifted: the same facets, planes that turn with them."""
    R = fs.turn(3, seed)
    for sides in (
        (box((-1, -1, 0), (1, 1, 1), 7), box((-0.6, -0.5, 1), (0.5, 0.7, 2), 5)),
        (fs.roller(12), box((-2, -1, -1), (2, 2, 0), 6)),
    ):
        one, apart = found(sides)
        moved = tuple(turned(side, R, [3.0, -1.0, 2.0]) for side in sides)
        other, apart_moved = found(moved)
        for k in (0, 1):
            assert 0 < len(one[k].facets) < len(sides[k].facets)
            assert np.array_equal(one[k].facets, other[k].facets)
        (piece,), (piece_moved,) = (
            touching_pieces(s, d, True) for s, d in ((sides, apart), (moved, apart_moved))
        )
        np.testing.assert_allclose(piece_moved.plane.normal, R @ piece.plane.normal, atol=1e-12)
        np.testing.assert_allclose(np.abs(piece.plane.normal), [0, 0, 1], atol=1e-12)


def test_pin_and_bore_are_curved():
    """The whole circles of a pin and a bore turn together; those of two rollers do not."""
    pin, bore = curved_scenes.arc(1.0, 44, 0, 360), curved_scenes.arc(1.02, 31, 0, 360, False)
    _, apart = found((pin, bore))
    (piece,) = touching_pieces((pin, bore), apart, True)
    assert piece.plane is None and [len(f) for f in piece.facets] == [44, 31] and not piece.edges
    roller = turned(curved_scenes.arc(1.5, 40, 0, 360), np.eye(2), [0.0, -2.5])
    _, apart = found((pin, roller))
    (piece,) = touching_pieces((pin, roller), apart, True)
    np.testing.assert_allclose(piece.plane.normal, [0.0, -1.0], atol=1e-3)


def test_corner_is_said():
    """A block that stands in a corner with two faces."""
    corner = box((0, 0, 0), (1, 1, 1), 4)
    inside = turned(corner, np.eye(3))
    keep = (corner.x[corner.facets][..., [0, 2]] == 0.0).all(axis=1).any(axis=1)
    walls = curved_scenes.surface(corner.x, corner.facets[keep][:, ::-1]).part(
        np.arange(keep.sum())
    )
    _, apart = found((inside, walls))
    (piece,) = touching_pieces((inside, walls), apart, True)
    assert piece.plane is None and piece.edges == 1


@pytest.mark.parametrize("angle", [80.0, 130.0, 165.0])
@pytest.mark.parametrize("swap", [False, True])
def test_flanks_of_a_groove_have_a_plane_each(angle, swap):
    """A roller in a V of this angle. One that lies on a roof has one piece, and so do a pin and a
    bore of few facets, which have no nodes inside of flat faces."""
    half = np.radians(0.5 * angle)
    far = np.linspace(-2.0, 2.0, 41)
    x = np.column_stack([np.sin(half) * far, np.cos(half) * np.abs(far) - 1.0 / np.sin(half)])
    n = np.arange(40)
    groove = curved_scenes.surface(x, np.column_stack([n, n + 1]))
    roller = curved_scenes.arc(1.0, 50, 180.0, 360.0)
    sides = (groove, roller)[:: -1 if swap else 1]
    pieces = touching_pieces(sides, found(sides)[1], True)
    assert len(pieces) == 2
    for piece, facets in zip(pieces, (piece.facets[swap] for piece in pieces), strict=True):
        lean = -np.sign(groove.x[groove.facets[facets]][..., 0].sum())
        along = np.array([lean * np.cos(half), np.sin(half)]) * (-1.0 if swap else 1.0)
        np.testing.assert_allclose(piece.plane.normal, along, atol=1e-12)
    sides = replace(groove, x=x * [1.0, -1.0] - [0.0, 1.0 + 1.0 / np.sin(half)]), roller
    assert len(touching_pieces(sides, found(sides)[1], True)) == 1
    sides = curved_scenes.arc(1.0, 50, 0, 360), curved_scenes.arc(1.02, 8, 0, 360, False)
    assert len(touching_pieces(sides, found(sides)[1], True)) == 1


# Problems


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_roller_tagged_all_round(law):
    """The whole circle against the part that faces, and the block's whole boundary against its
    top: the same facets take part, so that answers agree; in any orientation."""
    problem, u, _ = fs.on_block(COMM, law, whole=False)
    force = problem.results[0].resultant
    assert force[1] < -1.0 and not problem._doubts
    for options in ({"block": law.slips}, {"block": not law.slips, "seed": 7}):
        other, v, R = fs.on_block(COMM, law, **options)
        assert apart(u, v) < 1e-10
        result = other.results[0]
        np.testing.assert_allclose(result.resultant @ R, force, atol=1e-10 * np.abs(force).max())
        found = [np.sort(r.pressure)[-4:] for r in (result, problem.results[0])]
        np.testing.assert_allclose(*found, rtol=1e-9)


def test_roller_in_3d_tagged_all_round():
    """Hexahedra; whole against part, wholly tagged block against its top."""
    _, u, _ = fs.on_block(COMM, llm.Frictionless(), whole=False, depth=0.5, n=32)
    _, v, _ = fs.on_block(COMM, llm.Frictionless(), block=True, depth=0.5, n=32)
    assert apart(u, v) < 1e-10


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_o_ring_between_plates(law):
    problem, u, _ = fs.squeezed(COMM, law)
    for result, sign in zip(problem.results, (-1.0, 1.0), strict=True):
        assert sign * result.resultant[1] > 0.1
    other, v, _ = fs.squeezed(COMM, law, seed=5)
    assert apart(u, v) < 1e-10


@pytest.mark.parametrize("law", [llm.Tied(), *LAWS], ids=str)
def test_pieces_are_joined(law):
    """A plate between two others, each pair of sides with one tag: two planes, one frame; the same
    as two interfaces."""
    sections = [scenes.grid(n, n + 1, jitter=0.2, seed=n) for n in (4, 5, 3)]
    found = []
    for one in (True, False):
        domain, tags = scenes.stacked(COMM, sections, (0.0, 0.5, 1.0, 1.5), (2, 2, 2))
        V = compat.function_space(domain, shape=(3,))
        if one:  # 3, 4: the middle plate's; 2, 5: those it touches
            values = np.where(tags.values == 4, 3, np.where(tags.values == 5, 2, tags.values))
            tags = mesh.meshtags(domain, 2, tags.indices, values.astype(np.int32))
        top = lambda p: np.isclose(p[2], 1.5)  # noqa: E731
        bcs = scenes.hold(V, scenes.SYMMETRY) + scenes.hold(V, [(2, top)], lambda p: 0 * p - 0.01)
        a, L = scenes.forms(V)
        sides = [(3, 2)] if one else [(3, 2), (4, 5)]
        interfaces = [llm.Interface(tags, pair, law=law) for pair in sides]
        problem = llm.ContactProblem(a, L, bcs=bcs, interfaces=interfaces)
        found.append((problem, problem.solve().x.array))
    (one, u), (two, v) = found
    assert apart([u], [v]) < 1e-11
    forces = [sum(r.sides[0].normal_force.sum() for r in p.results) for p, _ in found]
    assert forces[0] == pytest.approx(forces[1], rel=1e-10) and forces[0] > 1.0
    geometry = one.geometries[0]
    assert len(geometry.frame.x) == sum(len(m.frame.x) for m in two.geometries)
    assert (np.diff(geometry.pairs[0].nodes) > 0).all()
    assert geometry.certificate.residual < 1e-13


def test_more_than_what_touches_changes_little():
    """The lower part of the circle, ± 24°, against all of it: other facets beyond what touches."""
    few, u, _ = fs.on_block(COMM, llm.Frictionless(), whole=0.42, n=192)
    whole, v, _ = fs.on_block(COMM, llm.Frictionless(), n=192)
    assert len(few.geometries[0].pairs[0].nodes) < 0.6 * len(whole.geometries[0].pairs[0].nodes)
    forces = [p.results[0].resultant[1] for p in (few, whole)]
    assert forces[0] == pytest.approx(forces[1], rel=5e-3) and apart(u, v) < 2e-2


def in_bore(comm, law, seed=None):
    """A pin in a bore with clearance: all surfaces of both rings tagged, the pin pushed down."""
    pin = fs.all_tagged(ring(comm, 44, inner=0.4, centre=(0.0, 0.0)))
    lug = fs.all_tagged(ring(comm, 32, k=3, inner=1.02, radius=1.8, centre=(0.0, 0.0)))

    def interfaces(tags, R):
        return llm.Interface(None, ((tags[0], cs.ABOVE), (tags[1], cs.ABOVE)), law=law)

    moved = [(0, lambda p: np.hypot(p[0], p[1]) < 0.41)]
    fixed = [(1, lambda p: np.hypot(p[0], p[1]) > 1.79)]
    return solved([pin, lug], interfaces, moved, fixed, (0.0, -0.05), seed)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_pin_in_bore(law):
    """Contact turns with the bore: local normals, forces from all around the lower half."""
    problem, _, _ = in_bore(COMM, law)
    geometry, result = problem.geometries[0], problem.results[0]
    assert [len(side.facets) for side in geometry.sides] == [44, 32]
    for p in geometry.pairs:
        out = p.x / np.linalg.norm(p.x, axis=1)[:, None]
        assert np.abs(np.einsum("ni,ni->n", p.normal, out)).min() > 0.99
    side = result.sides[0]
    pressing = side.normal_force > 1e-3 * side.normal_force.max()
    angle = np.degrees(np.arctan2(side.x[:, 0], -side.x[:, 1]))[pressing]
    assert angle.min() < -25.0 and angle.max() > 25.0 and np.abs(angle).max() < 90.0
    assert result.resultant[1] < -1.0


def blocks_at(lift, law=None, motion=-0.0, tops=(cs.ABOVE, cs.BELOW), **options):
    """A block drawn over a block with a gap of ``lift``, negative where they overlap."""
    rng = np.random.default_rng(5)
    low = cs.rectangle(COMM, (9, 4), (-1, 0), (1, 1), "quadrilateral", 0.2, rng)
    high = cs.rectangle(COMM, (6, 3), (-0.6, 1 + lift), (0.6, 2 + lift), "triangle", 0.2, rng)

    def interfaces(tags, R):
        sides = (tags[0], tops[0]), (tags[1], tops[1])
        return llm.Interface(None, sides, law=law or llm.Frictionless())

    moved = [(1, lambda p: p[1] > 2 + lift - 1e-9)]
    fixed = [(0, lambda p: p[1] < 1e-9)]
    return solved([low, high], interfaces, moved, fixed, (0.0, motion), **options)


@pytest.mark.parametrize("depth, said", [(0.05, False), (0.29, True)])
def test_overlap_is_said(depth, said, caplog):
    """Less than a facet is noted, more is said, with numbers; bodies are pushed apart."""
    problem, _, _ = blocks_at(-depth)
    texts = [note for note in problem.geometries[0].notes if f"by {depth:g}" in note]
    assert texts and "inside of the body" in texts[0]
    assert any(f"by {depth:g}" in r.message for r in caplog.records) == said
    assert problem.results[0].resultant[1] > 1.0


@pytest.mark.parametrize(
    "lift, tops", [(-0.8, (cs.ABOVE, cs.BELOW)), (0.0, (cs.BELOW, cs.ABOVE))], ids=["deep", "away"]
)
def test_buried_bodies_are_refused(lift, tops):
    """Half inside of each other, or tags of the sides that face away."""
    with pytest.raises(llm.ContactError, match=r"deepest at .* by .*one body lies"):
        blocks_at(lift, tops=tops)


def test_one_body_inside_of_another():
    """Whole boundaries: a small box in a large one that is no cavity."""
    sides = box((-1, -1, -1), (1, 1, 1), 4, "large"), box((-0.2, -0.2, -0.2), (0.2, 0.2, 0.2), 3)
    assert separation(sides[1], sides[0]).depth.min() == pytest.approx(0.8)
    with pytest.raises(llm.ContactError, match="one body lies"):
        find_pieces(sides, True, "name", [])


@pytest.mark.parametrize("n", [(3, 3), (4, 3), (3, 4), (4, 4), (6, 3), (3, 7)], ids=str)
def test_few_facets_around_a_quarter_are_curved(n):
    """Each faces the one across, not a neighbour of it that leans to it by the same angle."""
    delta = 1e-3
    V, tags = curved_scenes.rings(
        COMM, ((n[0], 2), (n[1], 2)), ((1.0, 1.5 + 0.5 * delta), (1.5 - 0.5 * delta, 2.0))
    )
    faces = curved_scenes.FACE_0, curved_scenes.FACE_1
    for sides in (faces, faces[::-1]):
        geometry = build_interface(llm.Interface(tags, sides, law=llm.Frictionless()), [V])
        sagitta = 1.5 * (1.0 - np.cos(0.25 * np.pi / min(n)))
        assert max(np.abs(p.gap).max() for p in geometry.pairs) <= delta + sagitta
        assert np.ptp(np.linalg.norm(geometry.frame.x, axis=1)) <= delta + sagitta


def test_bodies_that_never_touch_are_said(caplog):
    problem, _, _ = blocks_at(0.3, motion=-0.1)
    assert not problem.results[0].resultant.any()
    assert any("from 0.3 as drawn to about 0.2" in r.message for r in caplog.records)
    assert "nothing touches" in str(problem)
    caplog.clear()
    problem, _, _ = blocks_at(0.0, motion=0.1)  # lifted off
    assert not problem.results[0].resultant.any() and not caplog.records


def test_pieces_have_cells_of_one_kind():
    """The finer side's facets where the coarser one's are of another kind than is wanted."""
    fine, coarse = box((0, 0, 0), (1, 1, 1), 6), box((0, 0, 1), (1, 1, 2), 3)
    tops = [
        side.part(np.flatnonzero((side.x[side.facets][..., 2] == 1.0).all(axis=1)))
        for side in (fine, coarse)
    ]
    quads = tops[1].facets
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    tops[1] = curved_scenes.surface(tops[1].x, triangles)
    forces = [np.ones(len(t.x)) for t in tops]
    for corners in (None, 3, 4):
        frame, _ = predict_frame(tops, forces, None, True, corners)
        assert len(frame.cells) == {None: 18, 3: 18, 4: 36}[corners]


@pytest.mark.parametrize(
    ("ranks", "scenes"), [(3, ["roller"]), longer(2, ["3D"]), longer(3, ["O-ring"])]
)
def test_ranks(ranks, scenes):
    one, other = (run_mpi_json("facing_ranks.py", n, *scenes) for n in (1, ranks))
    assert one.keys() == other.keys() and len(one) > 3
    for key, value in one.items():
        size = np.abs(value).max()
        assert np.abs(np.array(value) - other[key]).max() <= 1e-10 * size, key
