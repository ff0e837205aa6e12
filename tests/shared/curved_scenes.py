"""Curved surfaces and rings for the tests."""

import numpy as np
import scenes
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.geometry.surface import Surface

BORE, FACE_0, FACE_1, RIM = 1, 2, 3, 4


def surface(x, facets, name="tag"):
    """A surface without a body."""
    n = np.arange(len(x))
    return Surface(np.asarray(x, float), np.asarray(facets), n, 0 * n, name)


def arc(radius, n, low=0.0, high=90.0, outward=True):
    """Polygon on a circle, in degrees; a closed one from 0 to 360."""
    closed = high - low >= 360.0
    t = np.radians(np.linspace(low, high, n + 1)[: n + 1 - closed])
    first = np.arange(n)
    facets = np.column_stack([first, (first + 1) % len(t)])
    x = radius * np.column_stack([np.cos(t), np.sin(t)])
    return surface(x, facets[:, ::-1] if outward else facets)


def patch(shape, nx, ny, low, high, outward=True, triangles=False, seed=2001):
    """Jittered quads or triangles of a rectangle, mapped by ``shape`` (n, 2) -> (n, 3)."""
    s, quads = scenes.grid(nx, ny, low, high, jitter=0.2, seed=seed)
    if triangles:
        quads = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return surface(shape(s), quads if outward else quads[:, ::-1])


def cylinder(radius):
    """Angle and height to positions; anticlockwise rectangles point outwards."""
    return lambda s: np.column_stack([radius * np.cos(s[:, 0]), radius * np.sin(s[:, 0]), s[:, 1]])


def sphere(radius):
    """Gnomonic map of a rectangle to the sphere."""

    def shape(s):
        x = np.column_stack([s, np.ones(len(s))])
        return radius * x / np.linalg.norm(x, axis=1)[:, None]

    return shape


def rings(comm, counts, radii=((1.0, 1.5), (1.5, 2.0)), degrees=90.0):
    """Two rings of quads (n around, k radial) on one mesh, with tags of their four circles."""
    points, cells, first = [], [], 0
    closed = degrees >= 360.0
    for (n, k), (low, high) in zip(counts, radii, strict=True):
        m = n if closed else n + 1
        t = np.radians(np.linspace(0.0, degrees, n + 1)[:m])
        r = np.linspace(low, high, k + 1)
        points.append((r[:, None, None] * np.column_stack([np.cos(t), np.sin(t)])).reshape(-1, 2))
        i, j = (g.ravel() for g in np.meshgrid(np.arange(k), np.arange(n), indexing="ij"))
        a, b = first + i * m + j, first + i * m + (j + 1) % m
        cells.append(np.column_stack([a, a + m, b, b + m]))
        first += m * (k + 1)
    ends = np.cumsum([0] + [(n if closed else n + 1) * (k + 1) for n, k in counts])
    circles = zip((BORE, FACE_0, FACE_1, RIM), (0, 0, 1, 1), np.ravel(radii), strict=True)
    where = [(tag, k, lambda p, r=r: np.isclose(np.hypot(p[0], p[1]), r)) for tag, k, r in circles]
    domain, tags = scenes.bodies_mesh(comm, points, cells, "quadrilateral", ends, where)
    return compat.function_space(domain, shape=(2,)), tags


def ring_problem(V, tags, conditions, value=None, loads=None, law=None, sides=(FACE_0, FACE_1)):
    """The rings tied to each other, plane strain."""
    a, L = scenes.forms(V)
    return llm.ContactProblem(
        a,
        L,
        bcs=scenes.hold(V, conditions, value),
        interfaces=[llm.Interface(tags, sides, law=law or llm.Tied())],
        nodal_loads=loads or [],
    )


def drum(mu, counts, swap=False, frame=None):
    """A belt round the upper half of an elastic drum, and a function that pulls at its ends."""
    V, tags = rings(
        MPI.COMM_SELF, ((counts[0], 4), (counts[1], 2)), ((0.5, 1.0), (1.0, 1.1)), 180.0
    )
    a, L = scenes.forms(V)
    ends = [fem.Function(V) for _ in range(3)]
    r = lambda p: np.hypot(p[0], p[1])  # noqa: E731
    where = [
        lambda p: np.isclose(r(p), 0.5),
        lambda p: np.isclose(p[1], 0.0) & (p[0] > 1.04),
        lambda p: np.isclose(p[1], 0.0) & (p[0] < -1.04),
    ]
    bcs = [
        fem.dirichletbc(f, fem.locate_dofs_geometrical(V, w))
        for f, w in zip(ends, where, strict=True)
    ]
    sides = (FACE_0, FACE_1)
    interface = llm.Interface(
        tags, sides[::-1] if swap else sides, law=llm.Coulomb(mu), frame=frame
    )
    problem = llm.ContactProblem(a, L, bcs=bcs, interfaces=[interface])

    def pull(right, left):
        for f, amount in zip(ends[1:], (right, left), strict=True):
            f.interpolate(lambda p, d=amount: np.array([0.0 * p[0], -d + 0.0 * p[0]]))
        problem.solve()
        return problem.results[0]

    return problem, pull


def check_translations(problem):
    """Rigid translations of bodies and frame pass, and both sides' forces cancel."""
    geometry, result, L = problem.geometries[0], problem.results[0], problem.operators.blocks[0]
    gdim = geometry.frame.gdim
    base = np.concatenate([p.base.reshape(-1, gdim) for p in geometry.pairs])
    moved = geometry.directions.reshape(-1, gdim)
    assert np.abs(base - L @ moved).max() < 1e-9
    forces = [side.force for side in result.sides]
    largest = max(np.abs(f).max() for f in forces)
    assert np.abs(sum(f.sum(axis=0) for f in forces)).max() < 1e-10 * largest


def check_moments(problem, bound):
    """Both sides' forces cancel in their moments as well."""
    sides = problem.results[0].sides
    force, x = (np.concatenate([getattr(s, of) for s in sides]) for of in ("force", "x"))
    size = np.linalg.norm(np.ptp(x, axis=0)) * np.abs(force).max()
    assert np.abs(np.cross(x - x.mean(axis=0), force).sum(axis=0)).max() < bound * size


QUARTER = ((0, scenes.on(0, 0.0)), (1, scenes.on(1, 0.0)))
