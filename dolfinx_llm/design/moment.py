"""The moment of the forces on a straight contact line, whose zeros are nodes of frames that pass.

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

from dataclasses import dataclass

import numpy as np

_EPS = np.finfo(float).eps
NEAR = 1e-6  # of the shortest facet: positions closer than this count as one for the choice


@dataclass(frozen=True, eq=False)
class MomentRoots:
    """Zeros of the moment of two force systems on a line; they mark no side."""

    points: np.ndarray  # (k,) ascending; the ends, isolated zeros, nodes in intervals [length]
    intervals: np.ndarray  # (i, 2) where M vanishes throughout: parts that match [length]


def facet_moment(s: np.ndarray, x: np.ndarray, area: np.ndarray) -> np.ndarray:
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


def moment_roots(
    x0: np.ndarray, x1: np.ndarray, area: np.ndarray, size: float | None = None
) -> MomentRoots:
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


def _facet_length(s: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Length of the facet of x at each s."""
    return np.diff(x)[np.clip(np.searchsorted(x, s, side="right") - 1, 0, len(x) - 2)]


def close_by(x0: np.ndarray, x1: np.ndarray) -> float:
    """Distance up to which positions count as one [length]."""
    return NEAR * min(np.diff(x0).min(), np.diff(x1).min())


def distinct(points: np.ndarray, near: float) -> np.ndarray:
    """One point of each cluster; of the outer clusters the ends."""
    keep = np.concatenate([[True], np.diff(points) > near])
    keep[:-1] &= points[-1] - points[:-1] > near
    keep[0] = keep[-1] = True
    return points[keep]
