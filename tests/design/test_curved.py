"""Curved tied interfaces: covered area, rows, shrink fit and bonded tube against Lamé."""

import curved_scenes as cs
import numpy as np
import pytest
import scenes
import shrink_fit
from conftest import run_mpi_json
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm.design.balance import balance
from dolfinx_llm.design.curved import smooth_rows, vector_residual, with_mean_normals
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.loads import NodalLoads
from dolfinx_llm.geometry.overlap_curved import vector_areas_in_contact
from dolfinx_llm.geometry.pairs import locate_pairs
from dolfinx_llm.interface.build import build_interface

QUARTER_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])


def length(a):
    return np.linalg.norm(a, axis=1).sum()


# Covered area


def test_closed_circles_cover_each_other():
    sides = cs.arc(1.0, 31, 0.0, 360.0), cs.arc(1.0, 20, 0.0, 360.0, outward=False)
    for side, a in zip(sides, vector_areas_in_contact(*sides), strict=True):
        n = len(side.x)
        assert np.abs(a.sum(axis=0)).max() < 1e-14
        # Every node has half of both chords: their vector sum is the chord over the neighbours.
        np.testing.assert_allclose(length(a), n * np.sin(2 * np.pi / n), rtol=1e-13)
        radial = np.einsum("ni,ni->n", a, side.x)
        assert (radial > 0.0).all() if side is sides[0] else (radial < 0.0).all()


@pytest.mark.parametrize("n", [8, 33, 200])
def test_arc_on_a_circle(n):
    """The circle's facets at the ends of an arc from 30 to 100 degrees are cut there."""
    sides = cs.arc(1.0, 64, 0.0, 360.0), cs.arc(1.0, n, 30.0, 100.0, outward=False)
    a, b = vector_areas_in_contact(*sides)
    ends = [np.array([np.cos(t), np.sin(t)]) for t in np.radians([30.0, 100.0])]
    chord = (ends[1] - ends[0]) @ QUARTER_TURN  # the sum of the vector areas of any curve
    np.testing.assert_allclose(b.sum(axis=0), -chord, atol=1e-14)
    np.testing.assert_allclose(a.sum(axis=0), chord, atol=3e-3)
    on = np.flatnonzero(np.abs(a).any(axis=1))
    angle = np.degrees(np.arctan2(*sides[0].x[on].T[::-1]))
    assert angle.min() > 30.0 - 360 / 64 and angle.max() < 100.0 + 360 / 64


@pytest.mark.parametrize("triangles", [False, True])
def test_cylinders_that_overlap_in_part(triangles):
    low, high = (0.2, 0.0), (1.4, 1.0)
    sides = (
        cs.patch(cs.cylinder(1.0), 14, 9, low, high),
        cs.patch(cs.cylinder(1.0), 17, 8, (0.5, 0.3), (1.9, 1.7), False, triangles, seed=11),
    )
    a, b = vector_areas_in_contact(*sides)
    # Vector area of the cylinder from 0.5 to 1.4 and height 0.3 to 1.
    exact = 0.7 * np.array([np.sin(1.4) - np.sin(0.5), np.cos(0.5) - np.cos(1.4), 0.0])
    np.testing.assert_allclose(a.sum(axis=0), exact, atol=3e-3)
    np.testing.assert_allclose(b.sum(axis=0), -exact, atol=3e-3)


# Rows of L_b


def rows(sides, k=1, close_gap=False):
    """Frame on the facets of side k, pairs before and after design, and vector areas."""
    vectors = vector_areas_in_contact(*sides)
    facets = sides[k].facets[:, ::-1] if k else sides[k].facets
    frame = Frame(sides[k].x, facets)
    areas = [np.linalg.norm(a, axis=1) for a in vectors]
    plain = locate_pairs(sides, [NodalLoads.of_forces(f) for f in areas], frame, 3.0)
    vectors = [a[p.nodes] for a, p in zip(vectors, plain, strict=True)]
    smooth = smooth_rows(frame, plain, close_gap)
    N = balance(smooth.rows(1.0), vectors, smooth.stencils)
    return frame, plain, with_mean_normals(smooth.pairs, smooth.surface.normals), N, vectors


SCENES = {
    "arcs": lambda gap: (cs.arc(1.0 - gap, 22), cs.arc(1.0, 16, outward=False)),
    "circles": lambda gap: (
        cs.arc(1.0 - gap, 45, 0.0, 360.0),
        cs.arc(1.0, 32, 0.0, 360.0, outward=False),
    ),
    "cylinders": lambda gap: (
        cs.patch(cs.cylinder(1.0 - gap), 14, 9, (0.2, 0.0), (1.4, 1.0)),
        cs.patch(cs.cylinder(1.0), 10, 7, (0.2, 0.0), (1.4, 1.0), False, seed=11),
    ),
    "spheres": lambda gap: (
        cs.patch(cs.sphere(1.0 - gap), 13, 13, (-0.5, -0.5), (0.5, 0.5)),
        cs.patch(cs.sphere(1.0), 9, 9, (-0.5, -0.5), (0.5, 0.5), False, True, seed=11),
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_rows_reproduce_places_and_balance(name):
    frame, plain, pairs, N, vectors = rows(SCENES[name](0.0))
    for before, side, M in zip(plain, pairs, N, strict=True):
        assert np.abs(M.sum(axis=1) - 1.0).max() < 1e-12
        chordal, left = (np.linalg.norm(side.x - L @ frame.x, axis=1) for L in (before.N, M))
        assert left.max() <= max(1e-12, 0.5 * chordal.max())
        assert np.mean(left < 1e-12) > 0.9  # all but some at corners of the frame
    size = [np.sqrt(np.mean(vector_residual(L, vectors) ** 2)) for L in ([p.N for p in plain], N)]
    assert size[1] < 0.35 * size[0]


@pytest.mark.parametrize("name", SCENES)
def test_gap_between_smooth_surfaces(name):
    """A gap below the chords' own gaps (1e-3 to 1e-2) is found."""
    *_, pairs, _, _ = rows(SCENES[name](1e-3), close_gap=True)
    gap = np.einsum("ni,ni->n", pairs[0].gap, pairs[0].normal)
    # The gap of side 0 to the frame: it lies below.
    np.testing.assert_allclose(np.median(gap), -1e-3, rtol=0.03)
    assert np.mean(np.abs(gap + 1e-3) < 1e-4) > 0.9
    np.testing.assert_allclose(pairs[1].gap, 0.0, atol=1e-12)


def test_gap_beyond_the_outline():
    """Nodes beyond the frame's ends see the arc go on, not its last chord."""
    sides = cs.arc(0.999, 7, -10.0, 95.0), cs.arc(1.0, 4, 0.0, 90.0, outward=False)
    frame, _, pairs, _, _ = rows(sides, close_gap=True)
    gap = np.einsum("ni,ni->n", pairs[0].x, pairs[0].gap) / 0.999
    np.testing.assert_allclose(gap, -1e-3, rtol=1e-2)


def test_two_places_that_are_as_close_count_for_the_same():
    """Inside of a fold, in the middle: neither mesh order nor axes may choose."""
    fold = Frame([[-1.0, 0.5], [0.0, 0.6], [1.0, 0.5]], [[0, 1], [1, 2]])
    N = fold.interpolation(fold.locate([[0.0, 0.59], [0.3, 0.5]])).toarray()
    assert N[0, 0] == pytest.approx(N[0, 2], rel=1e-9) and N[0, 0] > 1e-4
    np.testing.assert_allclose(N.sum(axis=1), 1.0, rtol=1e-14)


def test_normals_are_those_of_the_surface():
    frame, _, pairs, _, _ = rows(SCENES["spheres"](0.0))
    exact = pairs[0].x / np.linalg.norm(pairs[0].x, axis=1)[:, None]
    assert np.abs(pairs[0].normal - exact).max() < 2e-3
    np.testing.assert_allclose(pairs[1].normal, -pairs[1].x, atol=3e-3)


# Problems


def test_rigid_rotation_passes():
    """Tied as drawn: no stress from a rotation, which plain rows would resist."""
    V, tags = cs.rings(MPI.COMM_SELF, ((22, 3), (16, 3)))
    turn = lambda p: 1e-3 * np.array([0.3 - p[1], p[0] - 0.2])  # noqa: E731
    bore = lambda p: np.hypot(p[0], p[1]) < 1.0 + 1e-9  # noqa: E731
    contact = cs.ring_problem(V, tags, ((0, bore), (1, bore)), turn)
    u = contact.solve()
    assert scenes.displacement_error(u, turn) < 1e-10
    assert max(np.abs(s.force).max() for s in contact.results[0].sides) < 1e-9


@pytest.mark.parametrize("sides", [(2, 3), (3, 2)])
def test_shrink_fit_of_full_rings(sides):
    """Closed rings, held at the rim's nodes on the axes; either order of the sides."""
    delta = 1e-3
    radii = ((1.0, 1.5 + delta / 2), (1.5 - delta / 2, 2.0))
    V, tags = cs.rings(MPI.COMM_SELF, ((60, 8), (44, 8)), radii, 360.0)
    rim = lambda k: lambda p: np.isclose(p[k], 0.0, atol=1e-9) & (np.hypot(*p[:2]) > 1.9)  # noqa: E731
    contact = cs.ring_problem(
        V, tags, ((0, rim(0)), (1, rim(1))), law=llm.Tied(close_gap=True), sides=sides
    )
    contact.solve()
    a, b, c = 1.0, 1.5, 2.0
    p = scenes.E / (1 - scenes.NU**2) * delta * (b**2 - a**2) * (c**2 - b**2)
    p /= 2 * b**3 * (c**2 - a**2)
    for found in shrink_fit.pressures(contact).values():
        assert abs(found.mean() / p - 1) < 0.005
        assert np.abs(found / p - 1).max() < 0.05
    assert contact.geometries[0].certificate.residual < 0.02


@pytest.mark.parametrize("dim, mean, most", [(2, 0.004, 0.03), (3, 0.006, 0.06)])
def test_demo(dim, mean, most):
    report = shrink_fit.main(["--dim", str(dim)])
    for found in report["pressures"].values():
        assert abs(found.mean() / report["exact"] - 1) < mean
        assert np.abs(found / report["exact"] - 1).max() < most
    certificate = report["certificate"]
    assert certificate.residual < 0.2 * certificate.residual_before


def bonded_tube(counts):
    """Errors of displacement and of the interface's pressure, internal pressure in the bore."""
    V, tags = cs.rings(MPI.COMM_SELF, counts)
    p = 10.0
    loads = [llm.free_surface_load(V, tags, cs.BORE, p)]
    contact = cs.ring_problem(V, tags, cs.QUARTER, loads=loads)
    u = contact.solve()
    a, b, c = 1.0, 1.5, 2.0
    k = p * a**2 / (c**2 - a**2)

    def exact(x):
        r = np.hypot(x[0], x[1])
        ur = (1 + scenes.NU) / scenes.E * k * ((1 - 2 * scenes.NU) * r + c**2 / r)
        return np.array([ur * x[0] / r, ur * x[1] / r, 0 * r])

    pressure = k * (c**2 / b**2 - 1)
    found = shrink_fit.pressures(contact)["frame, from side 0"]
    return scenes.displacement_error(u, exact), np.abs(found / pressure - 1).max()


def test_bonded_tube_converges_like_the_matching_mesh():
    split = np.array([bonded_tube(((11 * n, 4 * n), (8 * n, 3 * n))) for n in (1, 2, 4)])
    matching = np.array([bonded_tube(((11 * n, 4 * n), (11 * n, 3 * n))) for n in (1, 2, 4)])
    rates = np.log2(split[:-1] / split[1:])
    assert (rates[:, 0] > 1.8).all()
    assert (split[:, 0] < 1.5 * matching[:, 0]).all()
    assert split[-1, 1] < 0.02


def test_two_ranks():
    one, two = (run_mpi_json("solve_curved.py", n) for n in (1, 2))
    for key in one:
        a, b = np.array(one[key]), np.array(two[key])
        np.testing.assert_allclose(a, b, atol=1e-10 * np.abs(a).max(), err_msg=key)


# Refused


@pytest.mark.parametrize("size", [1, 2])
def test_errors(size):
    """On all ranks, with the numbers."""
    assert run_mpi_json("solve_curved.py", size, "errors") == {"wrong": []}


@pytest.mark.parametrize("counts", [(2, 7), (3, 4), (4, 3), (4, 6), (8, 11), (5, 16)])
@pytest.mark.parametrize("law", [llm.Tied(), llm.Coulomb(0.3)], ids=str)
def test_a_design_is_never_worse_than_none(counts, law):
    """The vector residual does not grow, rows sum to 1, and a coarse mesh is said to be one."""
    V, tags = cs.rings(MPI.COMM_SELF, [(n, 1) for n in counts])
    geometry = build_interface(llm.Interface(tags, (cs.FACE_0, cs.FACE_1), law=law), [V])
    certificate = geometry.certificate
    assert certificate.residual <= certificate.residual_before
    for p in geometry.pairs:
        assert np.abs(p.N.sum(axis=1) - 1.0).max() < 1e-9
    said = any("are coarse" in note for note in geometry.notes)
    assert said == (certificate.residual > 0.1)


@pytest.mark.parametrize("law", [llm.Tied(close_gap=True), llm.Frictionless(), llm.Coulomb(0.3)])
def test_fits_of_coarse_rings(law):
    """Chordal gaps are up to fifty times what is fitted: without design they would be closed."""
    delta, a, b, c = 1e-3, 1.0, 1.5, 2.0
    radii = ((a, b + delta / 2), (b - delta / 2, c))
    p = scenes.E / (1 - scenes.NU**2) * delta * (b**2 - a**2) * (c**2 - b**2)
    p /= 2 * b**3 * (c**2 - a**2)
    for counts, most in (
        (((4, 2), (6, 2)), 0.1),
        (((5, 2), (16, 5)), 0.2),
        (((8, 3), (11, 4)), 0.05),
    ):
        V, tags = cs.rings(MPI.COMM_SELF, counts, radii)
        contact = cs.ring_problem(V, tags, cs.QUARTER, law=law)
        contact.solve()
        cs.check_translations(contact)
        for side in contact.results[0].sides:
            assert np.abs(side.normal_force / (p * side.area) - 1.0).max() < most
