"""The moment of the forces on a straight contact line: its zeros, which of them become the nodes of
a frame that passes, and where given nodes go.

The residual (28) of a frame on a line is the second divided difference, at the frame's nodes, of

    M(s) = sum_p f_p <s - x_p> - sum_q f_q <s - x_q>,    <t> = max(t, 0),

the moment about s of the forces that both sides carry left of s under unit pressure. M is piecewise
linear and vanishes beyond the outermost forces, so any subset of its zeros that contains both ends
passes the patch test. M is never summed up: the forces of a facet and the pressure on it have the
same resultant and centroid, so each side's share is known facet by facet,

    M(s) = e_1(s) - e_0(s),    e = (s - x_k) (s - x_{k+1}) / 2 on a facet that is wholly in contact.

On such facets the zero is s* = (x_k x_{k+1} - X_j X_{j+1}) / (x_k + x_{k+1} - X_j - X_{j+1}).
Positions are coordinates along the line. Plain NumPy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError

_WINDOW = 8  # roots looked back; between every fourth root both sides have a node
_FREE, _USED, _END = 0, 1, 2  # since the last shared root or the start: see ``_least_costs``
_EPS = np.finfo(float).eps
NEAR = 1e-6  # of the shortest facet: positions closer than this count as one for the choice


@dataclass(frozen=True, eq=False)
class MomentRoots:
    """Zeros of the moment of two force systems on a line; they mark no side."""

    points: Array  # (k,) ascending; the ends, isolated zeros, nodes in intervals [length]
    intervals: Array  # (i, 2) where M vanishes throughout: parts that match [length]


def facet_moment(s: Array, x: Array, area: Array) -> Array:
    """Moment about s of the unit pressure left of s, less that of its energy-equivalent forces.

    Never positive; zero at the side's nodes where their facets are wholly in contact, and beyond
    its ends.

    Args:
        s: (n,) positions [length].
        x: (m,) ascending nodes of one side, whose facets lie between neighbours [length].
        area: (2,) interval in contact; it touches every facet [length].

    Returns:
        (n,) e(s) [length^2].
    """
    k = np.clip(np.searchsorted(x, s, side="right") - 1, 0, len(x) - 2)
    left, right = x[k], x[k + 1]
    a, b = np.clip(area[0], left, right), np.clip(area[1], left, right)
    force = (b - a) * ((right - a) + (right - b)) / (2.0 * (right - left))
    ramp_a, ramp_b = np.maximum(s - a, 0.0), np.maximum(s - b, 0.0)
    # <s - a>^2 - <s - b>^2 without the difference of squares
    part = 0.5 * (ramp_a - ramp_b) * (ramp_a + ramp_b) - force * (s - left)
    e = np.where((a == left) & (b == right), 0.5 * (s - left) * (s - right), part)
    return np.where((s <= x[0]) | (s >= x[-1]), 0.0, np.minimum(e, 0.0))


def moment_roots(x0: Array, x1: Array, area: Array, size: float | None = None) -> MomentRoots:
    """All zeros of M between the outermost forces. The order of the sides does not matter.

    Args:
        x0, x1: (n_i,) ascending nodes of each side that carry force [length].
        area: (2,) interval in contact [length].
        size: largest coordinate, which sets the rounding of the positions; by default of x0, x1.
    """
    size = size or max(np.abs(x0).max(), np.abs(x1).max())
    s = np.union1d(x0, x1)
    M = facet_moment(s, x1, area) - facet_moment(s, x0, area)
    longest = np.maximum(*(_facet_length(s, x) for x in (x0, x1)))
    zero = np.abs(M) <= 4.0 * _EPS * size * longest
    zero[[0, -1]] = True
    change = np.flatnonzero(~zero[:-1] & ~zero[1:] & (M[:-1] * M[1:] < 0.0))
    m0, m1 = np.abs(M[change]), np.abs(M[change + 1])
    crossing = s[change] + (s[change + 1] - s[change]) * (m0 / (m0 + m1))
    flat = np.concatenate([[False], zero[:-1] & zero[1:], [False]])
    first, last = np.flatnonzero(~flat[:-1] & flat[1:]), np.flatnonzero(flat[:-1] & ~flat[1:])
    points = np.sort(np.concatenate([s[zero], crossing]))
    return MomentRoots(distinct(points, close_by(x0, x1)), np.column_stack([s[first], s[last]]))


def _facet_length(s: Array, x: Array) -> Array:
    """Length of the facet of x at each s."""
    return np.diff(x)[np.clip(np.searchsorted(x, s, side="right") - 1, 0, len(x) - 2)]


def close_by(x0: Array, x1: Array) -> float:
    """Distance up to which positions count as one [length]."""
    return NEAR * min(np.diff(x0).min(), np.diff(x1).min())


def distinct(points: Array, near: float) -> Array:
    """One point of each cluster; of the outer clusters the ends."""
    keep = np.concatenate([[True], np.diff(points) > near])
    keep[:-1] &= points[-1] - points[:-1] > near
    keep[0] = keep[-1] = True
    return points[keep]


def choose_nodes(roots: MomentRoots, x0: Array, x1: Array) -> Array:
    """Subset of the roots about as dense as the locally coarser side, and evenly spaced.

    It contains both ends. Between two chosen nodes lies a node of each side. Where both sides have
    a node at a root, that one holds the root by itself, so up to the next such root one cell at its
    border may do without. Then L_b has full column rank (Schoenberg and Whitney, 1953). Of these
    subsets the one with the least sum of squared cell lengths, by dynamic programming.

    Args:
        roots: zeros of the moment.
        x0, x1: (n_i,) ascending nodes of each side that carry force [length].

    Returns:
        (m,) ascending node positions, m >= 2 [length].
    """
    Y = roots.points
    sense = _sense(Y, x0, x1)
    if sense < 0:  # equally good choices: the same one whichever way the line runs
        Y, x0, x1 = (-a[::-1] for a in (Y, x0, x1))
    near = close_by(x0, x1)
    low = [np.searchsorted(x, Y - near) for x in (x0, x1)]  # nodes before each root,
    high = [np.searchsorted(x, Y + near, side="right") for x in (x0, x1)]  # and not after it
    shared = (high[0] > low[0]) & (high[1] > low[1])

    def held(i: int, j: int) -> bool:
        inside = all(a[j] > b[i] for a, b in zip(low, high, strict=True))
        return bool(inside or (shared[i] and shared[j]))

    cost, back = _least_costs(Y, shared, held)
    chosen = _symmetric_choice(Y, shared, held, cost, back) if sense == 0 else None
    if chosen is None:
        at = len(Y) - 1
        state = int(cost[at].argmin())
        chosen = _path(back, at, state) if np.isfinite(cost[at, state]) else [0, at]
    return -Y[chosen][::-1] if sense < 0 else Y[chosen]


def _least_costs(Y: Array, shared: Array, held: Callable[[int, int], bool]) -> tuple[Array, Array]:
    """Least sum of squared cell lengths (k, 3) up to each root, and the root and state before.

    The states: a cell may yet do without a node of each side; one has; none may, since neither a
    shared root nor a shared end has come. Costs that differ by rounding are the same.
    """
    cost, back = np.full((len(Y), 3), np.inf), np.zeros((len(Y), 3), dtype=np.int64)
    cost[0, _FREE if shared[0] else _END] = 0.0
    same = 1e-9 * ((Y[-1] - Y[0]) / len(Y)) ** 2
    for j in range(1, len(Y)):
        for i in range(max(0, j - _WINDOW), j):
            full = held(i, j)
            if not (full or shared[i] or shared[j]):
                continue
            h = (Y[j] - Y[i]) ** 2
            for state in (_FREE, _USED, _END) if full else (_FREE,):
                new = _FREE if shared[j] else (state if full else _USED)
                if cost[i, state] + h < cost[j, new] - same:
                    cost[j, new], back[j, new] = cost[i, state] + h, 3 * i + state
    return cost, back


def _path(back: Array, at: int, state: int) -> list[int]:
    """Roots of the best choice that ends in a root, ascending."""
    chosen = [at]
    while at > 0:
        at, state = divmod(int(back[at, state]), 3)
        chosen.append(at)
    return chosen[::-1]


def _symmetric_choice(
    Y: Array,
    shared: Array,
    held: Callable[[int, int], bool],
    cost: Array,
    back: Array,
) -> list[int] | None:
    """The best choice that is its own mirror image, for roots that are; None: there is none, or
    only a much coarser one. In its middle lies a root, or a cell from root i to its image."""
    last, best, ends = len(Y) - 1, np.inf, None
    for i in range(max(0, (last - _WINDOW) // 2), last // 2 + 1):
        centre = 2 * i == last
        full = centre or held(i, last - i)
        for state in (_FREE, _USED, _END):
            fits = state != _USED or (centre and bool(shared[i]))
            fits &= full or state == _FREE
            whole = 2.0 * cost[i, state] + (Y[last - i] - Y[i]) ** 2
            if fits and whole < best:
                best, ends = whole, (i, state)
    if ends is None or not best <= 2.0 * min(cost[last].min(), 1e300):
        return None
    half = _path(back, *ends)
    return half + [last - i for i in half[::-1] if 2 * i != last]


def _sense(Y: Array, x0: Array, x1: Array) -> int:
    """Which way a line runs as seen from its own nodes: 1, -1, or 0 where it is symmetric."""
    near, middle = close_by(x0, x1), Y[0] + Y[-1]

    def first(a: Array, b: Array) -> int:
        """Sign of the first place in which a differs from the image of b."""
        if len(a) != len(b):
            return int(np.sign(len(a) - len(b)))
        off = a + b[::-1] - middle
        off = off[np.abs(off) > near]
        return int(np.sign(off[0])) if len(off) else 0

    # What does not depend on the order of the sides.
    for points in (np.sort(np.concatenate([x0, x1])), Y):
        if first(points, points):
            return first(points, points)
    alike = not (first(x0, x0) or first(x1, x1)) or not (first(x0, x1) or first(x1, x0))
    return 0 if alike else 1


def nearest_nodes(given: Array, roots: MomentRoots) -> Array:
    """Move frame nodes to roots, in their order, by the least sum of squared distances.

    Args:
        given: (m,) ascending positions; the outermost go to the ends [length].
        roots: zeros of the moment.

    Raises:
        ContactError: fewer roots than nodes.
    """
    inside = [np.clip(given, a, b) for a, b in roots.intervals]
    near = NEAR * np.diff(roots.points).min()
    points = distinct(np.sort(np.concatenate([roots.points, *inside])), near)
    m, k = len(given), len(points)
    if m > k or m < 2:
        raise ContactError(
            f"the frame has {m} nodes; in closed form it needs 2 to {k}, as many as the moment of "
            'the two force systems has zeros. Give a coarser frame, design="weights" or frame=None'
        )
    distance = (given[:, None] - points) ** 2
    distance[0, 1:] = distance[-1, :-1] = np.inf
    best, choice = distance[0], np.zeros((m, k), dtype=np.int64)
    for j in range(1, m):
        least = np.minimum.accumulate(best)[:-1]
        new = np.concatenate([[True], best[1:-1] < least[:-1]])
        choice[j, 1:] = np.maximum.accumulate(np.where(new, np.arange(k - 1), 0))
        best = distance[j] + np.concatenate([[np.inf], least])
    at = [k - 1]
    for j in range(m - 1, 0, -1):
        at.append(choice[j, at[-1]])
    return points[at[::-1]]
