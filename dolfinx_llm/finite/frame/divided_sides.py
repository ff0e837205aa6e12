"""Two surfaces of which the coarser one has sharp edges: the other one carries the frame.

Averaged normals are rounded off along whole facets beside a sharp edge of the frame. Forces along
them do work there where the other body presses on both sides, and the edge itself, a node of the
frame, is no pair. So the surface without edges carries the frame, whose normals turn by little, and
nodes of the one with edges are pairs. Where its facets are the larger ones they are divided, since
the frame's nodes would go through them in between: pairs are nodes of the parts, which go with
those of the whole facets and pass their forces on to these.

There may be more pairs than nodes that can follow them. Those that have no motion of their own
yield, as pairs do whose nodes supports hold: see ``yields``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import block_diag, csr_matrix, identity

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, per_component
from dolfinx_llm.finite.frame.sides import HARDLY, PER_NODE, Sides, coarser
from dolfinx_llm.geometry.cells import cell_sizes, unit
from dolfinx_llm.geometry.divided import divided
from dolfinx_llm.geometry.drawn import edges
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.forces import per_area
from dolfinx_llm.laws.rows import OPEN


class AtNodes(NamedTuple):
    """What is told of a surface's n nodes, see ``MovingSideResult``."""

    surface: Surface
    x: Array
    force: Array
    normal: Array
    gap: Array
    frame_gap: Array
    slip: Array
    status: Array
    area: Array
    density: Array | None


def where_sharp(surfaces: Sequence[Surface]) -> tuple[int, Array] | None:
    """The surface without edges, and (f,) into how many parts edges of the other one's facets go,
    about as long as those of the frame's facets; None: the coarser surface has no sharp edges, or
    the other one has some as well.

    Args:
        surfaces: as drawn.
    """
    k = coarser(surfaces)
    if [bool(edges(s.x, s.facets)[3].any()) for s in surfaces] != [k == 0, k == 1]:
        return None
    edged, frame = surfaces[k], surfaces[1 - k]
    size = cell_sizes(edged.x, edged.facets)
    if edged.x.shape[1] == 3:
        size[:] = size.mean()
    apart = np.median(cell_sizes(frame.x, frame.facets)) * PER_NODE[frame.facets.shape[1]]
    return 1 - k, np.maximum(np.round(size / apart), 1.0).astype(np.int64)


@dataclass(frozen=True, eq=False)
class DividedSides(Sides):
    """The moving side's n nodes come first, those of its divided facets behind them."""

    whole: Surface = field(kw_only=True)  # the moving side as it is
    shares: csr_matrix = field(kw_only=True)  # (n', n) shape functions of its nodes at all n' nodes

    @classmethod
    def with_parts(cls, surfaces: Sequence[Surface], frame: int, parts: Array) -> DividedSides:
        """Of both as drawn, the number of the one that carries the frame, and (f,) into how many
        parts edges of the other one's facets go."""
        both, k = list(surfaces), 1 - frame
        both[k], shares = divided(surfaces[k], parts)
        sides = Sides.of(both, frame)
        own = sides.surfaces, frame, sides.chains, sides.rounded, sides.around
        return cls(*own, whole=surfaces[k], shares=shares)

    @property
    def as_they_are(self) -> tuple[Surface, Surface]:
        """Both surfaces, with whole facets."""
        return self.in_order(self.whole, self.carrier)

    @cached_property
    def made(self) -> csr_matrix:
        """(width, k) coordinates by those of both surfaces as they are."""
        moving, frame = self.shares, identity(len(self.carrier.x))
        both = block_diag(self.in_order(moving, frame), format="csr")
        return per_component(both, self.gdim)

    def moves(self, free: Array) -> Array:
        found = super().moves(free).copy()
        found[len(self.whole.x) :] = False
        return found

    def of_whole(self, told: AtNodes) -> AtNodes:
        """What is told of the moving side's nodes, of that of all n' nodes that there are. A node
        is in contact where points about it are, whose forces it bears: along their mean normal, and
        with their mean slip where it is none of them."""
        n, shares = len(self.whole.x), self.shares
        pressed = np.einsum("ni,ni->n", told.force, told.normal)
        total, on = shares.T @ (pressed[:, None] * told.normal), told.status != OPEN
        bears = np.linalg.norm(total, axis=1) > 0.0
        about = (abs(shares) > HARDLY).T @ diagonal(on)
        mean = per_area(abs(about) @ told.slip, np.asarray(abs(about).sum(axis=1)).ravel())
        most = np.asarray((about @ diagonal(told.status)).max(axis=1).todense()).ravel()
        closed = on[:n]
        status = np.where(closed, told.status[:n], most.astype(told.status.dtype))
        along = unit(np.where(bears[:, None], total, 1.0))
        return AtNodes(
            surface=self.whole,
            x=told.x[:n],
            force=shares.T @ told.force,
            normal=np.where(bears[:, None], along, told.normal[:n]),
            gap=np.where(status != OPEN, 0.0, told.gap[:n]),
            frame_gap=told.frame_gap[:n],
            slip=np.where(closed[:, None], told.slip[:n], mean),
            status=status,
            area=shares.T @ told.area,
            density=None if told.density is None else told.density[:n],
        )
