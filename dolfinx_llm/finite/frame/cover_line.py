"""What two surfaces in the plane cover of each other, exact on clipped facets, with derivatives.

A facet of the moving side covers the frame between the places of its nodes. It is covered itself
but for what lies beyond the frame's ends, whose normals cut it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import per_item, summing
from dolfinx_llm.finite.frame.bernstein import integrals, values
from dolfinx_llm.finite.frame.covered import Covered
from dolfinx_llm.finite.frame.jacobians import NodalNormals, coordinates, jacobian
from dolfinx_llm.finite.frame.location import LocationDerivatives, OnFrame
from dolfinx_llm.geometry.cells import cross_plane

JUST_BESIDE = 1e-6  # of a facet: how far beside it a place counts as it is
AMID = 1.0  # facets beyond one amid a chain, from where on a node is on none


@dataclass(frozen=True, eq=False)
class Chains:
    """Facets of polylines in their order: the second node of one is the first of the next."""

    facets: Array  # (f, 2)
    order: Array  # (f,) facets, chain by chain
    place: Array  # (f,) where each stands there
    chain: Array  # (f,) its chain
    length: Array  # (f,) facets of its chain
    closed: Array  # (f,) whether that is closed
    start: Array  # (f,) first place of its chain
    ends: Array  # (f, 2) first and last node of its chain

    @classmethod
    def of(cls, facets: Array) -> Chains:
        """Chains of facets (f, 2), which are oriented alike."""
        f = len(facets)
        begins = {int(a): i for i, a in enumerate(facets[:, 0])}
        follows = np.array([begins.get(int(b), -1) for b in facets[:, 1]])
        first = np.setdiff1d(np.arange(f), follows)
        seen, chains, closed = np.zeros(f, dtype=bool), [], []
        for at, ring in [*((i, False) for i in first), *((i, True) for i in range(f))]:
            members = []
            while at >= 0 and not seen[at]:
                seen[at] = True
                members.append(at)
                at = follows[at]
            if members:
                chains.append(np.array(members))
                closed.append(ring)
        order, count = np.concatenate(chains), np.array([len(c) for c in chains])
        place, chain = np.empty(f, dtype=np.int64), np.empty(f, dtype=np.int64)
        place[order], chain[order] = np.arange(f), np.repeat(np.arange(len(chains)), count)
        ends = np.array([(facets[c[0], 0], facets[c[-1], 1]) for c in chains])
        start = (np.cumsum(count) - count)[chain]
        closes = np.array(closed)[chain]
        return cls(facets, order, place, chain, count[chain], closes, start, ends[chain])

    def beyond(self, at: OnFrame) -> tuple[Array, Array]:
        """(n,) which nodes lie beyond the last, and the first node of their chain."""
        place, is_end = self.place[at.facet] - self.start[at.facet], ~self.closed[at.facet]
        low = is_end & (place == 0) & (at.xi[:, 0] < 0.0)
        return is_end & (place == self.length[at.facet] - 1) & (at.xi[:, 0] > 1.0), low


def covered_lines(
    chains: Chains,
    moving: Array,
    candidates: Array,
    x: Array,
    y: Array,
    at: OnFrame,
    d: LocationDerivatives,
    normals: NodalNormals,
    columns: tuple[int, int],
    degrees: tuple[int, int],
) -> tuple[tuple[Covered, Covered], tuple[Array, csr_matrix]]:
    """What the moving side's facets cover of the frame, and what of them is covered.

    Args:
        chains: of the frame.
        moving: (f, 2) facets of the moving side, which are straight between their corners.
        candidates: (f,) which of them can touch.
        x, y: nodes of the moving side and of the frame [length].
        at, d: where all nodes of the moving side lie on the frame, with derivatives.
        normals: of the frame's nodes.
        columns: number of the first coordinate of the moving side and of the frame.
        degrees: of Bernstein's functions that are integrated, on both.

    Returns:
        Covered parts of the moving side's facets, and of the frame's; (f,) lengths of the frame
        that each of the moving side's facets covers, and (f, width) derivatives.
    """
    width = d.xi.shape[1]
    place, first = chains.place[at.facet], chains.chain[at.facet]
    start = chains.start[at.facet]
    high, low = chains.beyond(at)
    a, b = moving.T  # the sides run against each other: a lies at the far end
    good = candidates & at.met[a] & at.met[b] & (first[a] == first[b])
    good &= ~(high[a] & high[b]) & ~(low[a] & low[b])
    astray = (at.beyond > AMID) & ~(high | low)  # the frame bends away from it
    good &= ~(astray[a] | astray[b])
    steps = place[a] - place[b]
    ring = chains.closed[at.facet[a]]
    steps = np.where(ring & (steps < 0), steps + chains.length[at.facet[a]], steps)
    good &= (steps >= 0) & ~(ring & (2 * steps > chains.length[at.facet[a]] + 1))
    facets = np.flatnonzero(good)
    of = facets, moving, x, y, at, high, low, chains, normals, columns, width
    spans = Spans.of(chains, moving[facets], steps[facets], start, at, high | low)
    lengths, by_z = _lengths(chains, spans, at, d, y, columns[1])
    pick = summing(facets, len(moving))
    covered = _of_moving(degrees[0], *of), _of_frame(degrees[1], chains, spans, at, d)
    return covered, (pick @ lengths, pick @ by_z)


@dataclass(frozen=True, eq=False)
class Spans:
    """What k facets of the moving side cover of the frame, from a near to a far end."""

    far: Array  # (k,) nodes of the moving side at these ends
    near: Array  # (k,)
    xi: Array  # (n,) places of all nodes in their facets, of those beyond a chain's end at it
    beyond: Array  # (n,) nodes beyond it
    which: Array  # (q,) span of each facet that counts in full
    full: Array  # (q,) these: those before the far end's, from that of the near end on

    @classmethod
    def of(
        cls, chains: Chains, moving: Array, steps: Array, start: Array, at: OnFrame, beyond: Array
    ) -> Spans:
        """Of facets (k, 2); what is common to neighbours cancels.

        Args:
            chains: of the frame.
            moving: (k, 2) facets, a node at the far end, one at the near end.
            steps: (k,) facets from one to the other.
            start: (n,) first place of the chain below each node.
            at: where all nodes lie.
            beyond: (n,) nodes beyond a chain's end.
        """
        far, near = moving.T
        # A node over a frame node may lie beside its facet by rounding: that still changes.
        beside = np.where(beyond, 0.0, JUST_BESIDE)
        xi = np.clip(at.xi[:, 0], -beside, 1.0 + beside)
        which = np.repeat(np.arange(len(steps)), steps)
        ahead = np.arange(len(which)) - np.repeat(np.cumsum(steps) - steps, steps)
        base, length = start[near][which], chains.length[at.facet[near]][which]
        place = chains.place[at.facet[near]][which]
        full = chains.order[base + (place - base + ahead) % length]
        return cls(far, near, xi, beyond, which, full)


def _of_frame(
    degree: int, chains: Chains, of: Spans, at: OnFrame, d: LocationDerivatives
) -> Covered:
    """Sums over the spans."""
    f, n, k = len(chains.order), len(at.facet), degree + 1
    both = np.concatenate([of.far, of.near])
    share = np.zeros((f, k))
    np.add.at(share, at.facet[of.far], integrals(degree, of.xi[of.far]))
    np.add.at(share, at.facet[of.near], -integrals(degree, of.xi[of.near]))
    np.add.at(share, of.full, 1.0 / k)
    by_xi = values(degree, of.xi) * ~of.beyond[:, None]
    rows = coordinates(at.facet[both][:, None], k).ravel()
    entries = np.concatenate([by_xi[of.far], -by_xi[of.near]]).ravel()
    return Covered(share, csr_matrix((entries, (rows, np.repeat(both, k))), (k * f, n)) @ d.xi)


def _lengths(
    chains: Chains, of: Spans, at: OnFrame, d: LocationDerivatives, y: Array, first: int
) -> tuple[Array, csr_matrix]:
    """(k,) lengths of the spans, and (k, width) derivatives."""
    k, frame, both = len(of.far), chains.facets, np.concatenate([of.far, of.near])
    side = y[frame[:, 1]] - y[frame[:, 0]]
    size = np.linalg.norm(side, axis=1)
    along = side / size[:, None]
    stretched = np.hstack([-along, along])[:, None]
    by_y = jacobian(stretched, coordinates(frame, 2, first), d.xi.shape[1])
    item = np.tile(np.arange(k), 2)
    parts = np.concatenate([of.xi[of.far], -of.xi[of.near], np.ones(len(of.full))])
    places = np.concatenate([item, of.which]), np.concatenate([at.facet[both], of.full])
    of_facets = csr_matrix((parts, places), (k, len(frame)))
    slope = size[at.facet] * ~of.beyond
    slopes = np.concatenate([slope[of.far], -slope[of.near]])
    ends = csr_matrix((slopes, (item, both)), (k, len(of.xi)))
    return of_facets @ size, of_facets @ by_y + ends @ d.xi


def _of_moving(
    degree: int,
    facets: Array,
    moving: Array,
    x: Array,
    y: Array,
    at: OnFrame,
    high: Array,
    low: Array,
    chains: Chains,
    normals: NodalNormals,
    columns: tuple[int, int],
    width: int,
) -> Covered:
    """Facets between their nodes, or the frame's ends where a node lies beyond."""
    k = degree + 1
    share = np.zeros((len(moving), k))
    share[facets] = 1.0 / k
    derivative = csr_matrix((k * len(moving), width))
    for local, sign in ((0, -1.0), (1, 1.0)):  # the part before, and the part after an end
        node = moving[facets, local]
        cut = facets[high[node] | low[node]]
        node = moving[cut, local]
        end = chains.ends[at.facet[node], np.where(high[node], 1, 0)]
        eta, changed = cut_by_end(x, moving[cut], y, end, normals, columns, width)
        share[cut] += sign * (integrals(degree, eta) - (0.0 if local == 0 else 1.0 / k))
        by_eta = sign * values(degree, eta)[:, :, None]
        spread = summing(coordinates(cut[:, None], k).ravel(), k * len(moving))
        derivative = derivative + spread @ (per_item(by_eta) @ changed)
    return Covered(share, derivative)


def cut_by_end(
    x: Array,
    facets: Array,
    y: Array,
    end: Array,
    normals: NodalNormals,
    columns: tuple[int, int],
    width: int,
) -> tuple[Array, csr_matrix]:
    """(k,) where in facets (k, 2) of the moving side normals of the frame's nodes ``end`` (k,) cut
    them, in [0, 1], and (k, width) the derivative; other arguments as of ``covered_lines``."""
    eta, blocks, by_normal = _cut(x[facets], y[end], normals.n[end])
    places = coordinates(facets, 2, columns[0]), coordinates(end[:, None], 2, columns[1])
    turn = jacobian(by_normal[:, None], coordinates(end[:, None], 2), y.size)
    by_places = jacobian(blocks[:, None], np.concatenate(places, axis=1), width)
    return eta, by_places + turn @ normals.derivative


def _cut(x: Array, y: Array, n: Array) -> tuple[Array, Array, Array]:
    """Where the line from y (k, 2) along n cuts facets x (k, 2, 2): (k,) in [0, 1], and its
    derivatives by (x_0, x_1, y) (k, 6) and by n (k, 2).

    (y - x_0) x n = eta (x_1 - x_0) x n.
    """
    side, q = x[:, 1] - x[:, 0], y - x[:, 0]
    down = cross_plane(side, n)
    eta = cross_plane(q, n) / down
    inside = ((eta >= 0.0) & (eta <= 1.0)).astype(float)
    eta = np.clip(eta, 0.0, 1.0)
    by_q = inside[:, None] * np.column_stack([n[:, 1], -n[:, 0]]) / down[:, None]
    rest = q - eta[:, None] * side
    by_n = inside[:, None] * np.column_stack([-rest[:, 1], rest[:, 0]]) / down[:, None]
    return eta, np.hstack([(eta - 1.0)[:, None] * by_q, -eta[:, None] * by_q, by_q]), by_n
