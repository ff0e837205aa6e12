"""Surfaces that fold onto themselves: how they are parted, and what they carry."""

import folding
import numpy as np
import pytest
import ufl
from conftest import TESTS, run_mpi_json
from dolfinx import fem
from mpi4py import MPI
from own_law import Soft
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.finite.frame.design import Design
from dolfinx_llm.finite.frame.self_sides import SelfSides
from dolfinx_llm.finite.pairs.normal_contact import NormalContact
from dolfinx_llm.geometry.surface import Surface

NEAR = folding.RADIUS - 0.04  # way of the jaws before the legs touch


def chain(x, closed=False):
    """Sides of a polyline of points (n, 2), whose normals point to its left."""
    at = np.arange(len(x))
    facets = np.column_stack([at, np.roll(at, -1)])[: None if closed else -1]
    return SelfSides.of_one(Surface(np.asarray(x), facets, at, 0 * at, "chain"))


def spiral(turns, step):
    """Points of a spiral of a given distance between its windings."""
    angle = np.linspace(2 * np.pi, 2 * np.pi * (turns + 1), 72 * turns)
    r = step * angle / (2 * np.pi)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle)])


def serpentine(strands, gap):
    """The outline of a wire folded to and fro, up one side and back on the other."""
    x = [np.linspace(0.0, 2.0, 11)[:: 1 - 2 * (k % 2)] for k in range(strands)]
    y = [np.full(11, k * (gap + 0.3)) for k in range(strands)]
    middle = np.column_stack([np.concatenate(x), np.concatenate(y)])
    side = 0.15 * np.repeat(1 - 2 * (np.arange(strands) % 2), 11)[:, None] * [0.0, 1.0]
    return np.concatenate([middle + side, (middle - side)[::-1]])


def test_facets_across_come_apart():
    """Of facets of a serpentine wire that face each other at less than a facet one moves, one does
    not. On a spiral seen from one side, and around a convex outline, nothing faces anything."""
    x = serpentine(4, 0.1)
    sides = chain(x, closed=True)
    moving, facets = sides.parted(x), sides.mover.facets
    centre, along = x[facets].mean(axis=1), np.diff(x[facets], axis=1)[:, 0]
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.hypot(*along.T)[:, None]
    arm = centre[None] - centre[:, None]
    ahead = np.einsum("fgi,fi->fg", arm, normal)
    facing = (normal @ normal.T < -0.95) & (ahead > 0.0) & (ahead < 0.12)
    i, j = np.nonzero(facing & facing.T & (np.linalg.norm(arm, axis=2) - ahead < 0.02))
    apart = np.abs(i - j) > 2  # the end of a pocket is as near along the surface as across
    i, j = i[apart], j[apart]
    assert len(i) > 30
    assert (moving[i] != moving[j]).all()
    angle = np.linspace(0.0, -2.0 * np.pi, 41)[:-1]
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    for x, closed in ((spiral(3, 0.5), False), (circle, True)):
        assert not chain(x, closed).parted(x).any()


def test_no_two_sides():
    """Three walls of a slit like a Y face each other two by two."""
    walls, along = [], np.linspace(1.0, 0.1, 10)[:, None]
    for a, b in np.deg2rad([(90.0, -30.0), (-30.0, 210.0), (210.0, 90.0)]):
        to, fro = np.array([np.cos(a), np.sin(a)]), np.array([np.cos(b), np.sin(b)])
        beside = 0.05 * np.array([[np.sin(a), -np.cos(a)], [-np.sin(b), np.cos(b)]])
        walls += [along * to + beside[0], along[::-1] * fro + beside[1]]
    slit = np.concatenate(walls)[::-1]
    with pytest.raises(llm.ContactError, match="meets itself where it has no two sides"):
        chain(slit, True).parted(slit)


@pytest.mark.parametrize("n", [6, 8, 12])
def test_tight_bends(n):
    """The legs of a U face each other, one of which moves, its bend of few facets does not face
    itself, and neither does a small hole: they were told to have no two sides."""
    angle = np.linspace(-0.5, -1.5, n + 1)[:, None] * np.pi
    bend = 0.5 * np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
    leg = np.column_stack([np.linspace(0.6, 3.6, 6), np.full(6, 0.5)])
    x = np.concatenate([leg[::-1] * [1.0, -1.0], bend, leg])[::-1]
    moving = chain(x).parted(x)
    assert (moving[:5] != moving[-5:]).all()
    assert len(np.unique(moving[:5])) == 1
    angle = np.linspace(0.0, 2.0 * np.pi, 10)[:-1]
    hole = np.column_stack([np.cos(angle), np.sin(angle)])
    assert not chain(hole, True).parted(hole).any()


def test_folded_edgewise():
    """Legs on each other, of which one carries the frame: as drawn they lie in line along the main
    axis of the whole, and what balances the covered part must not depend on rounding."""
    rng, at = np.random.default_rng(0), np.arange(61)
    for _ in range(5):
        x = folding.bent(np.linspace(-2.5, 2.5, 61), 0.0)
        number = rng.permutation(61)
        facets = np.argsort(number)[np.column_stack([at[:-1], at[1:]])]
        sides = SelfSides.of_one(Surface(x[number], facets, at, 0 * at, "chain"))
        contact = NormalContact(sides, Design.of(sides.surfaces[0].x, facets))
        x[:, 1] *= 0.01 + 0.99 * np.maximum(x[:, 0], 0.0)
        x += 1e-15 * rng.standard_normal(x.shape)
        z = np.concatenate([x[number].ravel()] * 2)
        held = contact.hold(z)
        place = contact.place(z, np.zeros(contact.size), held)
        assert held.candidates.sum() == 11 and (place.areas[1] > 0.0).sum() == 12
        assert np.abs(place.rows.mu).max() <= 1e-9


CLOSES = 0.5, NEAR, folding.RADIUS + folding.PRESSED  # ways of the jaws until the legs press


def fold(problem, jaws, ways=CLOSES):
    """Press the legs together; the last step's sides."""
    for way in ways:
        for jaw, sign in zip(jaws, (1.0, -1.0), strict=True):
            jaw.value = sign * way
        problem.solve()
    return problem.results[0].sides


def check_balance(result, pairs):
    """More than so many pairs press, and forces and moments balance."""
    frame, moving = result.sides
    pressing, size = moving.status > 0, np.abs(moving.force).sum()
    assert pressing.sum() > pairs and (moving.normal_force[pressing] > 0.0).all()
    assert np.abs(moving.force.sum(axis=0) + frame.force.sum(axis=0)).max() <= 1e-10 * size
    assert np.abs(result.moment(side=0) + result.moment(side=1)).max() <= 1e-10 * size


# Symmetric forces are an equilibrium of more energy, which rounding leaves, or does not.
ROUNDED = pytest.mark.xfail(strict=False, reason="legs buckle along each other: limits.md")
BUCKLES = [pytest.mark.long, ROUNDED]
MIRRORED = [
    (0.0, "quad", 1),
    longer(0.3, "quad", 1),
    pytest.param(0.0, "quad", 2, marks=BUCKLES),
    pytest.param(0.0, "hex", 1, marks=BUCKLES),
]


@pytest.mark.parametrize("mu, kind, degree", MIRRORED)
def test_mirror(mu, kind, degree):
    """Half a hairpin on a rigid plane in its middle, without friction, carries the same forces at
    all nodes; so it does where the whole has friction, since nothing slips. Legs of hexahedra that
    are pressed more buckle along each other, from rounding."""
    ways = CLOSES if kind == "quad" else (*CLOSES[:2], folding.RADIUS + 0.01)
    chosen = {"kind": kind, "layers": 3}
    whole, jaws = folding.problem(*folding.hairpin(MPI.COMM_WORLD, **chosen), mu, degree=degree)
    domain, tags = folding.hairpin(MPI.COMM_WORLD, half=True, **chosen)
    dim = domain.geometry.dim
    plane = llm.RigidPlane((0.0, 0.0, 0.0)[:dim], (0.0, 1.0, 0.0)[:dim])
    touch = llm.Interface(tags, (folding.INSIDE, plane), law=llm.Frictionless())
    half, jaw = folding.problem(domain, tags, interfaces=[touch], middle=True, degree=degree)
    first, second = fold(whole, jaws, ways)
    (side,) = fold(half, jaw, ways)
    at = np.linalg.norm(side.X[:, None] - first.X, axis=2).argmin(axis=1)
    force, size = (first.force + second.force)[at], np.abs(side.force).max()
    assert (np.abs(force[:, 1]) > 0.1 * size).sum() > 5
    assert np.abs(force - side.force).max() <= 1e-8 * size
    assert np.abs(first.x[at] - side.x).max() <= 1e-8
    assert folding.asymmetry(whole.results[0].sides) <= 1e-8
    assert dim == 3 or folding.overlap(first.x, first.facets) <= 1e-6


def test_in_space():
    """Legs on each other with a depth: what is covered, and gaps; legs that have gone through each
    other."""
    x, n = folding.bent(np.linspace(-2.5, 2.5, 61), 0.0), 61
    at = np.arange(n - 1)
    facets = np.column_stack([at, at + n, at + n + 1, at + 1])
    extruded = lambda x: np.column_stack([np.tile(x, (2, 1)), np.repeat([0.0, 0.1], n)])  # noqa: E731
    owner = np.arange(2 * n)
    sides = SelfSides.of_one(Surface(extruded(x), facets, owner, 0 * owner, "band"))
    contact = NormalContact(sides, Design.of(extruded(x), facets))
    x[:, 1] *= 0.01 + 0.99 * np.maximum(x[:, 0], 0.0)
    z = np.tile(extruded(x).ravel(), 2)
    place = contact.place(z, np.zeros(contact.size), contact.hold(z))
    carries, moves = place.areas[1] > 0.0, place.areas[0] > 0.0
    assert carries.sum() == moves.sum() == 24
    for areas in place.areas:
        assert areas.sum() == pytest.approx(11 * 0.1 * 5.0 / 60.0, rel=1e-12)
    assert place.gap[moves] == pytest.approx(0.02, rel=1e-12)
    sides.check_crossed(extruded(x))
    x[:, 1] -= np.sign(x[:, 1]) * np.where(x[:, 0] < 0.0, 0.035, 0.0)
    with pytest.raises(llm.ContactError, match=r"goes through itself: [1-9]\d* pair.s. of facets"):
        sides.check_crossed(extruded(x))


@pytest.mark.long
def test_soft_layer():
    """A law of one's own: symmetric, legs overlap by what it tells, and half of the hairpin does by
    half as much on a plane, where its legs carry the same forces."""
    domain, tags = folding.hairpin(MPI.COMM_WORLD)
    law = Soft(30.0, 0.01)
    problem, jaws = folding.problem(
        domain, tags, interfaces=[llm.SelfContact(tags, folding.INSIDE, law)]
    )
    frame, moving = fold(problem, jaws)
    assert folding.asymmetry((frame, moving)) <= 1e-8
    pressing = moving.status > 0
    pressure = moving.normal_force[pressing] / moving.area[pressing]
    assert pressing.sum() > 5
    assert moving.gap[pressing] == pytest.approx(-law.h * np.log1p(pressure / law.p0), rel=1e-8)
    domain, tags = folding.hairpin(MPI.COMM_WORLD, half=True)
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    touch = llm.Interface(tags, (folding.INSIDE, plane), law=Soft(30.0, 0.005))
    half, jaw = folding.problem(domain, tags, interfaces=[touch], middle=True)
    (side,) = fold(half, jaw)
    at = np.linalg.norm(side.X[:, None] - frame.X, axis=2).argmin(axis=1)
    difference = np.abs((frame.force + moving.force)[at] - side.force).max(axis=1)
    assert difference.max() <= 1e-3 * np.abs(side.force).max()  # at the rim: areas end in a facet
    assert difference[side.X[:, 0] < -0.5].max() <= 1e-7 * np.abs(side.force).max()


@pytest.mark.long
def test_mesh_without_symmetry():
    """Nodes that do not meet nodes: forces and moments balance; between nodes facets that bend may
    overlap by a part of their size."""
    problem, jaws = folding.problem(*folding.hairpin(MPI.COMM_WORLD, skew=0.15))
    _, moving = fold(problem, jaws)
    check_balance(problem.results[0], 5)
    assert folding.overlap(moving.x, moving.facets) <= 0.1


@pytest.mark.long
def test_buckles():
    """Legs that are pressed on each other give way along each other where something leads them to:
    a mesh whose cells differ by half a hundredth ends in an equilibrium of less energy."""
    stored = []
    for skew in (0.0, 5e-3):
        domain, tags = folding.hairpin(MPI.COMM_WORLD, skew=skew)
        problem, jaws = folding.problem(domain, tags)
        u = problem.u
        stiff = (fem.Constant(domain, c) for c in folding.lame(folding.YOUNG, folding.POISSON))
        density = folding.energy(u, *stiff) * ufl.dx(degree=4)
        pressed = np.linspace(NEAR, folding.RADIUS + folding.PRESSED, 5)[1:]
        first, second = fold(problem, jaws, (0.5, NEAR, *pressed))
        stored.append(fem.assemble_scalar(fem.form(density)))
        F = fem.form(ufl.derivative(density, u, ufl.TestFunction(u.function_space)))
        rest = compat.assemble_force((F,), (1.0,), u.function_space).reshape(-1, 2)
        drawn = u.function_space.tabulate_dof_coordinates()[:, :2]
        at = np.linalg.norm(drawn[:, None] - first.X, axis=2).argmin(axis=0)
        rest[at] += first.force + second.force
        free = np.abs(drawn[:, 1]) < folding.RADIUS + folding.THICK - 1e-6
        assert np.abs(rest[free]).max() <= 1e-9 * np.abs(second.force).max()
        assert (second.normal_force[second.status > 0] > 0.0).all()
        assert folding.overlap(first.x, first.facets) <= 0.1
        assert (folding.asymmetry((first, second)) > 0.5) == (skew > 0.0)
    assert stored[1] < 0.98 * stored[0]


@pytest.mark.long
def test_tetrahedra():
    """Meshes that do not mirror each other, in space: forces and moments balance, pairs press."""
    problem, jaws = folding.problem(*folding.hairpin(MPI.COMM_WORLD, kind="tet", layers=3))
    fold(problem, jaws, (0.5, NEAR, folding.RADIUS, folding.RADIUS + 0.02))
    check_balance(problem.results[0], 20)


def test_through_itself():
    """Legs that have changed places."""
    sides = chain(folding.bent(np.linspace(-2.5, 2.5, 61), 0.0))
    x = sides.surfaces[0].x.copy()
    sides.check_crossed(x)
    x[:, 1] -= np.sign(x[:, 1]) * np.minimum(1.05, np.maximum(0.0, 1.0 - x[:, 0]))
    with pytest.raises(llm.ContactError, match=r"goes through itself: [1-9]\d* pair.s. of facets"):
        sides.check_crossed(x)


@pytest.mark.long
def test_on_ranks():
    """The same on two ranks."""
    one = folding.main(["--steps", "3"])
    two = run_mpi_json(TESTS / "mpi" / "folded.py", 2)
    assert two["pairs"] == one["pairs"]
    assert two["force"] == pytest.approx(one["force"], rel=1e-9)
