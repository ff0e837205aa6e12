"""Coulomb's law at the nodes of a surface, beside whatever presses them: a frame, an obstacle.

Beside lambda_p n, node p exerts the tangential force tau_p on what it touches,

    force on p: -tau_p,   |tau_p| <= mu lambda_p + k f_p,

k a cohesion and f_p its area now. Slip is that of ``slides``, a chord: the law asks for its
direction, and whether there is any, so that this matters no more than the increment's length does.

A pair that was open at the start, and is closed by an iterate for the first time, sticks in that
iterate, since lambda is not known there but where the linear model has closed it before. A pair
that is drawn together before it has met anything, so that no body falls, sticks until it has.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy.sparse import bmat, csr_matrix, hstack, vstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, per_item, summing
from dolfinx_llm.finite.frame.jacobians import coordinates
from dolfinx_llm.finite.pairs.friction_law import FrictionRows, friction_rows, sticks
from dolfinx_llm.finite.pairs.slides import Slides
from dolfinx_llm.finite.pairs.terms import (
    FAST,
    ContactTerms,
    Held,
    MovingContact,
    Origin,
    shares,
    yields,
)
from dolfinx_llm.laws.rows import CLOSED, OPEN, SLIP, STICK


@dataclass(frozen=True, eq=False)
class Friction(Slides):
    """Unknowns: those without friction, then a force tau of gdim components per node.

    Put before the contact without friction in the list of bases.
    """

    pressed: ClassVar[tuple[int, ...]] = (STICK, SLIP)

    mu: Array  # (n,) coefficient of friction at the moving side's nodes
    cohesion: Array  # (n,) [force / area]

    def reading(self, given: dict[str, Array]) -> MovingContact:
        now = given["mu"], given["cohesive"]
        if all(map(np.array_equal, now, (self.mu, self.cohesion))):
            return self
        return replace(self, mu=now[0], cohesion=now[1])

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return super().size + self.sides.mover.x.size

    @property
    def owner(self) -> Array:
        nodes = self.sides.mover.owner
        return np.concatenate([super().owner, np.repeat(nodes, self.sides.gdim)])

    def carried(self, q: Array, R: Array) -> Array:
        tau = self.sides.mover.x.size
        return np.concatenate([q[:-tau], (q[-tau:].reshape(-1, len(R)) @ R.T).ravel()])

    def started(self, place: Any, held: Held, closed: Array) -> Origin:
        return replace(super().started(place, held, closed), drags=True)

    def turned(self, place: Any, nodes: Array) -> csr_matrix:
        """(k gdim, width) derivatives of the normals of nodes (k,) in contact [1 / length]."""
        raise NotImplementedError

    def growth(self, place: Any, nodes: Array) -> csr_matrix:
        """(k, width) derivatives of the areas of nodes (k,) [area / length]."""
        raise NotImplementedError

    def supported(self, place: Any, closed: Array, way: csr_matrix, free: Array) -> Array:
        """(k, gdim) components of the slip of pairs ``closed`` (k,), of which ``way`` (k gdim,
        width) is the derivative, that supports prescribe on both sides."""
        moves = np.asarray(way.multiply(way) @ free.astype(float))
        return moves.reshape(-1, self.sides.gdim) < FAST**2

    def touching(
        self, place: Any, q: Array, before: Array, held: Held, reach: Array
    ) -> tuple[Array, Held]:
        """(n,) status, open, stick or slip, and what is held; arguments as without friction."""
        touched = before != OPEN if held.origin is None else held.origin.touched
        status, held = super().touching(place, q, before, held, reach)
        assert held.origin is not None
        first, closed = (status == CLOSED) & ~touched, np.flatnonzero(status == CLOSED)
        tau, bound = (values[closed] for values in self._forces(place, q))
        sigma = self.way(place, held.origin)[0][closed]
        stick = sticks(place.normal[closed], tau, sigma, bound, held.scale, before[closed] == SLIP)
        stick |= (first & (before == OPEN))[closed]
        status[closed] = np.where(stick, STICK, SLIP)
        return status, replace(held, exact=held.near and (status == before).all())

    def _forces(self, place: Any, q: Array) -> tuple[Array, Array]:
        """(n, gdim) tau, and (n,) what it may reach; nothing where nothing presses [force]."""
        n, gdim = place.normal.shape
        bears = self.mu * q[:n] + self.cohesion * place.areas[0]
        return tangential(q, n, gdim), np.where(q[:n] > 0.0, bears, 0.0)

    def dragged(self, t: ContactTerms, place: Any, tau: Array) -> ContactTerms:
        """Terms of what presses, with tau (n, gdim), 0 at open pairs, as well: forces on the
        coordinates and their derivatives."""
        gdim = tau.shape[1]
        closed = np.repeat(t.status != OPEN, gdim)
        on_tau = diagonal(closed) @ self.sides.jumps(place.N)
        force = -(on_tau.T @ tau.ravel())
        top = hstack([t.top, on_tau.T.tocsr()], format="csr")
        return replace(t, force=t.force + force, top=top, friction=force)

    def terms(self, place: Any, q: Array, status: Array, held: Held, free: Array) -> ContactTerms:
        """All that Newton's iteration asks for; arguments as without friction."""
        assert held.origin is not None  # ``touching`` comes first
        n, gdim = place.normal.shape
        tau = np.where((status != OPEN)[:, None], tangential(q, n, gdim), 0.0)
        t = self.dragged(super().terms(place, q, status, held, free), place, tau)
        law, by_z, by_lambda = self._equations(place, q, status, held, free)
        size, none = t.own.shape[1], csr_matrix((t.own.shape[0], n * gdim))
        by_q = hstack([by_lambda, csr_matrix((n * gdim, size - n))], format="csr")
        by_tau = np.broadcast_to(np.eye(gdim) / held.scale, (n, gdim, gdim)).copy()
        rest = tangential(q, n, gdim) / held.scale
        by_tau[status != OPEN], rest[status != OPEN] = law.by_force, law.rest
        return replace(
            t,
            left=vstack([t.left, by_z], format="csr"),
            own=bmat([[t.own, none], [by_q, per_item(by_tau)]], format="csr"),
            rest=np.concatenate([t.rest, rest.ravel()]),
            miss=float(np.abs(rest[status == SLIP]).max(initial=0.0) * held.scale),
        )

    def _equations(
        self, place: Any, q: Array, status: Array, held: Held, free: Array
    ) -> tuple[FrictionRows, csr_matrix, csr_matrix]:
        """The law at closed pairs, its derivatives (n gdim, width) and (n gdim, n) by coordinates
        and lambda."""
        n, gdim = place.normal.shape
        assert held.origin is not None
        closed = np.flatnonzero(status != OPEN)
        pick = summing(coordinates(closed[:, None], gdim).ravel(), n * gdim)
        here = [values[closed] for values in self._forces(place, q)]
        sigma, way = self.way(place, held.origin)
        normal, sigma, way = place.normal[closed], sigma[closed], pick.T @ way
        tau, bound, about, then = *here, sigma, q
        if held.about is not None:
            then = held.about[1]
            tau, bound = (values[closed] for values in self._forces(place, then))
            about = sigma + (way @ held.about[0]).reshape(sigma.shape)
        supported = self.supported(place, closed, way, free)
        stick = status[closed] == STICK
        axes = np.broadcast_to(np.eye(gdim), (len(closed), gdim, gdim))
        yielding = yields(axes, self.sides.moves(free)[closed], held)
        supports = supported, yielding + shares(closed, gdim, held)
        law = friction_rows(normal, tau, about, bound, held.scale, stick, *supports, held.exact)
        law = law.moved(here[0] - tau, sigma - about, here[1] - bound)
        pressed = (then[closed] > 0.0).astype(float)
        by_bound = per_item(law.by_bound[:, :, None] * pressed[:, None, None])
        by_z = per_item(law.by_slip) @ way + per_item(law.by_normal) @ self.turned(place, closed)
        if self.cohesion.any():
            by_z = by_z + by_bound @ (diagonal(self.cohesion[closed]) @ self.growth(place, closed))
        by_lambda = by_bound @ diagonal(self.mu[closed]) @ summing(closed, n).T
        return law, pick @ by_z, pick @ by_lambda


def tangential(q: Array, n: int, gdim: int) -> Array:
    """(n, gdim) forces tau along the surface, the last of the unknowns [force]."""
    return q[-n * gdim :].reshape(n, gdim)
