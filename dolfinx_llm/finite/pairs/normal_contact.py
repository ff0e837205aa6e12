"""Frictionless contact on the moving frame: forces, gaps and their full derivative.

With a force lambda_p that pair p carries, n its normal out of the frame's body, N its designed row,

    force on p: lambda_p n,   force on the frame's node J: -N_pJ lambda_p n,
    gap_p = n·(x_p - sum_J N_pJ y_J) - s_p,   gap >= 0, lambda >= 0, their product 0,

s how far a curved frame stands out beyond its facets, and what rows miss of it: see ``curved_gap``.
At second order gaps and lambda are those of control values, of C gap and C^T lambda at the nodes:
see ``sides``; those of facets that hang over an end of the frame are of the covered part: C stands
for S C, see ``overhang``.

These forces are the first term of (19), Q: ``force`` of ``terms``. The second one, Phi, has the
derivatives of base and interpolation times lambda·(x - sum N y). Rows keep t·(x - sum N y) = 0:
what is left is (gap + s) n, and gap lambda = 0 at the solution, so that it vanishes in the residual
but for s, which is of the order of the facets' size squared: along n it has no moment, and for
friction ``couples`` have it. Its derivative does not vanish; it stands in ``gap_z`` and ``gap_mu``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.sparse import bmat, csr_matrix, hstack, vstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, per_item, summing
from dolfinx_llm.design.rises import rises
from dolfinx_llm.finite.frame.chart import borne_by, chart_of
from dolfinx_llm.finite.frame.curved_gap import raised, rounded_gap
from dolfinx_llm.finite.frame.design import Design, DesignedRows
from dolfinx_llm.finite.frame.design_loads import balanced_loads
from dolfinx_llm.finite.frame.jacobians import coordinates, jacobian
from dolfinx_llm.finite.frame.location import OnFrame
from dolfinx_llm.finite.frame.overhang import overhang
from dolfinx_llm.finite.frame.sides import Meeting, Sides
from dolfinx_llm.finite.pairs.slides import SlidesOnFrame
from dolfinx_llm.finite.pairs.terms import ContactTerms, Held, Place, held_fast, yields
from dolfinx_llm.laws.rows import OPEN

OVER = 0.05  # of a facet beyond the frame's edge, at which a node has left it


@dataclass(frozen=True, eq=False)
class NormalPlace(Place):
    """Pairs on the moving frame, with derivatives; k of the n nodes are there, s entries a row."""

    grown: csr_matrix  # (n, width) derivative of the pairs' areas
    loads: tuple[Array, Array]  # (n,), (m,) at nodes: see ``design_loads``
    loads_by: tuple[csr_matrix, csr_matrix]  # (n, width), (m, width) their derivatives
    at: OnFrame  # of all n nodes
    on: Array  # (k,) nodes that are there
    rows: DesignedRows
    entries: tuple[csr_matrix, csr_matrix]  # (k s, width), (k s, m): rows by positions and by mu
    whole: csr_matrix  # (k s, width) those for which (28) holds by positions
    height: Array  # (k, s) n·(y_J - x_p) [length]
    C: csr_matrix  # (k, k) of these nodes, S C where facets hang over
    cut: csr_matrix  # (k, width) derivative of the gaps by places where facets are cut
    turned: csr_matrix  # (k gdim, width) derivative of the normals [1 / length]
    curved: Array  # (k,) part of the gap that the frame itself tells, not rows
    by_frame: csr_matrix  # (k, width) its derivative
    coordinates: Array  # (k, (s + 1) gdim) numbers of the coordinates of p and of all J

    def spread(self, force: Array) -> csr_matrix:
        """(width, k s) change of forces on the coordinates for changes of the rows.

        Args:
            force: (k, gdim) on the nodes [force].
        """
        k, s = self.rows.nodes.shape
        gdim = force.shape[1]
        values = -np.broadcast_to(force[:, None], (k, s, gdim)).ravel()
        at = self.coordinates[:, gdim:].ravel(), np.repeat(np.arange(k * s), gdim)
        return csr_matrix((values, at), (len(self.z), k * s))

    def swung(self, force: Array) -> csr_matrix:
        """(width, width) change of normal forces (k,) on the coordinates where normals turn."""
        (k, s), gdim = self.rows.nodes.shape, self.normal.shape[1]
        weights = np.concatenate([np.ones((k, 1)), -self.rows.N], axis=1) * force[:, None]
        normals = coordinates(np.arange(k)[:, None].repeat(s + 1, axis=1), gdim)
        at, shape = (self.coordinates.ravel(), normals.ravel()), (len(self.z), k * gdim)
        return csr_matrix((weights.repeat(gdim, axis=1).ravel(), at), shape) @ self.turned

    @cached_property
    def gap_by(self) -> tuple[csr_matrix, csr_matrix]:
        """(k, width), (k, m) derivatives of the gaps by positions and mu."""
        part = diagonal(1.0 - self.curved)
        by_z = self.C @ (part @ self.distance[1] + self.by_frame) + self.cut
        return by_z, self.C @ part @ self.distance[2]

    @cached_property
    def distance(self) -> tuple[csr_matrix, csr_matrix, csr_matrix]:
        """(k, width) that n·(dx_p - sum_J N_pJ dy_J) is of changes dz, and the whole derivatives of
        n·(x_p - sum_J N_pJ y_J), (k, width) and (k, m), by positions and mu."""
        normal, nodes = self.normal[self.on], self.rows.nodes
        on_y = -self.rows.N[:, :, None] * normal[:, None]
        on_y = on_y.reshape(len(nodes), 1, nodes.shape[1] * normal.shape[1])
        along = np.concatenate([normal[:, None], on_y], axis=2)
        A, lean = jacobian(along, self.coordinates, len(self.z)), per_item(-self.height[:, None])
        return A, A + lean @ self.entries[0], lean @ self.entries[1]


@dataclass(frozen=True, eq=False)
class NormalContact(SlidesOnFrame):
    """Unknowns: a force per node of the moving side, mu per frame node, kappa."""

    sides: Sides
    design: Design
    cuts: ClassVar[bool] = True  # pairs of facets that hang over are of their covered parts

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return sum(self.counts)

    @property
    def counts(self) -> tuple[int, int, int]:
        """Numbers of forces, mu and kappa."""
        mover, carrier = self.sides.mover, self.sides.carrier
        return len(mover.x), len(carrier.x), len(self.design.soft)

    @property
    def owner(self) -> Array:
        first = np.zeros(self.counts[2], dtype=np.int64)
        return np.concatenate([self.sides.mover.owner, self.sides.carrier.owner, first])

    @cached_property
    def rises(self) -> tuple[Array, Array] | None:
        """(n,) and (m,) of nodes of the moving side and of the frame; None: there are none."""
        sides = self.sides
        found = rises(sides.mover), rises(sides.carrier)
        return found if any(rise.any() for rise in found) else None

    def hold(self, z: Array) -> Held:
        """What is held in a load step that starts at coordinates z."""
        candidates = self.sides.candidates(z)
        meeting = self.sides.meet(z, candidates)
        f = self.sides.forces(meeting, z, True)[0]
        return Held(candidates, f > 0.0, self._chart(meeting, z), np.zeros(len(f), dtype=bool))

    def missed(self, place: NormalPlace, held: Held) -> Held | None:
        """The same with facets that have passed the frame since the start, without pairs that have
        left it over its edge; None: there are none.

        Args:
            place: at an equilibrium.
            held: from the start of the step.
        """
        now = self.sides.candidates(place.z)
        added, at = now & ~held.candidates, place.at
        left = held.pairs & ~held.left & (place.areas[0] <= 0.0) & (at.beyond > OVER)
        if not (added.any() and (at.gap[self.sides.mover.facets[added]] < 0.0).any()):
            added[:] = False
        if not (added.any() or left.any()):
            return None
        found = replace(held, candidates=held.candidates | added, left=held.left | left)
        found = replace(found, pairs=held.pairs & ~left)
        meeting = self.sides.meet(place.z, found.candidates)
        return replace(found, chart=self._chart(meeting, place.z))

    def _chart(self, meeting: Meeting, z: Array) -> Array:
        """Of the design, for what is covered of the frame where surfaces meet at z (width,)."""
        covered = self.sides.control[1].T @ self.sides.forces(meeting, z, False)[0]
        return chart_of(self.sides.carrier, covered)

    def place(self, z: Array, q: Array, held: Held) -> NormalPlace:
        """Pairs, rows and gaps with derivatives: what does not depend on forces.

        Args:
            z: (width,) coordinates [length].
            q: own unknowns.
            held: from the start of the step.
        """
        sides, gdim, (n, m, _) = self.sides, self.sides.gdim, self.counts
        x, y = sides.split(z)
        meeting = sides.meet(z, held.candidates)
        f, grown = sides.forces(meeting, z, True)
        on = np.flatnonzero(((f > 0.0) | held.pairs) & meeting.at.met)
        at, d = meeting.at.part(on), meeting.d.part(on, gdim)
        columns = sides.columns[0][on], sides.columns[1]
        loads, by_loads = balanced_loads(sides, meeting, z, (f, grown))
        rows = self.design.rows(at, x[on], y, (loads[0][on], loads[1]), held.chart)
        by_place, by_mu, by_whole = self.design.derivatives(rows, at, d, columns, sides.width)
        if held.lagged:
            by_place = by_whole = csr_matrix(by_place.shape)
            grown = csr_matrix(grown.shape)
            by_loads = grown, csr_matrix(by_loads[1].shape)
        height = np.einsum("nsi,ni->ns", y[rows.nodes] - x[on][:, None], at.normal)
        pick, reached = summing(on, n), coordinates(rows.nodes, gdim, columns[1])
        gap, normal = np.full(n, np.inf), np.zeros((n, gdim))
        of_frame = y, sides.carrier.cells, meeting.normals, sides.rounded
        by_rows = -np.einsum("ns,ns->n", rows.N, height)
        numbers = (*columns, sides.width)
        to_frame, curved, by_frame = rounded_gap(at, d, *of_frame, numbers, by_rows)
        if self.rises is not None:
            own, of_facets = self.rises[0][on], self.rises[1][sides.carrier.cells[at.facet]]
            less, less_z = raised(at, d, of_facets, own)
            to_frame, by_frame = to_frame - less, by_frame - less_z
        C, cut = sides.control[0], csr_matrix((len(on), sides.width))
        N = pick @ C[on][:, on] @ rows.matrix(m)
        over = overhang(sides, z, held.candidates) if self.cuts and not sides.prescribed else None
        if over is not None:
            over = over.as_if_fixed() if held.lagged else over
            cut, C = over.change(C @ pick @ to_frame)[on], (over.S @ C).tocsr()
        C, whole = C[on][:, on], np.diff(C.indptr)[on]
        there = np.diff(C.indptr) == whole  # and all that its gap is made of
        gap[on], normal[on] = np.where(there, C @ to_frame, np.inf), at.normal
        return NormalPlace(
            z=z,
            gap=gap,
            normal=normal,
            N=N,
            overhang=over,
            C=C,
            cut=cut,
            areas=(f, loads[1]),
            grown=grown,
            loads=loads,
            loads_by=by_loads,
            at=meeting.at,
            on=on,
            rows=rows,
            entries=(by_place, by_mu),
            whole=by_whole,
            height=height,
            turned=d.normal,
            curved=curved,
            by_frame=by_frame,
            coordinates=np.concatenate([columns[0], reached], axis=1),
        )

    def nearing(self, place: NormalPlace, dz: Array, dq: Array) -> Array:
        (n, m, _), (by_z, by_mu) = self.counts, place.gap_by
        return summing(place.on, n) @ (by_z @ dz + by_mu @ dq[n : n + m])

    def along(self, q: Array, status: Array) -> Array:
        """(n, gdim) forces of pairs along the surface, which rows spread as well [force]."""
        return np.zeros((len(status), self.sides.gdim))

    def terms(
        self, place: NormalPlace, q: Array, status: Array, held: Held, free: Array
    ) -> ContactTerms:
        """All that Newton's iteration asks for.

        Args:
            place: in this configuration.
            q: own unknowns, the first (n,) lambda of all nodes of the moving side [force].
            status: (n,) of these.
            held: from the start of the step.
            free: (width,) coordinates that are not prescribed.
        """
        (n, m, c), sides = self.counts, self.sides
        on, rows, normal, active = place.on, place.rows, place.normal[place.on], status != OPEN
        (by_place, by_mu), (df, dfy), f = place.entries, place.loads_by, place.loads[0]
        k, s = rows.nodes.shape
        width, force, control = sides.width, q[:n], self.design.control
        A, (gap_z, gap_mu) = place.C @ place.distance[0], place.gap_by  # A: the force row
        # Forces, and how they change.
        borne = np.where(active[on], force[on], 0.0)
        lam = place.C.T @ borne  # at the nodes
        along = sides.control[0][:, on].T @ self.along(q, status)
        spread = place.spread(lam[:, None] * normal - along)
        K = -(spread @ by_place + place.swung(lam))
        if place.overhang is not None:
            parted = place.overhang.change_of_forces((summing(on, n) @ borne)[:, None])
            K = K - place.distance[0].T @ (sides.control[0].T @ parted)[on]
        # Equation (28), which gives mu.
        entries = rows.nodes.ravel(), np.arange(k * s)
        by_entry = csr_matrix((np.repeat(f[on], s), entries), (m, k * s))
        of_frame = borne_by(control, 1.0 + rows.left) @ dfy
        balance_z = by_entry @ place.whole + rows.matrix(m, whole=True).T @ df[on] - of_frame
        border_z = csr_matrix(held.chart.T @ borne_by(control, rows.mu)) @ dfy
        closed = active[on] & ~held_fast(A, free)
        by_closed = summing(on, n) @ diagonal(closed)
        idle, rest = np.full(n, 1.0 / held.scale), force / held.scale
        own = yields(normal[closed][:, None], sides.moves(free)[on[closed]], held)
        idle[on[closed]], rest[on[closed]] = own.ravel(), place.gap[on[closed]]
        G, none = csr_matrix(rows.G), csr_matrix((width, c))
        return ContactTerms(
            force=A.T @ borne,
            K=K,
            top=hstack([-(by_closed @ A).T.tocsr(), -(spread @ by_mu), none], format="csr"),
            left=vstack([by_closed @ gap_z, balance_z, border_z], format="csr"),
            own=bmat(
                [
                    [diagonal(idle), by_closed @ gap_mu, csr_matrix((n, c))],
                    [csr_matrix((m, n)), -rows.M, -G],
                    [csr_matrix((c, n)), G.T.tocsr(), diagonal(-self.design.soft)],
                ],
                format="csr",
            ),
            rest=np.concatenate([rest, np.zeros(m + c)]),
            place=place,
            delta=float(np.abs(rows.delta).max(initial=0.0)),
            status=status,
            friction=np.zeros(width),
        )
