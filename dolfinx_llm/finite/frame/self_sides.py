"""A surface that meets itself: parted into a frame and what moves on it, where it stands now.

Both sides are the same surface, whose coordinates stand twice in z, so that all that holds of two
surfaces holds of one: derivatives by a node add up in the system. At the start of an increment the
facets that face each other are found, and parted so that facets side by side stay together and
facets across from each other come apart. The coarser part, or of equal ones that whose normals as
drawn come first, carries the frame. Neighbours do not face each other: their normals differ by less
than 90 degrees, or few facets lie between them along the surface. Where facets would come apart
from themselves, those do not either that a bend leads to on a way hardly longer than across it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.sparse import bmat, csr_matrix, identity
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.finite.frame.crossing import CROSSED, depth_through
from dolfinx_llm.finite.frame.jacobians import NodalNormals, nodal_normals
from dolfinx_llm.finite.frame.location import BEHIND_IT
from dolfinx_llm.finite.frame.sides import WITHIN, Sides
from dolfinx_llm.geometry.cells import cell_sizes, unit_normals, vector_areas
from dolfinx_llm.geometry.facets_near import Polygons, facing_pairs
from dolfinx_llm.geometry.surface import Surface

FACES = 1.4  # [rad] between opposite normals of facets that can touch
FORESEEN = 2.0  # gap over the largest facet up to which facets are parted: more than can touch
WAY_ROUND = 2.0  # way along a bend over that across, up to which none touch; half a circle: 1.6
BESIDE = 2  # facets along the surface between those that can touch, at least
MUCH_FINER = 0.05  # difference of mean sizes over their sum, below which facets are alike
BEFORE = np.array([1.0, 0.7549, 0.5698])  # a direction by which normals come first
TOLD = 1e-6  # of the largest facet: difference of vector areas along it that tells parts apart


@dataclass(frozen=True, eq=False)
class SelfSides(Sides):
    """Both sides are one surface; the facets that can touch move, all others are the frame."""

    # Where a surface bends back, what lies farther is hardly across any more.
    laws_reach: ClassVar[float] = WITHIN
    behind: ClassVar[float] = BEHIND_IT  # the other face of its own wall is nothing that one meets

    @classmethod
    def of_one(cls, surface: Surface) -> SelfSides:
        """Of a surface as drawn."""
        sides = Sides.of((surface, surface))
        return cls(sides.surfaces, 0, sides.chains, sides.rounded, sides.around)

    def drawn_at(self, place: Array) -> list[float]:
        """A place (gdim,) for messages."""
        return checks.place(place + self.surfaces[0].origin)

    def candidates(self, z: Array) -> Array:
        """(f,) facets that move, face the frame and lie near; held during a step."""
        x, y = self.split(z)
        moving = self.parted(x)
        normals = self.outward(z)
        return moving & self.facing(z, self.found(x, y, normals, normals, moving))

    def own_normals(self, x: Array) -> NodalNormals:
        """See ``Sides``."""
        return nodal_normals(x, self.mover.skin, self.first[0], self.width)

    def carries(self, candidates: Array) -> Array:
        """(f,) facets that do not move."""
        return ~candidates

    def parted(self, x: Array) -> Array:
        """(f,) facets that move on what they face, of nodes x (n, gdim).

        Raises:
            ContactError: facets face each other in a ring of odd length, which has no two sides.
        """
        facets = self.mover.facets
        f, size = len(facets), cell_sizes(x, facets)
        normal, centre = unit_normals(x, facets), x[facets].mean(axis=1)
        surface = replace(self.surfaces[0], x=x)
        i, j = facing_pairs([Polygons.of(surface)], np.arange(f), FORESEEN * size.max(), FACES)
        arm, deep = centre[j] - centre[i], -BEHIND_IT * np.maximum(size[i], size[j])
        ahead = np.einsum("ni,ni->n", arm, normal[i]) > deep
        ahead &= -np.einsum("ni,ni->n", arm, normal[j]) > deep
        beside = _beside(facets)
        within = identity(f, format="csr")
        for _ in range(BESIDE):
            within = within @ beside
        next_to = within.tocoo()
        ahead &= ~np.isin(i * f + j, next_to.row.astype(np.int64) * f + next_to.col)
        i, j = i[ahead], j[ahead]
        one, other, count, odd = _parts(normal, beside, i, j)
        if odd.any():  # as in a tight bend, across which facets face each other that cannot touch
            bends = np.isin(i, np.flatnonzero(odd)) | np.isin(j, np.flatnonzero(odd))
            bends[bends] = _round_a_bend(centre, beside, i[bends], j[bends])
            i, j = i[~bends], j[~bends]
            one, other, count, odd = _parts(normal, beside, i, j)
        if odd.any():
            raise ContactError(
                f"{self.surfaces[0].name} meets itself where it has no two sides: {odd.sum()} "
                f"facets, the first at {self.drawn_at(centre[odd][0])}, lie across from what "
                "hangs together with them. Take smaller load steps, or tag the sides apart and "
                "give an Interface"
            )
        paired = np.isin(np.arange(f), np.concatenate([i, j]))
        return paired & self._comes_first(one, other, count)[one]

    def check_crossed(self, x: Array, allowed: float = CROSSED) -> None:
        """Require that no facets of nodes x (n, gdim) cross each other by more than a part of them.

        Raises:
            ContactError: the surface has gone through itself.
        """
        facets = self.mover.facets
        centre, reach = x[facets].mean(axis=1), float(cell_sizes(x, facets).max())
        i, j = cKDTree(centre).query_pairs(reach, output_type="ndarray").T
        apart = (facets[i][:, :, None] != facets[j][:, None]).all(axis=(1, 2))
        i, j = i[apart], j[apart]
        depth, size = depth_through((x, x), (facets, facets), (i, j))
        through = depth > allowed * size
        if through.any():
            worst = int(np.where(through, depth, 0.0).argmax())
            there = cell_sizes(x, facets[i[[worst]]])[0]
            raise ContactError(
                f"{self.surfaces[0].name} goes through itself: {through.sum()} pair(s) of facets "
                f"cross, the deepest at {self.drawn_at(centre[i[worst]])} by "
                f"{depth[worst]:.3g}, where facets have the size {there:.3g}"
            )

    def _comes_first(self, one: Array, other: Array, count: int) -> Array:
        """(count,) which parts move: of each and of what is across from it the finer, as drawn.

        Parts grow from increment to increment: what decides must not change with them.

        Args:
            one, other: (f,) the part of each facet, and the part across from it.
            count: number of parts.
        """
        drawn = self.surfaces[0]
        area, size = vector_areas(drawn.x, drawn.facets), cell_sizes(drawn.x, drawn.facets)
        number = np.maximum(np.bincount(one, minlength=count), 1)
        mean = np.bincount(one, size, count) / number
        turned = np.stack([np.bincount(one, a, count) for a in area.T], axis=1) / number[:, None]
        across = np.arange(count)
        across[one], across[other] = other, one
        difference = mean - mean[across]
        alike = np.abs(difference) <= MUCH_FINER * (mean + mean[across])
        change = (turned - turned[across]) @ BEFORE[: area.shape[1]]
        told = np.abs(change) > TOLD * np.abs(area).max()
        by_place = np.where(told, change < 0.0, np.arange(count) < across)
        return np.where(alike, by_place, difference < 0.0)


def _parts(
    normal: Array, beside: csr_matrix, i: Array, j: Array
) -> tuple[Array, Array, int, Array]:
    """The part of each facet and the part across from it (f,), how many there are, and which facets
    (f,) lie across from their own part.

    Args:
        normal: (f, gdim) of the facets.
        beside: (f, f) which lie side by side.
        i, j: (n,) which lie across from each other.
    """
    f, paired = len(normal), np.isin(np.arange(len(normal)), np.concatenate([i, j]))
    ends = np.concatenate([i, j]), np.concatenate([j, i])
    across = csr_matrix((np.ones(len(ends[0])), ends), (f, f))
    together = beside.tocoo()
    keep = paired[together.row] & paired[together.col]
    keep &= np.einsum("ni,ni->n", normal[together.row], normal[together.col]) > 0.0
    alike = csr_matrix((np.ones(keep.sum()), (together.row[keep], together.col[keep])), (f, f))
    count, label = connected_components(
        bmat([[alike, across], [across, alike]], format="csr"), directed=False
    )
    one, other = np.split(label, 2)
    return one, other, count, paired & (one == other)


def _round_a_bend(centre: Array, beside: csr_matrix, i: Array, j: Array) -> Array:
    """(n,) whether facets i and j lie across from each other in a bend: so near along the surface
    that the way there is hardly longer than straight across.

    Args:
        centre: (f, gdim) of the facets [length].
        beside: (f, f) which lie side by side.
        i, j: (n,) facets.
    """
    steps = beside.tocoo()
    length = np.linalg.norm(centre[steps.row] - centre[steps.col], axis=1)
    graph = csr_matrix((length, (steps.row, steps.col)), beside.shape)
    straight = np.linalg.norm(centre[i] - centre[j], axis=1)
    first, at = np.unique(i, return_inverse=True)
    way = dijkstra(graph, False, first, limit=WAY_ROUND * straight.max(initial=0.0))
    return np.asarray(way[at, j] < WAY_ROUND * straight)


def _beside(facets: Array) -> csr_matrix:
    """(f, f) which facets share a node, or are the same."""
    f, k = facets.shape
    at = np.repeat(np.arange(f), k), facets.ravel()
    incidence = csr_matrix((np.ones(f * k), at), (f, int(facets.max()) + 1))
    return incidence @ incidence.T
