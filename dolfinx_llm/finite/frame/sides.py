"""Two surfaces of which one carries the moving frame: where, how far and along what they touch.

The frame's nodes are those of the coarser surface (but see ``divided_sides``), y_J = x_J: its rows
are the identity, so that v and that side's multipliers are known, lambda_J = -sum_p N_pJ lambda_p,
and equilibrium of the frame, sum_p N_pJ lambda_p = 0 over both sides, holds by construction. The
other surface is the moving side.

Pairs of second-order surfaces are those of its control values, see ``operators.control``: gap' =
C gap of the nodes' gaps, C = E^-1, is at least 0, and so are forces lambda' = E^T lambda, where
nodal forces of a pressure may be negative. At first order C and E are the identity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, TypeVar

import numpy as np
from scipy.sparse import csr_matrix, hstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import per_component
from dolfinx_llm.finite.frame.areas import surface_integrals
from dolfinx_llm.finite.frame.cover_facets import LAYER, Skin, covered_facets
from dolfinx_llm.finite.frame.cover_line import Chains, covered_lines
from dolfinx_llm.finite.frame.covered import Covered, integrated
from dolfinx_llm.finite.frame.jacobians import NodalNormals, coordinates, nodal_normals
from dolfinx_llm.finite.frame.location import (
    LocationDerivatives,
    OnFrame,
    find_on_frame,
    location_derivatives,
)
from dolfinx_llm.geometry.cells import areas_around, cell_sizes, unit, vector_areas
from dolfinx_llm.geometry.drawn import drawn_curved
from dolfinx_llm.geometry.facing import TURN
from dolfinx_llm.geometry.pairs import control_matrices
from dolfinx_llm.geometry.surface import Surface

Item = TypeVar("Item")

AS_COARSE = 1e-6  # difference of mean facet sizes that is none
PER_NODE = {2: 1.0, 3: np.sqrt(2.0), 4: 1.0}  # distance of nodes over the size of facets
HARDLY = 1e-2  # shape function of a node below which a place is not on it
WITHIN = 1.0  # gap over the frame's facet up to which facets can touch in a step


@dataclass(frozen=True, eq=False)
class Meeting:
    """How two surfaces meet in one configuration, with derivatives."""

    at: OnFrame  # of all nodes of the moving side
    d: LocationDerivatives
    normals: NodalNormals  # of the frame's nodes, continued to its outline
    covered: tuple[Covered, Covered]  # facets of the moving side, of the frame
    along: tuple[Array, csr_matrix] | None  # (f,) length of the frame that each of the moving
    # side's facets covers [length], and (f, width) its derivative; None: in space


def _told_apart(surface: Surface, size: float) -> list[float]:
    """Numbers that turns do not change, by which two surfaces differ that are equally coarse: what
    they enclose, with a sign, how large they are, and how far and how evenly their nodes lie."""
    area, x = vector_areas(surface.x, surface.facets), surface.x - surface.x.mean(axis=0)
    gdim, of_facets = x.shape[1], cell_sizes(surface.x, surface.skin) / size
    encloses = float(np.sum(x[surface.facets].mean(axis=1) * area)) / size**gdim
    covers = float(np.linalg.norm(area.sum(axis=0))) / size ** (gdim - 1)
    spread = np.linalg.eigvalsh(np.einsum("ni,nj->ij", x, x) / (len(x) * size**2))
    return [encloses, covers, *spread.tolist(), float(of_facets.max()), float(of_facets.min())]


def coarser(surfaces: Sequence[Surface]) -> int:
    """Which of two surfaces is; alike the one that encloses more, as of two rings the inner one, or
    is larger; else the one whose name comes first, and then the one whose normal does."""
    size = [cell_sizes(s.x, s.skin).mean() * PER_NODE[s.skin.shape[1]] for s in surfaces]
    if abs(size[0] - size[1]) > AS_COARSE * max(size):
        return int(size[1] > size[0])
    both = [_told_apart(s, max(t.diameter for t in surfaces)) for s in surfaces]
    for first, second in zip(*both, strict=True):
        if abs(first - second) > AS_COARSE:
            return int(second > first)
    if surfaces[0].name != surfaces[1].name:
        return int(surfaces[1].name < surfaces[0].name)
    ways = np.array([vector_areas(s.x, s.facets).sum(axis=0) for s in surfaces])
    ways = (ways / (np.linalg.norm(ways, axis=1).max() or 1.0)).round(6) + 0.0
    return int(tuple(ways[1]) > tuple(ways[0]))


@dataclass(frozen=True, eq=False)
class Sides:
    """Both surfaces; all coordinates: those of surface 0, then those of surface 1."""

    surfaces: tuple[Surface, Surface]
    frame: int  # which of them carries the frame
    chains: Chains | None  # of the frame's facets, in the plane
    rounded: Array  # (m,) the frame's nodes about which it is drawn curved, not at an edge
    around: csr_matrix | None  # (m, f) weights of its facets in nodal normals; None: those around
    within: float = WITHIN
    prescribed: bool = False  # supports move the surface that carries the frame as a whole
    _met: list[Any] = field(init=False, default_factory=list, repr=False)  # the last of ``meet``

    laws_reach: ClassVar[float] = 4.0  # gap over the frame's facet up to which laws can pull
    behind: ClassVar[float] = LAYER  # a facet in space, over its size, up to which another meets it

    @classmethod
    def of(cls, surfaces: Sequence[Surface], frame: int | None = None) -> Sides:
        """The coarser surface carries the frame; which comes first does not matter.

        Args:
            surfaces: as drawn.
            frame: which carries the frame since supports move it as a whole; None: the coarser one.
        """
        prescribed = frame is not None
        frame = coarser(surfaces) if frame is None else frame
        chains = Chains.of(surfaces[frame].facets) if surfaces[0].x.shape[1] == 2 else None
        around, rounded = drawn_curved(surfaces[frame].x, surfaces[frame].skin)
        if surfaces[frame].element.order > 1:  # nothing stands out beyond its facets
            inner = rounded[surfaces[frame].facets].all(axis=1)
            around, rounded[surfaces[frame].cells[inner]] = None, True
        both = surfaces[0], surfaces[1]
        return cls(both, frame, chains, rounded, around, prescribed=prescribed)

    @property
    def moving(self) -> int:
        """Which surface is located on the other."""
        return 1 - self.frame

    @property
    def mover(self) -> Surface:
        """The moving side."""
        return self.surfaces[1 - self.frame]

    @property
    def carrier(self) -> Surface:
        """The surface that carries the frame."""
        return self.surfaces[self.frame]

    @property
    def gdim(self) -> int:
        """Dimension of space."""
        return int(self.surfaces[0].x.shape[1])

    @property
    def width(self) -> int:
        """Number of all coordinates."""
        return sum(s.x.size for s in self.surfaces)

    @property
    def first(self) -> tuple[int, int]:
        """Number of the first coordinate of the moving side, and of the frame."""
        shift = self.surfaces[0].x.size
        return (shift, 0) if self.frame == 0 else (0, shift)

    @property
    def columns(self) -> tuple[Array, int]:
        """(n, gdim) coordinates of the moving side's nodes, and the frame's first."""
        nodes = np.arange(len(self.mover.x))
        return coordinates(nodes[:, None], self.gdim, self.first[0]), self.first[1]

    def split(self, z: Array) -> tuple[Array, Array]:
        """Positions of the moving side's nodes and of the frame's, of all coordinates (width,)."""
        parts = np.split(z, [self.surfaces[0].x.size])
        parts = [part.reshape(-1, self.gdim) for part in parts]
        return parts[self.moving], parts[self.frame]

    def moves(self, free: Array) -> Array:
        """(n, gdim) components in which nodes of the moving side have motions of their own."""
        return self.split(free)[0]

    def in_order(self, moving: Item, frame: Item) -> tuple[Item, Item]:
        """What belongs to the moving side and to the frame, in the order of the surfaces."""
        return (frame, moving) if self.frame == 0 else (moving, frame)

    @cached_property
    def control(self) -> tuple[csr_matrix, csr_matrix]:
        """C (n, n) of the moving side, and (m, m) of the frame."""
        return control_matrices(self.mover)[1], control_matrices(self.carrier)[1]

    @cached_property
    def nodal(self) -> csr_matrix:
        """E (n, n) of the moving side."""
        return control_matrices(self.mover)[0]

    def jumps(self, N: csr_matrix) -> csr_matrix:
        """(n gdim, width) sum_q C_pq x_q - sum_J N_pJ y_J, of all coordinates, for rows (n, m) of
        pairs."""
        parts = self.in_order(self.control[0], -N)
        return per_component(hstack(parts, format="csr"), self.gdim)

    def candidates(self, z: Array) -> Array:
        """(f,) facets of the moving side that face the frame and lie near; held during a step."""
        if self._met and np.array_equal(self._met[0], z):
            return self.facing(z, self._met[2].at)
        x, y = self.split(z)
        return self.facing(z, find_on_frame(x, y, self.carrier.cells, self.outward(z)))

    def facing(self, z: Array, at: OnFrame) -> Array:
        """(f,) the same of nodes that meet the frame at given places."""
        x, y = self.split(z)
        facets = self.mover.facets
        size = cell_sizes(y, self.carrier.facets)[at.facet]
        near = at.met & (np.abs(at.gap) <= self.within * size)
        area = vector_areas(x, facets)
        across = at.normal[facets].sum(axis=1)
        cosine = np.einsum("fi,fi->f", area, across)
        size = np.linalg.norm(area, axis=1) * np.linalg.norm(across, axis=1)
        cosine /= np.maximum(size, 1e-300)  # normals that cancel look nowhere
        return near[self.mover.cells].all(axis=1) & (cosine < -np.cos(TURN))

    def outward(self, z: Array) -> Array:
        """(m, gdim) unit normals of the frame's nodes, out of its body."""
        return unit(areas_around(self.split(z)[1], self.carrier.skin))

    def meet(self, z: Array, candidates: Array) -> Meeting:
        """How the surfaces meet at coordinates z (width,); kept until they are elsewhere.

        Args:
            z: all coordinates [length].
            candidates: (f,) facets of the moving side that can touch.
        """
        if not (self._met and all(map(np.array_equal, self._met, (z, candidates)))):
            self._met[:] = z, candidates, self._meet(z, candidates)
        found: Meeting = self._met[2]
        return found

    def _meet(self, z: Array, candidates: Array) -> Meeting:
        x, y = self.split(z)
        of_frame = y, self.carrier.skin, self.first[1], self.width
        normals = nodal_normals(*of_frame)
        own = self.own_normals(x)
        at = self.found(x, y, normals.n, None if own is None else own.n, candidates)
        d = location_derivatives(at, y, self.carrier.cells, normals, self.columns, self.width, own)
        if self.chains is None:
            covered = self._clipped(z, candidates, True), self._clipped(z, candidates, False)
            along = None
        else:
            degrees = integrated(self.mover), integrated(self.carrier)
            of = self.mover.facets, candidates, x, y, at, d, normals, self.first, degrees
            covered, along = covered_lines(self.chains, *of)
        if self.around is not None:  # nodes are found by the facets' own alone
            normals = nodal_normals(*of_frame, self.around)
        return Meeting(at, d, normals, covered, along)

    def found(
        self,
        x: Array,
        y: Array,
        normals: Array,
        own: Array | None,
        candidates: Array,
    ) -> OnFrame:
        """Where the moving side's nodes x meet the frame, for facets that can touch (f,); other
        arguments as of ``find_on_frame``."""
        frame = np.flatnonzero(self.carries(candidates))
        at = find_on_frame(x, y, self.carrier.cells[frame], normals, own)
        return replace(at, facet=frame[at.facet])

    def own_normals(self, x: Array) -> NodalNormals | None:
        """Normals of the moving side's nodes, where they count."""
        return None

    def carries(self, candidates: Array) -> Array:
        """(f,) which facets of the frame's surface are the frame's."""
        return np.ones(len(self.carrier.facets), dtype=bool)

    def covered(self, z: Array, candidates: Array, moving: bool) -> Covered:
        """What is covered of a side alone; arguments as for ``meet``."""
        if self.chains is None:
            return self._clipped(z, candidates, moving)
        return self.meet(z, candidates).covered[0 if moving else 1]

    def _clipped(self, z: Array, candidates: Array, moving: bool) -> Covered:
        """The same in space."""
        (x, y), (facets, frame) = self.split(z), (self.mover.facets, self.carrier.facets)
        elements = self.mover.element, self.carrier.element
        own = Skin(x, facets, elements[0], candidates, self.first[0])
        other = Skin(y, frame, elements[1], self.carries(candidates), self.first[1])
        skins = (own, other) if moving else (other, own)
        return covered_facets(*skins, self.width, self.behind)

    def forces(self, meeting: Meeting, z: Array, moving: bool) -> tuple[Array, csr_matrix]:
        """(n,) forces of unit pressure on the common area at a side's control values, and their
        derivatives."""
        side = 0 if moving else 1
        x, surface = self.split(z)[side], self.mover if moving else self.carrier
        covered = meeting.covered[side]
        values, derivative = surface_integrals(x, surface, covered, self.first[side], sizes=True)
        return values[:, 0], derivative
