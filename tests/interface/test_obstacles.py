"""Rigid obstacles: own ones, whole bodies' surfaces, bodies that lie inside or never touch."""

import itertools
import re

import contact_scenes as cs
import facing_scenes as fs
import numpy as np
import pairs
import pytest
from dolfinx import mesh
from mpi4py import MPI

import dolfinx_llm as llm

COMM = MPI.COMM_SELF
LAWS = [llm.Frictionless(), llm.Coulomb(0.3)]


class Sine(llm.Obstacle):
    """A floor that waves along x by ``height``, turned by R."""

    def __init__(self, height, R=None, gdim=2):
        self.height, self.R = height, np.eye(gdim) if R is None else R

    def clearance(self, x):
        p = x @ self.R
        normal = np.zeros_like(p)
        normal[:, 0], normal[:, -1] = self.height * np.cos(p[:, 0]), -1.0
        length = np.linalg.norm(normal, axis=1)
        distance = (p[:, -1] - self.height * np.sin(p[:, 0])) / length
        return distance, normal / length[:, None] @ self.R.T


def block(kind, lift=0.0, whole=False):
    """A block whose lower face, or whole boundary, is tagged BELOW; lifted off z = 0."""
    rng = np.random.default_rng(7)
    if kind in ("triangle", "quadrilateral"):
        body = cs.rectangle(COMM, (7, 4), (-1, lift), (1, 1 + lift), kind, 0.2, rng)
    else:
        low, high = (-1, -1, lift), (1, 1, 1 + lift)
        body = pairs.block(COMM, (4, 4, 2), low, high, kind, jitter=0.2, rng=rng)
    if whole:
        domain, tags = fs.all_tagged(body)
        one = np.full(len(tags.values), cs.BELOW, dtype=np.int32)
        body = domain, mesh.meshtags(domain, tags.dim, tags.indices, one)
    return body


def pressed(kind, obstacle, law, depth=0.02, lift=0.0, whole=False, seed=None):
    """A block pressed on an obstacle (a function of the rotation)."""
    body = block(kind, lift, whole)
    gdim = body[0].geometry.dim
    made = []

    def interfaces(tags, R):
        made.append(obstacle(R))
        return llm.Interface(tags[0], (cs.BELOW, made[0]), law=law)

    top = [(0, lambda p: p[gdim - 1] > 1.0 + lift - 1e-9)]
    motion = -depth * np.eye(gdim)[-1]
    return *fs.solved([body], interfaces, top, [], motion, seed), made[0]


def plane(R):
    return llm.RigidPlane(np.zeros(len(R)), R[:, -1])


KINDS = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]


@pytest.mark.parametrize(("kind", "law"), list(zip(KINDS, itertools.cycle(LAWS))))
def test_whole_boundary_against_a_plane(kind, law):
    """The same as its lower face alone, in any orientation: its other faces do not face it."""
    one, u, _, _ = pressed(kind, plane, law)
    for seed in (None, 3):
        other, v, R, _ = pressed(kind, plane, law, whole=True, seed=seed)
        assert fs.apart(u, v) < 1e-10
        forces = [p.results[0].sides[0].normal_force for p in (one, other)]
        assert np.sort(forces[0]) == pytest.approx(np.sort(forces[1]), abs=1e-9 * forces[0].max())
        areas = [p.geometries[0].area for p in (one, other)]
        assert areas[0] == pytest.approx(areas[1], rel=1e-12)


@pytest.mark.parametrize("gdim, kind", [(2, "triangle"), (3, "hexahedron")])
def test_own_obstacle(gdim, kind):
    """A waving floor by public names alone: nodes in contact lie on it, forces along its normals,
    turned with it, and as with a flat plane where it does not wave."""
    law = llm.Frictionless()
    problem, u, _, floor = pressed(kind, lambda R: Sine(0.1, R), law, lift=0.12, depth=0.15)
    side = problem.results[0].sides[0]
    closed = side.status > 0
    assert 0 < closed.sum() < len(closed) and side.normal_force.max() > 0.0
    distance, normal = floor.clearance(side.x)
    along = distance - np.einsum("ni,ni->n", side.u, normal)
    assert np.abs(along[closed]).max() < 1e-12 and along.min() > -1e-12
    np.testing.assert_allclose(side.force, side.normal_force[:, None] * normal, atol=1e-9)
    _, v, _, _ = pressed(kind, lambda R: Sine(0.1, R), law, lift=0.12, depth=0.15, seed=5)
    assert fs.apart(u, v) < 1e-10
    flat = [pressed(kind, o, law)[1] for o in (plane, lambda R: Sine(0.0, R, gdim))]
    assert fs.apart(*flat) < 1e-12


def test_rims_that_lean():
    """Facets of a bowl that end at planes of symmetry lean: nodes on the planes are above them."""
    s = np.linspace(0.0, 1.0, 5)
    x = np.stack(np.meshgrid(s, s, indexing="ij"), axis=2).reshape(-1, 2)
    at = np.arange(25).reshape(5, 5)
    cells = np.stack([at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]], axis=2).reshape(-1, 4)
    bowl = llm.RigidSurface(llm.Frame(np.column_stack([x, 0.3 * (x**2).sum(axis=1)]), cells))
    above = np.array([0.0, 0.0, 0.02]) + bowl.mesh.x
    distance, into = bowl.clearance(above[(x.max(axis=1) < 1.0)])
    assert 0.01 < distance.min() <= distance.max() <= 0.02
    assert (into[:, 2] < -0.7).all()
    for beside in ([-0.02, 0.5, 0.1], [0.5, -0.2, 1.5]):
        assert np.isinf(bowl.clearance(np.array([beside]))[0]).all()


def box(kind, n=2):
    """The surface of a cube [-1, 1]³, of a square, of n cells along each edge."""
    s = np.linspace(-1.0, 1.0, n + 1)
    if kind == "square":
        ring = [np.column_stack([-s[:-1], 0 * s[:-1] - 1.0])]
        for _ in range(3):  # clockwise
            ring.append(ring[-1] @ np.array([[0.0, -1.0], [1.0, 0.0]]))
        x, k = np.concatenate(ring), np.arange(4 * n)
        return llm.Frame(x, np.column_stack([k, np.roll(k, -1)]))
    x = np.stack(np.meshgrid(s, s, s, indexing="ij"), axis=3).reshape(-1, 3)
    at = np.arange(len(x)).reshape(n + 1, n + 1, n + 1)
    faces = [np.take(at, i, axis) for axis in range(3) for i in (0, n)]
    faces = [f.T if i in (0, 3, 4) else f for i, f in enumerate(faces)]
    corners = ((slice(-1), slice(-1)), (slice(1, None), slice(-1)),
               (slice(1, None), slice(1, None)), (slice(-1), slice(1, None)))  # fmt: skip
    cells = np.concatenate([np.stack([f[c] for c in corners], axis=2) for f in faces])
    nodes, cells = np.unique(cells.reshape(-1, 4), return_inverse=True)
    cells = cells.reshape(-1, 4)
    if kind == "triangles":
        cells = np.concatenate([cells[:, :3], cells[:, [0, 2, 3]]])
    return llm.Frame(x[nodes], cells)


@pytest.mark.parametrize("kind", ["square", "quads", "triangles"])
def test_meshes_with_edges(kind):
    """Distance to a box of facets, outside and, with its normals turned, inside of them, is known;
    the way there leads to it. Without one of its faces it stops nobody beyond their rim alone."""
    mesh, rng = box(kind), np.random.default_rng(4)
    x = rng.uniform(-2.0, 2.0, (400, mesh.gdim))
    q = np.abs(x) - 1.0
    known = np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)
    for frame, sign in ((mesh, 1.0), (mesh.flipped(), -1.0)):
        distance, into = llm.RigidSurface(frame).clearance(x)
        assert np.abs(distance - sign * known).max() < 1e-12
        on = np.abs(x + distance[:, None] * into).max(axis=1)
        assert np.abs(on - 1.0).max() < 1e-12
    left = np.flatnonzero(mesh.x[mesh.cells][:, :, -1].min(axis=1) < 1.0)
    nodes, cells = np.unique(mesh.cells[left], return_inverse=True)
    open_box = llm.Frame(mesh.x[nodes], cells.reshape(len(left), -1))
    distance = llm.RigidSurface(open_box).clearance(x)[0]
    above = (x[:, -1] > 1.0) & (q[:, :-1].max(axis=1) > 0.0)
    assert above.sum() > 20 and np.isinf(distance[above]).all()
    below = (x[:, -1] < 0.0) & (known > 0.0)
    assert below.sum() > 100 and np.abs(distance - known)[below].max() < 1e-12


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_pressed_lifted_and_pressed_again(law, caplog):
    """A block that does not touch yet solves; nothing remains of being pressed once lifted."""
    problem, u, _, floor = pressed("triangle", plane, law, lift=0.05, depth=0.01)
    side = problem.results[0].sides[0]
    assert not side.force.any() and (side.status == 0).all()
    assert any(
        "not touching as drawn" in note and "0.05" in note for note in problem.geometries[0].notes
    )
    assert any("nothing touches" in r.message and "0.04" in r.message for r in caplog.records)
    assert "nothing touches" in str(problem)
    caplog.clear()
    floor.displacement = (0.0, 0.001)
    problem.solve()  # of a clearance that stays this is said once, though with other numbers
    assert "nothing touches" in str(problem) and not caplog.records
    answers = []
    for up in (0.06, 0.0, -0.1, 0.06):  # the plane moves
        floor.displacement = (0.0, up)
        answers.append(problem.solve()[0].x.array.copy())
        pressed_now = problem.results[0].sides[0].normal_force.sum()
        assert (pressed_now > 1.0) == (up > 0.05)
    if not law.slips:
        assert np.abs(answers[0] - answers[3]).max() < 1e-12
    caplog.clear()
    floor.displacement = (0.0, -0.2)
    problem.solve()
    assert not caplog.records  # moved away: nobody wants to press


class Wrong(llm.Obstacle):
    def __init__(self, answer):
        self.answer = answer

    def clearance(self, x):
        return self.answer(x)


INSIDE = {
    "below the plane": (
        lambda R: llm.RigidPlane((0.0, 3.0), (0.0, 1.0)),
        "inside of the Rigid.*by 3",
    ),
    "the normal turned": (lambda R: llm.RigidPlane((0.0, 0.0), (0.0, -1.0)), "no node.*faces"),
    "inside a ball": (lambda R: llm.RigidSphere((0.0, 3.0), 5.0), "inside of the RigidSphere"),
    "half of it": (lambda R: llm.RigidPlane((0.0, 0.9), (0.0, 1.0)), "deepest at .* by 0.9"),
    "shape": (lambda R: Wrong(lambda x: (x, x)), "unit vectors"),
    "length": (lambda R: Wrong(lambda x: (x[:, 0], 2 * np.ones_like(x))), "of length 2.8"),
    "nan": (lambda R: Wrong(lambda x: (np.nan * x[:, 0], x)), "NaN"),
    "nothing": (lambda R: Wrong(lambda x: None), "unit vectors"),
}


@pytest.mark.parametrize("name", INSIDE)
def test_refused(name):
    obstacle, words = INSIDE[name]
    with pytest.raises(llm.ContactError, match=words):
        pressed("quadrilateral", obstacle, llm.Frictionless(), whole=name != "the normal turned")


def test_deeper_than_a_facet_is_said(caplog):
    """Said with its numbers; less than a facet is noted."""
    for depth, said in ((0.05, False), (0.4, True)):
        caplog.clear()
        problem, *_ = pressed("quadrilateral", plane, llm.Frictionless(), lift=-depth, depth=0.0)
        text = f"deepest at .* by {depth:g}"

        assert any(re.search(text, note) for note in problem.geometries[0].notes)
        assert any(re.search(text, r.message) for r in caplog.records) == said
        # Pushed out by as much.
        side = problem.results[0].sides[0]
        assert np.einsum("ni,ni->n", side.u, side.normal)[side.status > 0] == pytest.approx(-depth)


def test_displacement_counts():
    """An obstacle drawn inside of the body and moved away before the first solve."""
    obstacle = llm.RigidPlane((0.0, 3.0), (0.0, 1.0), displacement=(0.0, -3.0))
    problem, *_ = pressed("quadrilateral", lambda R: obstacle, llm.Frictionless())
    assert problem.results[0].resultant[1] < -1.0
