"""Laws of one's own at the nodes of the moving side, on the frame or on a rigid obstacle: see
``law_told``. Their rows take the place of the gap's, where they give, and of friction's."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy.sparse import bmat, csr_matrix, vstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, summing
from dolfinx_llm.finite.frame.design import Design
from dolfinx_llm.finite.frame.jacobians import coordinates
from dolfinx_llm.finite.frame.sides import Sides
from dolfinx_llm.finite.obstacles.obstacle_contact import ObstacleFriction
from dolfinx_llm.finite.obstacles.pressed_obstacle import Pressed
from dolfinx_llm.finite.own_laws.law_rows import LawSystem
from dolfinx_llm.finite.own_laws.law_told import ToldContact
from dolfinx_llm.finite.pairs.friction import Friction, tangential
from dolfinx_llm.finite.pairs.friction_contact import FrictionContact
from dolfinx_llm.finite.pairs.normal_contact import NormalContact
from dolfinx_llm.finite.pairs.terms import ContactTerms, Held, moved
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.obstacle import Obstacle
from dolfinx_llm.laws.law import Law
from dolfinx_llm.laws.rows import CLOSED, OPEN, LawNodes

BARE = 1e-9  # area over the largest below which a law is not asked


@dataclass(frozen=True, eq=False)
class LawContact(ToldContact):
    """Contact under a law of one's own; put before contact with friction in the list of bases."""

    settles: ClassVar[bool] = False

    def touching(
        self, place: Any, q: Array, before: Array, held: Held, reach: Array
    ) -> tuple[Array, Held]:
        """(n,) status as the law says, and what is held; arguments as without a law."""
        starts = held.origin is None
        origin = held.origin or self.started(place, held, before != OPEN)
        apart, held = moved(place, -self.gap_drawn), replace(held, origin=origin)
        status, held = super(Friction, self).touching(apart, q, before, held, reach)
        bare = place.areas[0] <= BARE * place.areas[0].max(initial=0.0)
        asked = np.flatnonzero(place.pairs & ~bare)
        status[bare] = OPEN
        if starts:
            self.check_reach(held, asked)
        begun = replace(held, origin=origin)
        if not len(asked):
            return status, begun
        said = self.said(place, q, before, begun, asked)[0]
        pulls = asked[said.holds | (not self.law.opens)]
        status[pulls] = CLOSED
        first = (status != OPEN) & ~origin.touched
        if first.any():
            begun = replace(begun, origin=self.begun(origin, place, first))
        closed = status[asked] != OPEN
        status[asked[closed]] = np.where(said.status == OPEN, CLOSED, said.status)[closed]
        return status, begun

    def terms(self, place: Any, q: Array, status: Array, held: Held, free: Array) -> ContactTerms:
        """All that Newton's iteration asks for; arguments as without a law."""
        (n, gdim), c, gives = place.normal.shape, held.scale, self.law.gives
        supported = np.ones_like(free) if gives else free
        t = super(Friction, self).terms(place, q, status, held, supported)
        at, size = np.flatnonzero(status != OPEN), t.own.shape[0]
        every = bmat([[t.left, t.own]], format="csr")
        if self.law.slips:
            every = bmat([[every, csr_matrix((size, n * gdim))]], format="csr")
        said, tangents = self.said(place, q, status, held, at)
        pull = np.zeros((n, gdim))
        turned, sigma, way = self.turned(place, at), np.zeros((0, gdim)), csr_matrix((0, len(free)))
        if tangents is not None:
            assert held.origin is not None
            pull[at] = tangential(q, n, gdim)[at]
            t = self.dragged(t, place, pull)
            sigma, way = self.way(place, held.origin)
            sigma, way = sigma[at], way[coordinates(at[:, None], gdim).ravel()]
        normal = place.normal[at]
        system = LawSystem(
            every.shape[1], len(free), n, at, said, tangents, normal, turned, pull[at]
        )
        change = system.change(every[at], self.growth(place, at), (sigma, way), self.sign)
        rows, rest, miss = [every[:n], every[n:]], [t.rest.copy()], 0.0
        if gives:
            shut = diagonal(status == OPEN) @ every[:n]
            p = said.left.shape[1]
            rows[0] = shut + summing(at, n) @ change[p - 1 :: p] / c
            rest[0][at] = said.left[:, -1] / c
            miss = float(np.abs(said.left[:, -1]).max(initial=0.0))
        if tangents is not None:
            by, left = system.along(change)
            vectors = np.where((status == OPEN)[:, None], tangential(q, n, gdim), 0.0)
            vectors[at] = left
            idle = diagonal(np.repeat((status == OPEN).astype(float), gdim))
            none = csr_matrix((n * gdim, every.shape[1] - n * gdim))
            rows.append((summing(system.own, n * gdim) @ by + bmat([[none, idle]])) / c)
            rest.append(vectors.ravel() / c)
            miss = max(miss, float(np.abs(left).max(initial=0.0)))
        found = vstack(rows, format="csr")
        return replace(
            t,
            left=found[:, : len(free)],
            own=found[:, len(free) :],
            rest=np.concatenate(rest),
            miss=miss,
            kept=self.keeps(place, q, status, held),
        )


@dataclass(frozen=True, eq=False)
class LawOnFrame(LawContact, FrictionContact):
    """On the moving frame."""

    def along(self, q: Array, status: Array) -> Array:
        return super().along(q, status) if self.law.slips else NormalContact.along(self, q, status)

    @classmethod
    def under(cls, law: Law, nodes: LawNodes, sides: Sides, design: Design, z: Array) -> LawOnFrame:
        """Contact of surfaces drawn at coordinates z (width,).

        Args:
            law: of one's own.
            nodes: of the moving side, with what users give sampled there.
            sides, design, z: of the surfaces.
        """
        meeting = sides.meet(z, sides.candidates(z))
        gap = sides.control[0] @ np.where(meeting.at.met, meeting.at.gap, 0.0)
        nodes = replace(nodes, area=sides.forces(meeting, z, True)[0])
        sides = replace(sides, within=sides.laws_reach)
        return cls(sides, design, *cls.told(sides, law, nodes, gap))


@dataclass(frozen=True, eq=False)
class LawOnObstacle(LawContact, ObstacleFriction):
    """On a rigid obstacle that is moved."""

    @classmethod
    def under(
        cls, law: Law, nodes: LawNodes, surface: Surface, obstacle: Obstacle
    ) -> LawOnObstacle:
        """Contact of a surface, as drawn, with an obstacle where it is now.

        Args:
            law: of one's own.
            nodes: of the surface, with what users give sampled there.
            surface, obstacle: what touches.
        """
        zero = np.zeros(len(surface.x))
        alone = ObstacleFriction.of(surface, obstacle, zero, zero)
        z = surface.x.ravel()
        place = alone.place(z, np.zeros(alone.size), alone.hold(z))
        gap = np.where(place.pairs, place.gap, 0.0)
        told = cls.told(alone.sides, law, replace(nodes, area=place.areas[0]), gap)
        return cls(alone.sides, obstacle, alone.forced, *told)


@dataclass(frozen=True, eq=False)
class LawOnPressed(Pressed, LawOnObstacle):
    """On a rigid obstacle under a force."""

    leans = np.inf  # it may pull

    def _resists(self, place: Any, status: Array, force: Array) -> None:
        if not self.law.slips:  # it says itself what it bears along the surface
            super()._resists(place, status, force)
