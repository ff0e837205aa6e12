"""The pieces of two surfaces that can touch, each with its plane where a single one does.

Surfaces that do not follow each other touch in a small part of what faces, about the place where
they are nearest: the plane there does. Where both turn together, as a pin and its bore do, contact
turns with them: local normals are needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.geometry.cells import connected, unit, vector_areas
from dolfinx_llm.geometry.facing import TURN, Facing, Separation, facing_facets
from dolfinx_llm.geometry.neighbours import (
    STRAIGHT,
    connected_parts,
    creased,
    meet_smoothly,
    neighbours,
)
from dolfinx_llm.geometry.overlap_curved import is_flat
from dolfinx_llm.geometry.overlap_flat import Plane, common_area, common_plane, plane_with
from dolfinx_llm.geometry.surface import Surface

TOGETHER = 0.05  # [rad] by which both surfaces may turn against the plane of what may part
SIDE_BY_SIDE = 1e-9  # of the surfaces' size: parts that overlap by less do not
VICINITY = 0.05  # width of the surroundings of the nearest place, in the surfaces' radius


@dataclass(frozen=True, eq=False)
class Piece:
    """Parts of both sides that are treated together."""

    facets: tuple[Array, Array]  # of each side, (k_i,) numbers
    plane: Plane | None  # None: curved
    edges: int  # sharp edges inside of it
    weights: tuple[Array, Array] | None = None  # (k_i,) of the facets' areas in the
    # normal of surfaces that may part; None: tied, or curved
    cut: tuple[Array, Array] | None = None  # of each side (n_i,) nodes where facets were left
    # out as too far away; None: all that face each other are there

    def parts(self, sides: Sequence[Surface]) -> tuple[Surface, Surface]:
        """Both sides' surfaces of this piece alone."""
        return sides[0].part(self.facets[0]), sides[1].part(self.facets[1])

    def only(self, *chosen: Array) -> Piece:
        """Of each side some facets (k_i,), with the same plane."""
        first, second = (own[some] for own, some in zip(self.facets, chosen, strict=True))
        weights = self.weights
        if weights is not None:
            weights = weights[0][chosen[0]], weights[1][chosen[1]]
        return replace(self, facets=(first, second), weights=weights)


def touching_pieces(
    sides: Sequence[Surface], separations: Sequence[Separation], unilateral: bool
) -> list[Piece]:
    """What of two surfaces can touch: one piece, or several where planes do only piece by piece;
    none where nothing faces. Surfaces that may not part are flat to rounding, or curved."""
    found = _Found(sides, facing_facets(sides, separations), separations, unilateral)
    if not found.count[0] or not found.count[1]:
        return []
    everything = np.ones(sum(found.count), dtype=bool)
    plane, groups = found.plane(everything), found.groups()
    if plane is not None:
        return found.stacked_pieces(groups, plane) or [found.piece(everything, plane)]
    flat = found.flat_pieces(groups) or found.flat_pieces(found.flanks())
    return flat or [found.piece(everything, None, edges=found.smooth_parts() - len(groups))]


class _Found:
    """The facets of both sides that face each other, one list of both."""

    def __init__(
        self,
        sides: Sequence[Surface],
        facing: tuple[Facing, Facing],
        separations: Sequence[Separation],
        unilateral: bool,
    ):
        self.sides, self.facing, self.unilateral = sides, facing, unilateral
        self.count = [len(f.facets) for f in facing]
        areas = [vector_areas(side.x, side.facets) for side in sides]
        normals = [unit(a) for a in areas]
        self.area = np.concatenate([a[f.facets] for a, f in zip(areas, facing)])
        self.normal = np.concatenate([n[f.facets] for n, f in zip(normals, facing)])
        across = [normals[1 - k][f.partner] for k, f in enumerate(facing)]
        self.across = np.concatenate(across)
        self.side = np.repeat([0, 1], self.count)
        self.distance = np.concatenate([
            s.distance[side.facets[f.facets]].mean(axis=1)
            for s, side, f in zip(separations, sides, facing)
        ])  # fmt: skip
        self.centre = np.concatenate([
            side.x[side.facets[f.facets]].mean(axis=1) for side, f in zip(sides, facing)
        ])  # fmt: skip

    def piece(self, which: Array, plane: Plane | None, edges: int = 0) -> Piece:
        """The piece of some facets."""
        parts = np.split(which, [self.count[0]])
        weights = None
        if plane is not None and self.unilateral:
            weights = self._weights([which & (self.side == k) for k in (0, 1)])
        facets = self.facing[0].facets[parts[0]], self.facing[1].facets[parts[1]]
        return Piece(facets, plane, edges, weights)

    def flat_pieces(self, parts: list[Array]) -> list[Piece]:
        """A piece for each of several parts; none where one of these has no plane."""
        planes = [self.plane(part) for part in parts]
        if len(parts) < 2 or not all(planes):
            return []
        return [self.piece(part, plane) for part, plane in zip(parts, planes)]

    def stacked_pieces(self, parts: list[Array], plane: Plane) -> list[Piece]:
        """A piece for each of several parts that lie behind each other along the plane's normal, as
        tops and undersides of a stack; none where no parts do."""
        parts = [part for part in parts if len(set(self.side[part])) == 2]
        if len(parts) < 2:
            return []
        both = [self.piece(part, None).parts(self.sides) for part in parts]
        x = [[plane.project(side.x) for side in sides] for sides in both]
        low = np.array([np.max([a.min(axis=0) for a in own], axis=0) for own in x])
        high = np.array([np.min([a.max(axis=0) for a in own], axis=0) for own in x])
        size = max(side.diameter for side in self.sides)
        behind = (low[:, None] + SIDE_BY_SIDE * size < high[None]).all(axis=2)
        return self.flat_pieces(parts) if np.triu(behind & behind.T, 1).any() else []

    def plane(self, which: Array) -> Plane | None:
        """The plane that does for some facets, if one does."""
        of = [which & (self.side == k) for k in (0, 1)]
        if not all(o.any() for o in of):
            return None
        parts = self.piece(which, None).parts(self.sides)
        if not self.unilateral:
            return tied_plane(parts)
        normal = mean_normal([self.area[o] for o in of], self._weights(of))
        if normal is None:
            return None
        sign = np.where(self.side[which] == 0, 1.0, -1.0)[:, None]
        own, across = sign * self.normal[which], -sign * self.across[which]
        mean = unit(own + across)
        between = np.arccos(np.clip(np.einsum("ni,ni->n", own, across), -1.0, 1.0))
        turned = np.arccos(np.clip(mean @ normal, -1.0, 1.0)) - 0.5 * between
        return plane_with(normal, *parts) if turned.max() <= TOGETHER else None

    def _weights(self, of: Sequence[Array]) -> tuple[Array, Array]:
        """Per side the weights of facets about where the sides are nearest."""
        near = min(self.distance[o].min() for o in of)
        reach = (VICINITY * min(self._radius(o) for o in of)) ** 2
        first, second = (reach / (reach + (self.distance[o] - near) ** 2) for o in of)
        return first**2, second**2

    def _radius(self, of: Array) -> float:
        """Of facets about their middle; of one alone half its size [length]."""
        if of.sum() > 1:
            x = self.centre[of]
            return float(np.linalg.norm(x - x.mean(axis=0), axis=1).max())
        size = np.linalg.norm(self.area[of])
        return 0.5 * float(size if self.area.shape[1] == 2 else np.sqrt(size))

    def smooth_parts(self) -> int:
        """Number of connected parts without a sharp edge inside."""
        return int(self._components(sharp=False).max()) + 1

    def groups(self) -> list[Array]:
        """Facets that are connected by nodes, or by facing each other."""
        label = self._components(sharp=True)
        return [label == k for k in range(label.max() + 1)]

    def flanks(self) -> list[Array]:
        """Facets by the flank they face of a groove, hollow at its edges, in which a body lies that
        has none; none where there are other edges."""
        label, grooved = self._components(sharp=False), False
        for k, (side, f) in enumerate(zip(self.sides, self.facing)):
            facets = side.facets[f.facets]
            i, j = neighbours(facets)
            normal, x = (a[self.side == k] for a in (self.normal, self.centre))
            rounded = meet_smoothly(normal, i, j) & ~creased(facets, normal, i, j)
            hollow = np.einsum("ni,ni->n", normal[i], x[j] - x[i]) > 0.0
            if rounded.all():
                continue
            if grooved or not (rounded | hollow).all():
                return []
            grooved, own = True, connected_parts(i[rounded], j[rounded], len(x))
            flank = np.full(len(side.facets), -1)
            flank[f.facets] = own
            label[self.side == k], label[self.side != k] = own, flank[self.facing[1 - k].partner]
        found = [label == n for n in range(label.max() + 1)]
        # Single facets at ends face none.
        return [of for of in found if len(set(self.side[of])) == 2]

    def _components(self, sharp: bool) -> Array:
        """(m,) connected part of each facet; with sharp edges as ties, or without."""
        rows, cols, start = [], [], np.array([0, self.count[0]])
        for k, (side, f) in enumerate(zip(self.sides, self.facing)):
            i, j = neighbours(side.facets[f.facets], by_nodes=sharp)
            i, j = i + start[k], j + start[k]
            if not sharp:
                kept = meet_smoothly(self.normal, i, j)
                i, j = i[kept], j[kept]
            place = np.full(len(self.sides[1 - k].facets), -1)
            place[self.facing[1 - k].facets] = start[1 - k] + np.arange(self.count[1 - k])
            across = place[f.partner]
            own = np.flatnonzero(across >= 0)
            rows += [i, start[k] + own]
            cols += [j, across[own]]
        return connected_parts(np.concatenate(rows), np.concatenate(cols), sum(self.count))


def separated(piece: Piece, sides: Sequence[Surface]) -> list[Piece]:
    """A piece for each pair of connected parts of both sides that cover each other, where these
    meet at nodes of the other side, as feet do on the same facets of a plate; in 2D always. Else
    the piece itself."""
    if piece.plane is None:
        return [piece]
    both = zip(sides, piece.facets, strict=True)
    label = [connected(side.facets[own], len(side.x))[0] for side, own in both]
    if not any(own.max(initial=0) for own in label):
        return [piece]
    x = [
        piece.plane.project(side.x)[side.facets[own]]
        for side, own in zip(sides, piece.facets, strict=True)
    ]
    low, high = ([f(a, axis=1) for a in x] for f in (np.min, np.max))
    box = [
        [(low[k][label[k] == b].min(axis=0), high[k][label[k] == b].max(axis=0))
         for b in range(label[k].max() + 1)] for k in (0, 1)
    ]  # fmt: skip
    found, first, second = [], *(np.array(b) for b in box)
    meets = (first[:, None, 0] < second[None, :, 1]).all(axis=2)
    meets &= (second[None, :, 0] < first[:, None, 1]).all(axis=2)
    for i, j in np.argwhere(meets):
        chosen = []
        for k, own, other in ((0, i, second[j]), (1, j, first[i])):
            near = (low[k] < other[1]).all(axis=1) & (high[k] > other[0]).all(axis=1)
            chosen.append(near & (label[k] == own))
        part = piece.only(*chosen)
        try:
            common_area(*part.parts(sides), piece.plane)
        except ContactError:  # boxes alone do
            continue
        found.append(part)
    nodes = [[np.unique(s.cells[p.facets[k]]) for p in found] for k, s in enumerate(sides)]
    meet = x[0].shape[2] == 1 or any(
        np.unique(np.concatenate(n), return_counts=True)[1].max() > 1 for n in nodes if n
    )
    return found if meet else [piece]


def tied_plane(parts: Sequence[Surface]) -> Plane | None:
    """The common plane of two surfaces that are flat to rounding and face each other, or None."""
    size = max(part.diameter for part in parts)
    sums = [part.normal for part in parts]
    opposite = np.dot(*sums) < -np.cos(TURN) * np.prod([np.linalg.norm(a) for a in sums])
    if not (opposite and all(is_flat(part, 1e-6 * size) for part in parts)):
        return None
    return common_plane(parts[0], parts[1])


def mean_normal(areas: Sequence[Array], weights: Sequence[Array]) -> Array | None:
    """Unit normal out of side 0, of the vector areas (k_i, gdim) of each side's facets and their
    weights (k_i,): a flat side's own; else the mean of both sides'. None: facets look
    everywhere."""
    means, straight = [], []
    for area, weight in zip(areas, weights, strict=True):
        length = np.linalg.norm(area, axis=1)
        total = weight @ area
        if not np.linalg.norm(total) > 0.1 * (weight @ length):
            return None
        means.append(total / np.linalg.norm(total))
        straight.append(bool(np.abs(area / length[:, None] - means[-1]).max() < STRAIGHT))
    if straight[0] != straight[1]:
        return means[0] if straight[0] else -means[1]
    mean = means[0] - means[1]
    size = np.linalg.norm(mean)
    return mean / size if size > 0.1 else None
