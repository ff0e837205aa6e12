"""Contact with friction on the moving frame, by Coulomb's law at the nodes of the moving side.

Beside lambda_p n, (see ``normal_contact``) node p exerts the tangential force tau_p on the frame,

    force on p: -tau_p,   force on the frame's node J: N_pJ tau_p,   |tau_p| <= mu lambda_p + k f_p,

k a cohesion and f_p its area now. Slip is objective: sigma_p = x_p - sum_J N⁰_pJ y_J with the
frozen row N⁰ of the place of the frame where p was at the start of the increment, and what counts
of it lies in the tangent plane of p now. Rows are designed with t·(x_p - sum_J N_pJ y_J) = 0 for
tangents t, so that there is no slip at the start, and none when all turns. A chord it is, not a
way along the frame: the law asks for its direction, and whether there is any, so that this matters
no more than the increment's length does; and the chord is smooth where p slides over several
facets, in 3D as well.

A pair that was open at the start, and is closed by an iterate for the first time, sticks in that
iterate, since lambda is not known there; its slip counts from where the straight way from the start
to that iterate crosses the frame, N⁰ + theta (N - N⁰) with theta = gap⁰ / (gap⁰ - gap). A pair that
is drawn together before it has met anything, so that no body falls, sticks until it has.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.sparse import bmat, csr_matrix, diags

from dolfinx_llm.finite.friction_law import FrictionRows, friction_rows, in_plane, sticks
from dolfinx_llm.finite.jacobians import coordinates, per_item, summing
from dolfinx_llm.finite.normal_contact import NormalContact, NormalPlace
from dolfinx_llm.finite.terms import FAST, ContactTerms, Held, Origin, yields
from dolfinx_llm.laws.rows import CLOSED, OPEN, SLIP, STICK

MET_AT = 1e-9  # gap over facet size at the start that is none
ALMOST = 1e-3  # part of the gap at the start at which a pair has met
COMES_IN = 3.0  # facets beyond the rim from where nodes may come in within an increment


@dataclass(frozen=True, eq=False)
class FrictionContact(NormalContact):
    """Unknowns: those without friction, then a force tau of gdim components per node."""

    settles: ClassVar[bool] = False

    mu: np.ndarray  # (n,) coefficient of friction at the moving side's nodes
    cohesion: np.ndarray  # (n,) [force / area]

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return super().size + self.counts[0] * self.sides.gdim

    @property
    def owner(self) -> np.ndarray:
        """(size,) ranks that own the unknowns."""
        nodes = self.sides.surfaces[self.sides.moving].owner
        return np.concatenate([super().owner, np.repeat(nodes, self.sides.gdim)])

    def touching(
        self,
        place: NormalPlace,
        q: np.ndarray,
        before: np.ndarray,
        held: Held,
        reach: np.ndarray,
    ) -> tuple[np.ndarray, Held]:
        """(n,) status, open, stick or slip, and what is held; arguments as without friction."""
        status, held = super().touching(place, q, before, held, reach)
        origin = held.origin or self._started(place, before != OPEN)
        first = (status == CLOSED) & ~origin.touched
        origin = self._begun(origin, place, first) if first.any() else origin
        closed = np.flatnonzero(status == CLOSED)
        tau, sigma, bound = self._law(place, q, origin, closed)
        stick = sticks(place.normal[closed], tau, sigma, bound, held.scale, before[closed] == SLIP)
        status[closed] = np.where(stick | first[closed], STICK, SLIP)
        return status, replace(held, origin=origin)

    def _started(self, place: NormalPlace, closed: np.ndarray) -> Origin:
        """Where slip counts from, at the start of an increment; nodes beyond the frame's rim lie on
        its continuation, so that one that comes in knows from where."""
        at, (n, m, _) = place.at, self.counts
        outside = np.flatnonzero(at.met & ~place.pairs & (at.beyond < COMES_IN))
        cells, gap = self.sides.facets(False)[at.facet[outside]], place.gap.copy()
        gap[outside] = at.gap[outside]
        k = cells.shape[1]
        continued = csr_matrix(
            (at.N[outside].ravel(), (np.repeat(outside, k), cells.ravel())), (n, m)
        )
        return Origin((place.N + continued).tocsr(), gap, closed)

    def _begun(self, origin: Origin, place: NormalPlace, first: np.ndarray) -> Origin:
        """The same with pairs that are closed for the first time; those that have not met yet, and
        are drawn together, stick until they do."""
        nowhere = ~np.isfinite(origin.gap)
        before = np.where(nowhere | (origin.gap < MET_AT * self.design.size), 0.0, origin.gap)
        left = np.where(first, place.gap, 0.0)
        closing = before - left
        theta = np.where(closing > 0.0, before / np.where(closing > 0.0, closing, 1.0), 1.0)
        theta = np.where(before > 0.0, np.minimum(theta, 1.0), 0.0)
        theta = np.where(first, np.where(nowhere, 1.0, theta), 0.0)
        rows = (diags(1.0 - theta) @ origin.rows + diags(theta) @ place.N).tocsr()
        met = left <= ALMOST * before
        met |= before == 0.0
        return replace(origin, rows=rows, touched=origin.touched | (first & met))

    def _law(
        self, place: NormalPlace, q: np.ndarray, origin: Origin, at: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Forces (k, gdim), ways (k, gdim) and bounds (k,) at pairs (k,)."""
        n, gdim = self.counts[0], self.sides.gdim
        x, y = self.sides.split(place.z)
        tau = q[-n * gdim :].reshape(n, gdim)[at]
        sigma = x[at] - origin.rows[at] @ y
        return tau, sigma, self._bound(place, q)[at]

    def _bound(self, place: NormalPlace, q: np.ndarray) -> np.ndarray:
        """(n,) what friction may reach; nothing where nothing presses [force]."""
        force = q[: len(place.gap)]
        return np.where(force > 0.0, self.mu * force + self.cohesion * place.areas[0], 0.0)

    def terms(
        self, place: NormalPlace, q: np.ndarray, status: np.ndarray, held: Held, free: np.ndarray
    ) -> ContactTerms:
        """All that Newton's iteration asks for; arguments as without friction."""
        assert held.origin is not None  # ``touching`` comes first
        t = super().terms(place, q, status, held, free)
        (n, m, c), gdim = self.counts, self.sides.gdim
        closed = np.repeat(status != OPEN, gdim)
        tau = np.where(closed, q[-n * gdim :], 0.0)
        on_tau = diags(closed.astype(float)) @ self.sides.jumps(place.N)
        spread = place.spread(-tau.reshape(n, gdim)[place.on])
        by_place, by_mu = place.entries
        no = csr_matrix((self.sides.width, n)), csr_matrix((self.sides.width, c))
        top = t.top - bmat([[no[0], spread @ by_mu, no[1]]])
        law, by_z, by_lambda, slip = self._equations(place, q, status, held, free)
        by_q = bmat([[by_lambda, csr_matrix((n * gdim, m + c))]])
        by_tau = np.broadcast_to(np.eye(gdim) / held.scale, (n, gdim, gdim)).copy()
        rest = q[-n * gdim :].reshape(n, gdim) / held.scale
        by_tau[status != OPEN], rest[status != OPEN] = law.by_force, law.rest
        return replace(
            t,
            force=t.force - on_tau.T @ tau,
            K=(t.K - spread @ by_place).tocsr(),
            top=bmat([[top, on_tau.T]], format="csr"),
            left=bmat([[t.left], [by_z]], format="csr"),
            own=bmat([[t.own, None], [by_q, per_item(by_tau)]], format="csr"),
            rest=np.concatenate([t.rest, rest.ravel()]),
            friction=-(on_tau.T @ tau),
            slip=slip,
            miss=float(np.abs(rest[status == SLIP]).max(initial=0.0) * held.scale),
        )

    def _equations(
        self,
        place: NormalPlace,
        q: np.ndarray,
        status: np.ndarray,
        held: Held,
        free: np.ndarray,
    ) -> tuple[FrictionRows, csr_matrix, csr_matrix, np.ndarray]:
        """The law at closed pairs, its derivatives (n gdim, width) and (n gdim, n) by coordinates
        and lambda, and the slip (n, gdim)."""
        n, gdim, origin = self.counts[0], self.sides.gdim, held.origin
        assert origin is not None
        closed = np.flatnonzero(status != OPEN)
        pick = summing(coordinates(closed[:, None], gdim).ravel(), n * gdim)
        normal, (tau, sigma, bound) = place.normal[closed], self._law(place, q, origin, closed)
        way = pick.T @ self.sides.jumps(origin.rows)
        moves = np.asarray(way.multiply(way) @ free.astype(float)).reshape(-1, gdim)
        stick = status[closed] == STICK
        axes = np.broadcast_to(np.eye(gdim), (len(closed), gdim, gdim))
        supports = moves < FAST**2, yields(axes, self.sides.split(free)[0][closed], held)
        law = friction_rows(normal, tau, sigma, bound, held.scale, stick, *supports)
        among = coordinates(np.flatnonzero(status[place.on] != OPEN)[:, None], gdim).ravel()
        pressed = (q[closed] > 0.0).astype(float)
        by_bound = per_item(law.by_bound[:, :, None] * pressed[:, None, None])
        by_z = per_item(law.by_slip) @ way + per_item(law.by_normal) @ place.turned[among]
        by_z = by_z + by_bound @ (diags(self.cohesion[closed]) @ place.by_z[0][closed])
        by_lambda = by_bound @ diags(self.mu[closed]) @ summing(closed, n).T
        slip = np.zeros((n, gdim))
        slip[closed] = in_plane(normal, sigma)
        return law, pick @ by_z, pick @ by_lambda, slip
