"""A follower pressure on a surface, or on the part of it that nothing covers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from dolfinx import fem
from scipy.sparse import csr_matrix

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.sparse import per_component
from dolfinx_llm.finite.frame.areas import everything, surface_integrals
from dolfinx_llm.finite.frame.covered import Covered
from dolfinx_llm.finite.frame.location import INSIDE
from dolfinx_llm.finite.frame.self_sides import SelfSides
from dolfinx_llm.finite.frame.sides import Sides
from dolfinx_llm.geometry.pairs import control_matrices
from dolfinx_llm.geometry.surface import Surface, check_facet_tags
from dolfinx_llm.geometry.thickness import check_thickness
from dolfinx_llm.interface.obstacle import Obstacle

COVER = "give (facet tags, tag), a rigid obstacle, or several of them"


@dataclass(frozen=True, eq=False)
class FreeSurfacePressure:
    """Pressure that follows a surface, on what other surfaces and obstacles leave free now.

    Covered is what is in contact where bodies come to rest: facets of the side that is found on the
    other one, the finer one in general, of which all nodes are in contact, and what lies across
    from them; on an obstacle facets of which all nodes are. All else is free, whatever lies across:
    a gap that closes like a wedge bears the pressure up to the last node that touches. Where that
    opens, as contact bears less than the pressure, the next facet is free as well.

    Integrals are exact, also over clipped facets and over whole ones of second order that bend;
    over a part of such a one they miss a force along the surface, of at most p on the facet's
    height over its chord.

    Args:
        facet_tags: dolfinx mesh tags of facets.
        tag: the loaded surface.
        p: pressure, positive when it presses on the body [force / area]: a number, or a Constant,
            whose value may change between load steps.
        covered_by: (facet tags, tag) of a surface that may cover part of it, as contact of an
            interface between both tells, or the same surface with ``SelfContact``; a rigid
            obstacle; a list of them; or None.
        thickness: of bodies in the plane, as of ``Interface`` [length].

    Raises:
        ContactInputError: arguments of other types.
    """

    facet_tags: Any
    tag: int
    p: Any
    covered_by: Any = field(default=None, kw_only=True)
    thickness: Any = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        check_facet_tags("facet_tags", self.facet_tags)
        checks.integer("facet tag", self.tag)
        check_thickness(self.thickness)
        self.value()
        for cover in self.covers:
            if not isinstance(cover, Obstacle):
                given = checks.items("covered_by", cover, COVER)
                if len(given) != 2:
                    checks.refuse("covered_by", self.covered_by, COVER)
                check_facet_tags("covered_by: facet tags", given[0])
                checks.integer("covered_by: tag", given[1], COVER)

    @property
    def covers(self) -> list[Any]:
        """Each of what may cover it."""
        given = self.covered_by
        if given is None:
            return []
        if isinstance(given, Obstacle):
            return [given]
        found = checks.items("covered_by", given, COVER)
        several = any(isinstance(one, Obstacle | Sequence) for one in found)
        return found if several else [tuple(found)]

    def value(self) -> float:
        """The pressure now.

        Raises:
            ContactInputError: it is no finite number.
        """
        p = self.p
        if isinstance(p, fem.Constant):
            if np.ndim(p.value):
                raise ContactInputError("p: give a scalar Constant, or a number")
            p = float(p.value)
        return checks.number("p", p, "give a finite number or a scalar Constant")

    def tagged(self) -> list[tuple[Any, int]]:
        """The loaded surface, and those that may cover it, as (facet tags, tag)."""
        others = [tuple(c) for c in self.covers if not isinstance(c, Obstacle)]
        return [(self.facet_tags, self.tag), *others]

    @property
    def pieces(self) -> list[Any]:
        """What ``Follower`` each is made of: all that the first cover leaves free, less what the
        others cover."""
        return self.covers or [None]


def pressures_of(loads: Sequence[FreeSurfacePressure]) -> Array:
    """Of each piece of some follower pressures [force / area]."""
    return np.array([load.value() for load in loads for _ in load.pieces], dtype=float)


def sides_between(
    surfaces: Sequence[Surface], nodes: Sequence[Array], meets: Sequence[tuple[Array, Array]]
) -> Sides | None:
    """A loaded surface and what may cover it, as contact has them; None: no interface is between.

    Args:
        surfaces: both, as drawn; of one that meets itself twice the same.
        nodes: (n,) numbers of the nodes of each.
        meets: per interface (n,) those of its moving side, and (m,) of its frame.

    Raises:
        ContactInputError: they are not the same, and have facets in common.
    """

    def met(moving: Array, frame: Array) -> int:
        """How many nodes the moving sides and frames of interfaces share with these two."""
        return sum(min(np.isin(moving, m).sum(), np.isin(frame, f).sum()) for m, f in meets)

    facets = [np.sort(n[s.facets], axis=1) for n, s in zip(nodes, surfaces, strict=True)]
    common = 0
    if facets[0].shape[1] == facets[1].shape[1]:
        _, count = np.unique(np.concatenate(facets), axis=0, return_counts=True)
        common = int((count > 1).sum())
    if common and not len(facets[0]) == common == len(facets[1]):
        raise ContactInputError(
            f"FreeSurfacePressure: {surfaces[0].name} and {surfaces[1].name} have {common} facets "
            "in common: load and cover the whole of a surface that meets itself, or parts of it "
            "that have none in common"
        )
    on_other, on_first = met(*nodes), met(*nodes[::-1])
    if not (on_other or on_first):
        return None
    if common:
        return SelfSides.of_one(surfaces[0])
    return Sides.of(surfaces, int(on_other >= on_first))


@dataclass(frozen=True, eq=False)
class Covering:
    """Facets of the moving side that count as touching, of an increment.

    They leave once each: where a pressure that pulls, or a lever, parts what it covers and brings
    together what it frees, they would go in and out for ever.
    """

    facets: Array  # (f,)
    left: Array  # (f,) that have left since the start


@dataclass(frozen=True, eq=False)
class Follower:
    """A piece of it on its surfaces; all coordinates: those of the loaded one, then of the other.

    A rigid obstacle covers facets of which all nodes are in contact with it.
    """

    surfaces: Sequence[Surface]  # as drawn: the loaded one, and one that may cover it
    sides: Sides | None  # with that
    obstacle: Obstacle | None = None  # that may cover it
    whole: bool = True  # all that is free; else less what is covered

    def hold(self, z: Array, closed: Array) -> Covering | None:
        """Facets that touch in an increment that starts at coordinates z; None: it has none.

        Args:
            z: coordinates [length].
            closed: (n,) nodes of the moving side, or of one on an obstacle, that are in contact.
        """
        if self.sides is None and self.obstacle is None:
            return None
        found = self._touching(z, closed)
        return Covering(found, np.zeros_like(found))

    def missed(self, z: Array, closed: Array, held: Covering | None) -> Covering | None:
        """Those that touch at an equilibrium z, where they are others than held; None: they are
        the same. Arguments as of ``hold``."""
        if held is None:
            return None
        now = self._touching(z, closed) | (held.facets & held.left)
        if np.array_equal(now, held.facets):
            return None
        return Covering(now, held.left | (held.facets & ~now))

    def _touching(self, z: Array, closed: Array) -> Array:
        """(f,) facets of the moving side that lie across, with all of their nodes in contact, or
        beyond the frame's edge."""
        if self.sides is None:
            return np.asarray(closed[self.surfaces[0].cells].all(axis=1))
        found, cells = self.sides.candidates(z), self.sides.mover.cells
        beyond = self.sides.meet(z, found).at.beyond > INSIDE
        if self.sides.chains is not None:  # facets that press at an end touch up to it
            at_end = cells[(closed & beyond)[cells].any(axis=1)]
            closed = closed | np.isin(np.arange(len(closed)), at_end)
        return found & (closed | beyond)[cells].all(axis=1) & closed[cells].any(axis=1)

    def _covered(self, z: Array, every: Covered, held: Covering) -> list[Covered]:
        """Parts of all of the facets that are covered."""
        if self.sides is None:
            return [every.of(held.facets)]
        # Of a surface that meets itself one part covers the other.
        own = (True, False) if isinstance(self.sides, SelfSides) else (self.sides.moving == 0,)
        return [self.sides.covered(z, held.facets, moving) for moving in own]

    def terms(
        self, z: Array, p: float, held: Covering | None, lagged: bool = False
    ) -> tuple[Array, csr_matrix]:
        """Forces (width,) on all coordinates, and minus their derivative by them.

        Args:
            z: coordinates [length].
            p: pressure [force / area].
            held: of ``hold``.
            lagged: the derivative is that of parts which stay as they are.
        """
        loaded = self.surfaces[0]
        x = z[: loaded.x.size].reshape(loaded.x.shape)
        every = everything(x, loaded, 0, len(z))
        free = every if self.whole else every.times(0.0)
        for part in [] if held is None else self._covered(z, every, held):
            if lagged:
                part = Covered(part.share, csr_matrix(part.derivative.shape))
            free = free.without(part)
        vectors, derivative = surface_integrals(x, loaded, free, 0, bent=True)
        C = control_matrices(loaded)[1]
        vectors, derivative = C.T @ vectors, per_component(C, x.shape[1]).T @ derivative
        force = np.zeros(len(z))
        force[: x.size] = -p * vectors.ravel()
        K = (p * derivative).tocsr()
        K.resize((len(z), len(z)))  # rows of the other surface are empty
        return force, K
