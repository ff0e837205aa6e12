"""Convex polygons cut with each other, many pairs at once; each edge knows whose it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_llm.geometry.cells import cross_plane

OWN = -1  # mark of an edge of the polygon that is cut
ON = 1e-12  # distance from a line over the polygon's size that is none


@dataclass(frozen=True, eq=False)
class Clipped:
    """n polygons of up to v corners in a plane, counterclockwise."""

    x: np.ndarray  # (n, v, 2); unused places repeat nothing of meaning [length]
    mark: np.ndarray  # (n, v) of the edge after each corner: OWN, or the number of the cutting one
    count: np.ndarray  # (n,) corners

    @property
    def used(self) -> np.ndarray:
        """(n, v) places that hold corners."""
        return np.arange(self.x.shape[1]) < self.count[:, None]

    @property
    def following(self) -> np.ndarray:
        """(n, v) place of the next corner."""
        place = np.arange(1, self.x.shape[1] + 1)
        return np.where(place < self.count[:, None], place, 0)

    @property
    def ends(self) -> np.ndarray:
        """(n, v, 2) where the edge after each corner ends [length]."""
        return np.take_along_axis(self.x, self.following[:, :, None], axis=1)

    @property
    def area(self) -> np.ndarray:
        """(n,)."""
        return 0.5 * np.where(self.used, cross_plane(self.x, self.ends), 0.0).sum(axis=1)


def cut(p: np.ndarray, by: np.ndarray) -> Clipped:
    """What of polygons p (n, k, 2) lies in convex ones (n, m, 2), all counterclockwise.

    Edges on a line of the cutting polygon count as inside, and stay the polygon's own.
    """
    (n, k, _), m = p.shape, by.shape[1]
    x = np.concatenate([p, np.zeros((n, 2 * m, 2))], axis=1)
    found = Clipped(x, np.full(x.shape[:2], OWN), np.full(n, k))
    tolerance = ON * np.abs(p).max(axis=(1, 2), initial=0.0)[:, None]
    for c in range(m):
        found = _behind(found, by[:, c], by[:, (c + 1) % m], c, tolerance)
    return found


def _behind(p: Clipped, a: np.ndarray, b: np.ndarray, c: int, tolerance: np.ndarray) -> Clipped:
    """What lies to the left of the lines from a to b (n, 2), whose edges get the mark c."""
    side = (b - a) / np.maximum(np.linalg.norm(b - a, axis=1), 1e-300)[:, None]
    arm = p.x - a[:, None]
    d = side[:, None, 0] * arm[..., 1] - side[:, None, 1] * arm[..., 0]
    ahead = np.take_along_axis(d, p.following, axis=1)
    inside, then, used = d >= -tolerance, ahead >= -tolerance, p.used
    crosses = used & (inside != then)
    t = np.clip(d / np.where(crosses, d - ahead, 1.0), 0.0, 1.0)
    crossing = p.x + t[:, :, None] * (p.ends - p.x)
    n, v = d.shape
    keep = np.stack([used & inside, crosses], axis=2).reshape(n, 2 * v)
    x = np.stack([p.x, crossing], axis=2).reshape(n, 2 * v, 2)
    mark = np.stack([p.mark, np.where(inside, c, p.mark)], axis=2).reshape(n, 2 * v)
    order = np.argsort(~keep, axis=1, kind="stable")[:, :v]
    return Clipped(
        np.take_along_axis(x, order[:, :, None], axis=1),
        np.take_along_axis(mark, order, axis=1),
        keep.sum(axis=1),
    )
