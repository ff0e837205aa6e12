"""The moving frame's terms against finite differences, and what they must keep."""

import itertools
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from sampling import some_of

from dolfinx_llm.finite.frame.areas import everything, surface_integrals
from dolfinx_llm.finite.frame.design import BORNE_WHOLE, CORRECTED, RAISED, Design
from dolfinx_llm.finite.frame.location import find_on_frame
from dolfinx_llm.finite.frame.self_sides import SelfSides
from dolfinx_llm.finite.frame.sides import Sides
from dolfinx_llm.finite.own_laws.law_contact import LawOnFrame
from dolfinx_llm.finite.pairs.friction_contact import FrictionContact
from dolfinx_llm.finite.pairs.friction_law import in_plane
from dolfinx_llm.finite.pairs.normal_contact import NormalContact
from dolfinx_llm.finite.pairs.terms import Origin
from dolfinx_llm.finite.pressure import Follower
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.laws.law import Law
from dolfinx_llm.laws.rows import CLOSED, OPEN, SLIP, STICK, LawNodes, LawRows

pytestmark = pytest.mark.quick


class Bond(Law):
    """Forces for all components of jumps, which stiffen, and are not the same in all directions."""

    opens, slips, gives = False, True, True

    def force(self, nodes):
        d, q = nodes.jump, nodes.jump.shape[1]
        A, size = 5.0 * np.eye(q) + np.tri(q), (d**2).sum(axis=1)[:, None]
        K = A + 40.0 * (size[:, :, None] * np.eye(q) + 2.0 * d[:, :, None] * d[:, None])
        return nodes.area[:, None] * (d @ A.T + 40.0 * size * d), nodes.area[:, None, None] * K


class Layer(Law):
    """Pressure for an overlap, pull for a gap."""

    components, gives = "normal", True

    def rows(self, nodes):
        d, area = nodes.jump, nodes.area[:, None]
        force, stiffness = area * (5.0 * d + 40.0 * d**3), area * (5.0 + 120.0 * d**2)
        return LawRows.springs(nodes, force, stiffness, holds=np.ones(len(d), dtype=bool))


def line(rng, ends, n, height, up, bend=0.1, order=1):
    """A rough bent line of n facets, whose normals point up or down."""
    n *= order
    s = np.linspace(*ends, n + 1)
    s[1:-1] += rng.uniform(-0.2, 0.2, n - 1) * (ends[1] - ends[0]) / n
    x = np.column_stack([s, height + bend * s * s + 0.01 * rng.standard_normal(n + 1)])
    facets = np.column_stack([np.arange(n), np.arange(1, n + 1)])
    elements = None
    if order == 2:
        facets = np.column_stack([facets[::2, 0], facets[1::2, 1]])
        elements = np.column_stack([facets if up else facets[:, ::-1], np.arange(1, n, 2)])
    facets = facets if up else facets[:, ::-1]
    nodes = np.arange(n + 1)
    return Surface(x, facets, nodes, 0 * nodes, "line", elements=elements)


def sheet(rng, ends, n, height, up, kind, bend=0.1, order=1):
    """A rough bent sheet of n by n quads or twice as many triangles, [ends]² seen from above."""
    n *= order
    s = np.linspace(*ends, n + 1)
    x = np.stack(np.meshgrid(s, s - 0.5, indexing="ij"), axis=2).reshape(-1, 2)
    x += rng.uniform(-0.12, 0.12, x.shape) * (ends[1] - ends[0]) / n
    z = (
        height
        + bend * (x[:, 0] ** 2 + 0.5 * x[:, 0] * x[:, 1])
        + 0.005 * rng.standard_normal(len(x))
    )
    at = np.arange(len(x)).reshape(n + 1, n + 1)
    a, b = slice(0, -1, order), slice(order, None, order)
    quads = np.stack([at[a, a], at[b, a], at[b, b], at[a, b]], axis=2).reshape(-1, 4)
    facets = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]) if kind == "tri" else quads
    facets, elements = facets if up else facets[:, ::-1], None
    if order == 2:
        ends = np.stack([facets, np.roll(facets, -1, axis=1)], axis=2)
        grid = np.stack(np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"), axis=2)
        middle = grid.reshape(-1, 2)[ends].sum(axis=2) // 2
        elements = np.concatenate([facets, at[middle[..., 0], middle[..., 1]]], axis=1)
        if kind == "quad":
            centre = grid.reshape(-1, 2)[facets].sum(axis=1) // 4
            elements = np.column_stack([elements, at[centre[:, 0], centre[:, 1]]])
    nodes = np.arange(len(x))
    return Surface(np.column_stack([x, z]), facets, nodes, 0 * nodes, kind, elements=elements)


FOLDED = "folded"  # a surface that meets itself
BELLOWS = "folded around an axis"
SHEETS = {"folded quads": "quad", "folded triangles": "tri"}  # another one, in two pieces
SCENES = {  # ends of the lower and the upper surface, whose order is changed, kinds of facets
    "inside": ((0.0, 1.0), (0.13, 0.87), False),
    "beyond one end": ((0.0, 1.0), (0.13, 1.2), False),
    "beyond both, swapped": ((0.1, 0.9), (0.0, 1.05), True),
    "quads inside": ((0.0, 1.0), (0.13, 0.87), False, "quad", "quad"),
    "triangles beyond one end": ((0.0, 1.0), (0.13, 1.2), False, "tri", "tri"),
    "triangles on quads beyond both, swapped": ((0.1, 0.9), (0.0, 1.05), True, "quad", "tri"),
    "second order beyond both, swapped": ((0.1, 0.9), (0.0, 1.05), True, 2, 2),
    "second order on first": ((0.0, 1.0), (0.13, 1.1), False, 1, 2),
    "first order on second": ((0.0, 1.0), (0.13, 1.1), False, 2, 1),
    "quads of second order inside": ((0.0, 1.0), (0.13, 0.87), False, "quad", "quad", 2, 2),
    "triangles of second order on quads": ((0.0, 1.0), (0.13, 1.1), True, "quad", "tri", 2, 2),
    "triangles of second order on first": ((0.0, 1.0), (0.13, 1.1), False, "tri", "tri", 1, 2),
    "around an axis beyond one end": ((0.0, 1.0), (0.13, 1.2), False),
    "second order around an axis, swapped": ((0.1, 0.9), (0.0, 1.05), True, 2, 2),
}


def scene(name):
    """Sides, coordinates, and random forces on the nodes of the moving side."""
    rng = np.random.default_rng(7)
    if name in (FOLDED, BELLOWS):  # both lines, joined by a loop, are one surface
        low, high = line(rng, (0.0, 1.0), 5, 0.0, True), line(rng, (0.13, 1.0), 7, 0.005, False)
        x = np.concatenate([low.x, [[1.3, -0.1], [1.5, 0.1], [1.3, 0.3]], high.x[::-1]])
        chain = np.arange(len(x))
        facets = np.column_stack([chain[:-1], chain[1:]])
        surface = Surface(x, facets, chain, 0 * chain, "hairpin")
        if name == BELLOWS:
            surface = surface.with_depth(lambda x: 1.0 + x @ [3.0, 0.5], name)
        sides = SelfSides.of_one(surface)
        return sides, np.tile(x.ravel(), 2), rng.uniform(0.5, 1.5, len(x))
    if name in SHEETS:
        low = sheet(rng, (0.0, 1.0), 3, 0.0, True, SHEETS[name])
        high = sheet(rng, (0.13, 1.2), 4, 5e-3, False, SHEETS[name])
        x, nodes = np.concatenate([low.x, high.x]), np.arange(len(low.x) + len(high.x))
        facets = np.concatenate([low.facets, high.facets + len(low.x)])
        sides = SelfSides.of_one(Surface(x, facets, nodes, 0 * nodes, "sheets"))
        return sides, np.tile(x.ravel(), 2), rng.uniform(0.5, 1.5, len(x))
    below, above, swapped, *kinds = SCENES[name]
    orders = [k for k in kinds if isinstance(k, int)] or [1, 1]
    kinds = [k for k in kinds if isinstance(k, str)]
    (a, b), make = ((3, 4), sheet) if kinds else ((5, 7), line)
    of = [{"order": k} for k in orders]
    for own, kind in zip(of, kinds):
        own["kind"] = kind
    if max(orders) > 1:  # cells, so that the design matters
        of_orders = {(2, 2): (2, 3), (1, 2): (4, 2), (2, 1): (2, 5)}
        a, b = (k + (not kinds) for k in of_orders[tuple(orders)])
    both = make(rng, below, a, 0.0, True, **of[0]), make(rng, above, b, 5e-3, False, **of[1])
    if "axis" in name:  # that is tilted, so that both coordinates count
        both = tuple(s.with_depth(lambda x: 0.2 + x @ [3.0, 0.5], name) for s in both)
    sides = Sides.of(both[::-1] if swapped else both)
    z = np.concatenate([s.x.ravel() for s in sides.surfaces])
    return sides, z, rng.uniform(0.5, 1.5, len(sides.mover.x))


def pressed(name, law=None, mu=0.3):
    """Coordinates of a scene, number of pairs, and its terms where all are pressed.

    Args:
        law: status of all pairs under friction, a law of one's own, or None without.
        mu: coefficient of friction.
    """
    sides, z, force = scene(name)
    frame, moving = sides.carrier, sides.mover
    design, n = Design.of(frame.x, frame.cells), len(moving.x)
    contact = NormalContact(sides, design)
    rng = np.random.default_rng(13)
    if isinstance(law, Law):
        told = LawNodes(moving.x, *(np.ones(n),) * 7)
        contact, law = LawOnFrame.under(law, told, sides, design, z), STICK
    elif law is not None:
        contact = FrictionContact(sides, design, np.full(n, mu), rng.uniform(0.0, 2.0, n))
    q, held = np.zeros(contact.size), contact.hold(z)
    status, free = np.full(n, CLOSED if law is None else law), np.ones(len(z), dtype=bool)
    q[:n] = force
    if law is not None:  # it has gone along from elsewhere, and carries some friction
        start = contact.place(z + 0.02 * rng.standard_normal(len(z)), q, held)
        held = replace(held, origin=Origin(start.N, start.gap, np.ones(n, dtype=bool)), scale=5.0)
        tau, place = 0.2 * rng.standard_normal((n, sides.gdim)), contact.place(z, q, held)
        if law == SLIP:  # where the law holds the derivative is exact
            x, y = sides.split(z)
            way = in_plane(place.normal, sides.control[0] @ x - start.N @ y)
            bound = mu * force + contact.cohesion * place.areas[0]
            tau = way * (bound / np.linalg.norm(way, axis=1))[:, None]
        if law == SLIP or contact.size == n + sum(contact.counts[1:]) + tau.size:
            q[-tau.size :] = tau.ravel()

    def terms(z, q=q):
        place = contact.place(z, q, held)
        return contact.terms(place, q, np.where(place.pairs, status, OPEN), held, free)

    return z, n, q, terms


def differences(function, z, h=5e-7):
    """Three random directions, and central differences of fourth order along them: parts of
    corrections that rows bear change by themselves in lengths of a thousandth."""
    E = np.random.default_rng(3).standard_normal((3, len(z)))
    one, two = (
        [(function(z + k * e) - function(z - k * e)) / (2.0 * k) for e in E] for k in (h, 2.0 * h)
    )
    return E.T, (4.0 * np.array(one).T - np.array(two).T) / 3.0


BY_TURNS = list(itertools.product(SCENES, [None, STICK, SLIP, Bond(), Layer()]))
OF_ONE = list(itertools.product([FOLDED, BELLOWS, *SHEETS], [None, STICK, SLIP, Bond(), Layer()]))


@pytest.mark.parametrize(
    ("name", "law"), some_of(BY_TURNS + OF_ONE, BY_TURNS[:30:6] + BY_TURNS[30::12] + OF_ONE[::8])
)
def test_tangent_is_the_derivative(name, law):
    """Forces and gaps, through places, normals, clipped areas and the design's global equations;
    slip, the law of friction, and laws of one's own."""
    z, n, q, terms = pressed(name, law)
    t = terms(z)
    # mu and kappa, which follow the positions
    d = slice(n, n + len(t.place.areas[1]) + t.place.rows.G.shape[1])
    kept = np.setdiff1d(np.arange(len(q)), np.arange(d.start, d.stop))
    own, left, top = t.own.toarray(), t.left.toarray(), t.top.toarray()
    dq = -np.linalg.solve(own[d, d], left[d])
    whole = np.block([[t.K.toarray() + top[:, d] @ dq, top[:, kept]],
                      [left[kept] + own[kept, d] @ dq, own[np.ix_(kept, kept)]]])  # fmt: skip

    def values(both):
        now = q.copy()
        now[kept] = both[len(z) :]
        t = terms(both[: len(z)], now)
        return np.concatenate([-t.force, t.rest[kept]])

    E, found = differences(values, np.concatenate([z, q[kept]]))
    ends = [0, len(z), len(z) + n, len(whole)]
    for a, b in zip(ends[:-1], ends[1:]):
        change = found[a:b]
        assert np.abs(whole[a:b] @ E - change).max(initial=0.0) <= 1e-8 * np.abs(change).max(
            initial=0.0
        )
    # The design matters here, and what it changes is differentiated.
    rows = t.place.rows
    whole = np.abs(rows.whole - rows.N + rows.delta).max()
    assert whole > (0.01 if "second" in name else 0.03)


@pytest.mark.parametrize("name", some_of(list(SCENES), list(SCENES)[::3]))
def test_slip_of_increments_before_turns_and_stretches(name):
    """What pairs have slipped is carried on as vectors on the frame's facets are: it turns with
    them, and where facets stretch it stretches."""
    sides, z, _ = scene(name)
    frame, gdim = sides.carrier, sides.gdim
    contact = NormalContact(sides, Design.of(frame.x, frame.cells))
    q, held, rng = np.zeros(contact.size), contact.hold(z), np.random.default_rng(5)
    start = contact.place(z, q, held)
    slip = in_plane(start.normal, rng.standard_normal(start.normal.shape))
    slip[~start.pairs] = 0.0
    written = contact.written(start, slip)
    R = np.linalg.qr(rng.standard_normal((gdim, gdim)))[0]
    R[:, 0] *= np.linalg.det(R)
    for size in (1.0, 1.7):
        turned = (size * z.reshape(-1, gdim) @ R.T).ravel()
        there = contact.place(turned, q, contact.hold(turned))
        carried = in_plane(there.normal, contact.read(there, written))
        assert np.abs(carried - size * slip @ R.T).max() < 1e-9


@pytest.mark.parametrize("name", ["beyond one end", "beyond both, swapped"])
def test_what_rows_bear_of_corrections(name):
    """Both sides are balanced by whole rows; a row that this moves too far is corrected as far as
    it bears, and the others are left as they are."""
    sides, z, _ = scene(name)
    y = sides.split(z)[1]
    contact = NormalContact(sides, Design.of(y, sides.carrier.cells))
    held = contact.hold(z)
    place = contact.place(z, np.zeros(contact.size), held)
    rows, allowed, (force, of_frame) = place.rows, RAISED * contact.design.size, place.loads
    left, borne = rows.matrix(len(y), whole=True).T @ force[place.on] - of_frame, rows.G
    left -= borne @ np.linalg.lstsq(borne, left, rcond=None)[0]
    assert np.abs(left).max() < 1e-11 * of_frame.max()
    raised = np.einsum("ns,ns->n", rows.delta, place.height)
    most = np.abs(rows.delta).max(axis=1)
    assert most.max() <= CORRECTED + 1e-12 and np.abs(raised).max() <= allowed * (1 + 1e-9)
    full = np.abs(raised) > BORNE_WHOLE * allowed
    full |= np.abs(most - CORRECTED) < 1e-9
    less = (rows.N != rows.whole).any(axis=1)
    assert 0 < less.sum() < len(less) and (less == full).all()


def test_one_facet_at_a_frame_node():
    """What lies over a frame node but for rounding stays on one of its facets: couples of friction
    act on a facet's own corners, and Newton's iteration went from one to the other for ever."""
    y = np.array([[-1.0, 0.2], [0.0, 0.0], [1.0, 0.2]])
    facets, normals = np.array([[1, 0], [2, 1]]), np.array([[0.2, 1.0], [0.0, 1.0], [-0.2, 1.0]])
    x = np.array([[s, 1e-13 * h] for s in (-3e-10, 0.0, 3e-10) for h in (-1.0, 0.0, 1.0)])
    found = find_on_frame(x, y, facets, normals / np.linalg.norm(normals, axis=1)[:, None])
    assert (found.facet == found.facet[0]).all()


@pytest.mark.parametrize("kind", ["line", "quad", "tri"])
def test_gaps_are_those_of_round_surfaces(kind):
    """Nodes at a distance from a cylinder of radius 2, whose facets of size h lie up to h² / 16
    inside it: a twentieth of that is left of it, and falls faster."""
    even = SimpleNamespace(uniform=lambda a, b, n: np.zeros(n), standard_normal=np.zeros)
    left = []
    for n in (6, 12):
        make = partial(line, even) if kind == "line" else partial(sheet, even, kind=kind)
        low, high = (make((0.0, 1.0), n + up, 0.0, not up, bend=0.0) for up in (0, 1))
        for s, radius in ((low, 2.0), (high, 2.0 + 1e-3)):
            angle, along = (s.x[:, 0] - 0.5) / radius, radius * np.ones(len(s.x))
            s.x[:, 0], s.x[:, -1] = along * np.sin(angle), along * np.cos(angle)
        sides = Sides.of((low, high))
        z = np.concatenate([s.x.ravel() for s in sides.surfaces])
        contact = NormalContact(sides, Design.of(low.x, low.facets, wanted=False))
        place = contact.place(z, np.zeros(contact.size), contact.hold(z))
        inner = place.at.N[place.on].min(axis=1) > -1e-9
        inner &= np.abs(sides.split(z)[0][place.on][:, 0]) < 0.3
        left.append(np.abs(place.gap[place.on][inner] - 1e-3).max())
    assert left[1] < 0.05 / 12**2 / 16 and left[1] < left[0] / 5.0


@pytest.mark.parametrize("law", [None, STICK, SLIP, Bond()])
@pytest.mark.parametrize("name", [*SCENES, FOLDED, *SHEETS])
def test_forces_and_moments_of_both_sides_cancel(name, law):
    """Also where friction acts at some distance from the frame's facets."""
    z, _, _, terms = pressed(name, law)
    t = terms(z)
    gdim = t.place.normal.shape[1]
    x, f = (np.pad(a.reshape(-1, gdim), ((0, 0), (0, 3 - gdim))) for a in (z, t.force))
    assert np.abs(f.sum(axis=0)).max() < 1e-13 * np.abs(f).sum()
    assert np.abs(np.cross(x, f).sum(axis=0)).max() < 1e-13 * np.abs(f).sum()


@pytest.mark.parametrize("name", SCENES)
def test_free_pressure_follows(name):
    """Its derivative; on what one surface leaves free and on all of it; where some nodes are apart
    what is free is more by the facets that have them."""
    sides, z, _ = scene(name)
    for order in ((0, 1), (1, 0)):
        surfaces = [sides.surfaces[i] for i in order]
        z = np.concatenate([s.x.ravel() for s in surfaces])
        follower = Follower(surfaces, Sides.of(surfaces))
        closed = np.ones(len(follower.sides.mover.x), dtype=bool)
        every = follower.hold(z, closed)
        closed[follower.sides.mover.cells[np.flatnonzero(every.facets)[0]]] = False
        some = follower.hold(z, closed)
        assert some.facets.sum() < every.facets.sum()
        assert not closed[follower.sides.mover.cells[every.facets & ~some.facets]].all(axis=1).any()
        for held in (every, some):
            force = partial(follower.terms, p=3.0, held=held)
            E, found = differences(lambda z, force=force: -force(z)[0], z)
            assert np.abs(force(z)[1] @ E - found).max() < 1e-9 * 3.0


def test_free_and_covered_parts_are_all():
    """What a punch inside of a flat surface leaves free, in the limit of any mesh."""
    rng = np.random.default_rng(11)
    low = line(rng, (0.0, 1.0), 4, 0.0, True, 0.0)
    high = line(rng, (0.23, 0.71), 5, 0.0, False, 0.0)
    low.x[:, 1] = high.x[:, 1] = 0.0
    z = np.concatenate([low.x.ravel(), high.x.ravel()])
    for surfaces, length in (((low, high), 1.0 - 0.48), ((high, low), 0.0)):
        z = np.concatenate([s.x.ravel() for s in surfaces])
        follower = Follower(surfaces, Sides.of(surfaces))
        held = follower.hold(z, np.ones(len(follower.sides.mover.x), dtype=bool))
        force = follower.terms(z, 1.0, held)[0]
        assert abs(np.abs(force).sum() - length) < 1e-14
    whole = surface_integrals(low.x, low, everything(low.x, low, 0, low.x.size), 0)[0]
    assert np.allclose(whole.sum(axis=0), [0.0, 1.0], rtol=0, atol=1e-14)


def test_places_on_long_facets():
    """A frame of strips, 40 times as long as wide: their centres tell little of what is near."""
    s, t = np.meshgrid(np.linspace(0.0, 2.0, 3), np.linspace(0.0, 1.0, 41), indexing="ij")
    y = np.column_stack([s.ravel(), t.ravel(), 0.0 * s.ravel()])
    at = np.arange(len(y)).reshape(3, 41)
    facets = np.stack([at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]], axis=2).reshape(-1, 4)
    x = np.random.default_rng(9).uniform([0.0, 0.0, -0.01], [2.0, 1.0, 0.01], (200, 3))
    for cells in (facets, np.concatenate([facets[:, :3], facets[:, [0, 2, 3]]])):
        found = find_on_frame(x, y, cells, np.tile([0.0, 0.0, 1.0], (len(y), 1)))
        place = np.einsum("nk,nki->ni", found.N, y[cells[found.facet]])
        assert found.met.all() and found.N.min() > -1e-9
        assert np.abs(place[:, :2] - x[:, :2]).max() < 1e-12
        assert np.abs(found.gap - x[:, 2]).max() < 1e-12


def test_pressure_around_a_body():
    """It has neither a resultant nor a moment, whatever the warp of the facets."""
    rng = np.random.default_rng(5)
    x = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=float)
    x += rng.uniform(-0.2, 0.2, x.shape)
    facets = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    box = Surface(x, np.array(facets), np.arange(8), np.zeros(8, dtype=int), "box")
    follower = Follower([box], None)
    force = follower.terms(x.ravel(), 1.0, None)[0].reshape(-1, 3)
    assert np.abs(force).max() > 0.2
    assert (
        max(np.abs(force.sum(axis=0)).max(), np.abs(np.cross(x, force).sum(axis=0)).max()) < 1e-15
    )


def closed(kind):
    """A body whose second-order facets bend: a square, or a cube of 6 quads, of 12 triangles."""
    rng = np.random.default_rng(6)
    if kind == "square":
        x = np.array([[0, 0], [0, 1], [0, 2], [1, 2], [2, 2], [2, 1], [2, 0], [1, 0]], dtype=float)
        cells, c = np.array([[0, 2, 1], [2, 4, 3], [4, 6, 5], [6, 0, 7]]), 2
    else:
        x = np.stack(np.meshgrid(*3 * [np.arange(3.0)], indexing="ij"), axis=3).reshape(-1, 3)
        at, c = np.arange(27).reshape(3, 3, 3), 4 if kind == "quads" else 3
        faces = [np.take(at, i, axis) for axis in range(3) for i in (0, 2)]
        faces = [face.T if i in (0, 3, 4) else face for i, face in enumerate(faces)]
        places = [[0, 6, 8, 2, 3, 7, 5, 1, 4]]
        if c == 3:
            places = [[0, 6, 8, 3, 7, 4], [0, 8, 2, 4, 5, 1]]
        cells = np.array([face.ravel()[place] for face in faces for place in places])
    x += rng.uniform(-0.2, 0.2, x.shape)
    nodes = np.arange(len(x))
    return Surface(x, cells[:, :c], nodes, 0 * nodes, kind, elements=cells)


def volume(surface, x):
    """Of the body inside; Gauss points on the facets as they bend."""
    d, cells, element = x.shape[1], surface.cells, surface.element
    s, w = (a / 2.0 for a in np.polynomial.legendre.leggauss(6))
    if element.corners == 3:  # from the square
        s, t = (a.ravel() for a in np.meshgrid(s + 0.5, s + 0.5, indexing="ij"))
        xi, w = np.column_stack([s, t * (1.0 - s)]), np.outer(w, w).ravel() * (1.0 - s)
    elif d == 3:
        xi = 2.0 * np.stack(np.meshgrid(s, s, indexing="ij"), axis=2).reshape(-1, 2)
        w = 4.0 * np.outer(w, w).ravel()
    else:
        xi = s[:, None] + 0.5
    N, dN = element.shape(xi)
    y, t = np.einsum("gk,fki->fgi", N, x[cells]), np.einsum("gkd,fki->dfgi", dN, x[cells])
    n = np.cross(*t) if d == 3 else t[0] @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    return np.einsum("g,fgi,fgi->", w, y, n) / d


@pytest.mark.parametrize("kind", ["square", "quads", "triangles"])
def test_pressure_on_bent_facets(kind):
    """Around a body it works on its volume, whatever way the nodes go, and has neither a resultant
    nor a moment; with its derivative, which is symmetric then."""
    body = closed(kind)
    z, d = body.x.ravel(), body.x.shape[1]
    force = partial(Follower([body], None).terms, p=1.0, held=None)
    f, K = force(z)
    E, found = differences(lambda z: -force(z)[0], z)
    assert np.abs(K @ E - found).max() < 1e-8
    assert abs(K - K.T).max() < 1e-14
    assert volume(body, body.x) > 2.0
    work = differences(lambda z: np.atleast_1d(volume(body, z.reshape(-1, d))), z)[1]
    assert np.abs(f @ E + work).max() < 1e-7
    x, f = (np.pad(a.reshape(-1, d), ((0, 0), (0, 3 - d))) for a in (z, f))
    assert np.abs(f).max() > 0.2
    assert max(np.abs(f.sum(axis=0)).max(), np.abs(np.cross(x, f).sum(axis=0)).max()) < 1e-14


def test_on_an_edge():
    """A node that lies on the edge of two facets but for what Newton's iteration leaves is on the
    same one."""
    y = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.3]])
    facets, normals = np.array([[0, 1], [1, 2]]), np.tile([0.0, 1.0], (3, 1))
    x = np.array([[1.0 + by, 0.1] for by in (-1e-3, -1e-7, 0.0, 1e-7, 1e-3)])
    assert find_on_frame(x, y, facets, normals).facet.tolist() == [0, 0, 0, 0, 1]
