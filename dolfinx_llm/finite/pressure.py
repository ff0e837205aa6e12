"""A follower pressure on a surface, or on the part of it that another surface does not cover."""

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

COVER = "give (facet tags, tag), or None"


@dataclass(frozen=True, eq=False)
class FreeSurfacePressure:
    """Pressure that follows a surface, on what another surface leaves free now.

    Covered is what is in contact where bodies come to rest: facets of the side that is found on the
    other one, the finer one in general, of which all nodes are in contact, and what lies across
    from them. All else is free, whatever lies across: a gap that closes like a wedge bears the
    pressure up to the last node that touches. Where that opens, as contact bears less than the
    pressure, the next facet is free as well.

    Integrals are exact, also over clipped facets and over whole ones of second order that bend;
    over a part of such a one they miss a force along the surface, of at most p on the facet's
    height over its chord.

    Args:
        facet_tags: dolfinx mesh tags of facets.
        tag: the loaded surface.
        p: pressure, positive when it presses on the body [force / area]: a number, or a Constant,
            whose value may change between load steps.
        covered_by: (facet tags, tag) of a surface that may cover part of it, as contact of an
            interface between both tells, or the same surface with ``SelfContact``; or None.
        thickness: of bodies in the plane, as of ``Interface`` [length].

    Raises:
        ContactInputError: arguments of other types.
    """

    facet_tags: Any
    tag: int
    p: Any
    covered_by: tuple[Any, ...] | None = field(default=None, kw_only=True)
    thickness: Any = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        check_facet_tags("facet_tags", self.facet_tags)
        checks.integer("facet tag", self.tag)
        check_thickness(self.thickness)
        self.value()
        if self.covered_by is not None:
            given = checks.items("covered_by", self.covered_by, COVER)
            if len(given) != 2:
                checks.refuse("covered_by", self.covered_by, COVER)
            check_facet_tags("covered_by: facet tags", given[0])
            checks.integer("covered_by: tag", given[1], COVER)

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
        """The loaded surface, and what may cover it, as (facet tags, tag)."""
        other = [] if self.covered_by is None else [tuple(self.covered_by)]
        return [(self.facet_tags, self.tag), *other]


def sides_between(
    surfaces: Sequence[Surface], nodes: tuple[Array, Array], meets: Sequence[tuple[Array, Array]]
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
    """The same on its surfaces; all coordinates: those of the loaded one, then of the other."""

    load: FreeSurfacePressure
    surfaces: Sequence[Surface]  # as drawn: the loaded one, and what may cover it
    sides: Sides | None

    def hold(self, z: Array, closed: Array) -> Covering | None:
        """Facets that touch in an increment that starts at coordinates z; None: it has none.

        Args:
            z: coordinates [length].
            closed: (n,) nodes of the moving side that are in contact.
        """
        if self.sides is None:
            return None
        found = self._touching(z, closed)
        return Covering(found, np.zeros_like(found))

    def missed(self, z: Array, closed: Array, held: Covering | None) -> Covering | None:
        """Those that touch at an equilibrium z, where they are others than held; None: they are
        the same. Arguments as of ``hold``."""
        if self.sides is None or held is None:
            return None
        now = self._touching(z, closed) | (held.facets & held.left)
        if np.array_equal(now, held.facets):
            return None
        return Covering(now, held.left | (held.facets & ~now))

    def _touching(self, z: Array, closed: Array) -> Array:
        """(f,) facets of the moving side that lie across, with all of their nodes in contact, or
        beyond the frame's edge."""
        assert self.sides is not None
        found, cells = self.sides.candidates(z), self.sides.mover.cells
        beyond = self.sides.meet(z, found).at.beyond > INSIDE
        return found & (closed | beyond)[cells].all(axis=1) & closed[cells].any(axis=1)

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
        free = everything(x, loaded, 0, len(z))
        if self.sides is not None and held is not None:
            one = isinstance(self.sides, SelfSides)  # of which one part covers the other
            for moving in (True, False) if one else (self.sides.moving == 0,):
                covered = self.sides.covered(z, held.facets, moving)
                if lagged:
                    covered = Covered(covered.share, csr_matrix(covered.derivative.shape))
                free = free.without(covered)
        vectors, derivative = surface_integrals(x, loaded, free, 0, bent=True)
        C = control_matrices(loaded)[1]
        vectors, derivative = C.T @ vectors, per_component(C, x.shape[1]).T @ derivative
        force = np.zeros(len(z))
        force[: x.size] = -p * vectors.ravel()
        K = (p * derivative).tocsr()
        K.resize((len(z), len(z)))  # rows of the other surface are empty
        return force, K
