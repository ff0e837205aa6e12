"""Frictionless contact on the moving frame: forces, gaps and their full derivative.

With a force lambda_p that pair p carries, n its normal out of the frame's body, N its designed row,

    force on p: lambda_p n,   force on the frame's node J: -N_pJ lambda_p n,
    gap_p = n·(x_p - sum_J N_pJ y_J),   gap >= 0, lambda >= 0, their product 0.

These forces are the first term of (19), Q: ``force`` of ``terms``. The second one, Phi, has the
derivatives of base and interpolation times lambda·(x - sum N y). Rows keep t·(x - sum N y) = 0:
what is left is gap n, and gap lambda = 0 at the solution, so that it vanishes in the residual. Its
derivative does not; it stands in ``gap_z`` and ``gap_mu``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import bmat, csr_matrix, diags

from dolfinx_llm.finite.design import Design
from dolfinx_llm.finite.jacobians import coordinates, jacobian, per_item, summing
from dolfinx_llm.finite.sides import Sides
from dolfinx_llm.finite.terms import ContactTerms, Held, held_fast

CLOSE = 1e-11  # gap over facet size that is none


@dataclass(frozen=True, eq=False)
class NormalContact:
    """Unknowns: a force per node of the moving side, mu per frame node, kappa."""

    sides: Sides
    design: Design

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return sum(self.counts)

    @property
    def counts(self) -> tuple[int, int, int]:
        """Numbers of forces, mu and kappa."""
        surfaces, frame = self.sides.surfaces, self.sides.frame
        return len(surfaces[1 - frame].x), len(surfaces[frame].x), self.sides.gdim

    @property
    def owner(self) -> np.ndarray:
        """(size,) ranks that own the unknowns."""
        surfaces, frame = self.sides.surfaces, self.sides.frame
        first = np.zeros(self.sides.gdim, dtype=np.int64)
        return np.concatenate([surfaces[1 - frame].owner, surfaces[frame].owner, first])

    def touching(self, terms: ContactTerms, q: np.ndarray, scale: float, size: float) -> np.ndarray:
        """(n,) which pairs are in contact: lambda - scale gap > 0.

        Args:
            terms: in this configuration.
            q: own unknowns.
            scale: stiffness [force / length].
            size: of facets; pairs closer than ``CLOSE`` of it touch [length].
        """
        force = q[: len(terms.pairs)]
        gap = np.where(terms.pairs, terms.gap, 0.0)
        return terms.pairs & (force / scale - gap > -CLOSE * size)

    def hold(self, z: np.ndarray) -> Held:
        """What is held in a load step that starts at coordinates z."""
        candidates = self.sides.candidates(z)
        meeting = self.sides.meet(z, candidates)
        f = [self.sides.forces(meeting, z, moving)[0] for moving in (True, False)]
        on = np.flatnonzero((f[0] > 0.0) & meeting.at.met)
        if not len(on):
            return Held(candidates, f[0] > 0.0, 0.0)
        x, y = self.sides.split(z)
        limit = self.design.smallest_limit(meeting.at.part(on), x[on], y, (f[0][on], f[1]))
        return Held(candidates, f[0] > 0.0, limit)

    def missed(self, z: np.ndarray, held: Held) -> np.ndarray | None:
        """(f,) candidates with those that have passed the frame since the start, if there are any.

        Args:
            z: coordinates of an equilibrium [length].
            held: from the start of the step.
        """
        now = self.sides.candidates(z)
        added = now & ~held.candidates
        if not added.any() or not (self.sides.gaps(z)[self.sides.facets(True)[added]] < 0.0).any():
            return None
        return now | held.candidates

    def terms(
        self, z: np.ndarray, q: np.ndarray, active: np.ndarray, held: Held, free: np.ndarray
    ) -> ContactTerms:
        """All that Newton's iteration asks for.

        Args:
            z: (width,) coordinates [length].
            q: own unknowns, the first (n,) lambda of all nodes of the moving side [force].
            active: (n,) which of them are in contact.
            held: from the start of the step.
            free: (width,) coordinates that are not prescribed.
        """
        sides, (n, m, c) = self.sides, self.counts
        gdim, width, force = sides.gdim, sides.width, q[:n]
        x, y = sides.split(z)
        meeting = sides.meet(z, held.candidates)
        (f, df), (fy, dfy) = (sides.forces(meeting, z, moving) for moving in (True, False))
        on = np.flatnonzero(((f > 0.0) | held.pairs) & meeting.at.met)
        at, d = meeting.at.part(on), meeting.d.part(on, gdim)
        columns = sides.columns[0][on], sides.columns[1]
        pick = summing(on, n)
        rows = self.design.rows(at, x[on], y, (f[on], fy), held.limit)
        by_place, by_mu = self.design.derivatives(rows, at, d, columns, width)
        normal, (k, s) = at.normal, rows.nodes.shape
        # Gap, and how it changes.
        arm = y[rows.nodes] - x[on][:, None]
        height = np.einsum("nsi,ni->ns", arm, normal)
        gap = -np.einsum("ns,ns->n", rows.N, height)
        along = np.concatenate(
            [normal[:, None], -(rows.N[:, :, None] * normal[:, None]).reshape(k, 1, -1)], axis=2
        )
        places = np.concatenate([columns[0], coordinates(rows.nodes, gdim, columns[1])], axis=1)
        lean = per_item(-height[:, None])  # (k, k s)
        A = jacobian(along, places, width)  # (k, width): the force row
        gap_z, gap_mu = A + lean @ by_place, lean @ by_mu
        # Forces, and how they change.
        lam = np.where(active[on], force[on], 0.0)
        total = A.T @ lam
        at_frame = coordinates(rows.nodes, gdim, columns[1]).reshape(k, s, gdim)
        spread = csr_matrix(  # (width, k s): force at nodes for changes of N
            (
                -(lam[:, None, None] * np.broadcast_to(normal[:, None], (k, s, gdim))).ravel(),
                (at_frame.ravel(), np.repeat(np.arange(k * s), gdim)),
            ),
            (width, k * s),
        )
        unit = np.eye(gdim)
        weights = np.concatenate([np.ones((k, 1)), -rows.N], axis=1) * lam[:, None]
        turned = (weights[:, :, None, None] * unit).reshape(k, (s + 1) * gdim, gdim)
        gather = summing(places.ravel(), width)
        K = -(spread @ by_place + gather @ (per_item(turned) @ d.normal))
        force_mu = spread @ by_mu
        # Equation (28), which gives mu.
        by_entry = csr_matrix(
            (np.repeat(f[on], s), (rows.nodes.ravel(), np.arange(k * s))), (m, k * s)
        )
        N = rows.matrix(m)
        balance_z = by_entry @ by_place + N.T @ df[on] - diags(1.0 + rows.left) @ dfy
        border_z = csr_matrix(self.design.chart * rows.mu[:, None]).T @ dfy
        closed = active[on] & ~held_fast(A, free)
        by_closed = pick @ diags(closed.astype(float))
        idle = np.ones(n)
        idle[on[closed]] = 0.0
        G = csr_matrix(rows.G)
        rest = np.where(idle > 0.0, force, 0.0)
        rest[on[closed]] = gap[closed]
        all_gaps = np.full(n, np.inf)
        all_gaps[on] = gap
        directions = np.zeros((n, gdim))
        directions[on] = normal
        zero = csr_matrix((width, c))
        return ContactTerms(
            force=total,
            K=K.tocsr(),
            top=bmat([[-(by_closed @ A).T, -force_mu, zero]], format="csr"),
            left=bmat([[by_closed @ gap_z], [balance_z], [border_z]], format="csr"),
            own=bmat(
                [
                    [diags(idle), by_closed @ gap_mu, None],
                    [None, -rows.M, -G],
                    [csr_matrix((c, n)), G.T, csr_matrix((c, c))],
                ],
                format="csr",
            ),
            rest=np.concatenate([rest, np.zeros(m + c)]),
            gap=all_gaps,
            normal=directions,
            N=(pick @ N).tocsr(),
            areas=(f, fy),
            pairs=np.isfinite(all_gaps),
            active=active,
            delta=float(np.abs(rows.delta).max(initial=0.0)),
        )
