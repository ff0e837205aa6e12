"""Rows of nodes on the moving frame, corrected so that a constant pressure passes there, (28).

Row p is N_p = N(xi_p) + delta_p with the smallest corrections, weighted by w_p = N⁺(xi_p) A (A:
which nodes share a facet) so that they vary continuously with the place of p, for which

    sum_J delta_pJ = 0, sum_J delta_pJ t·y_J = 0 for tangents t at p    (forces and moments stay),
    on second-order frames sum_J delta_pJ t·(y_J - x_p) s·(y_J - x_p) = 0    (so do curved places),
    sum_p N_pJ f_p - f_J = (G kappa)_J, Gᵀ mu = 0                       (28).

With W = diag(w_p), C the rows (1, t·(y - x_p) / h), S = C W Cᵀ and one mu per frame node

    delta_p = -P_p mu,   P_p = W - W Cᵀ S⁻¹ C W.

f_p and f_J are of the same area: see ``design_loads``. G are forces of affine pressures, in
coordinates on the frame as drawn, of second order there as well, where f_J are those of unit
pressure: what of the residual no correction can remove, since both surfaces carry the same force
about the same place (rounding on flat ones).

Of corrections beyond what a row bears a part c_p is taken, N_p = N(xi_p) + c_p delta_p: each row
tells it by itself, smoothly, so that rows follow from positions alone, wherever increments begin,
and no kink is left, across which there may be no equilibrium. What (28) lacks by it stays near: at
rims that are covered poorly, or where a frame bends.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, per_item
from dolfinx_llm.design.stencils import adjacency
from dolfinx_llm.finite.frame.chart import bordered, borne, products, yielding
from dolfinx_llm.finite.frame.jacobians import coordinates, jacobian
from dolfinx_llm.finite.frame.location import LocationDerivatives, OnFrame
from dolfinx_llm.geometry.cells import connected
from dolfinx_llm.geometry.element import Element, element_of
from dolfinx_llm.geometry.loads import assembled
from dolfinx_llm.geometry.overlap_flat import local_bases
from dolfinx_llm.geometry.pairs import control_of

CORRECTED = 0.4  # correction of an entry that a row bears
RAISED = 1.7e-3  # by which corrections may move its place along the normal, over facet size, in 2D
BORNE_WHOLE = 0.75  # of that, up to which they are borne whole
UNREACHED = 1e-12  # diagonal entry of M over the largest, of nodes that no row reaches
FAINT = 1e-10  # added to it, over the largest: for parts of a frame that share no row with others
UNDESIGNED = 1e12  # the same, where rows stay as they are


@dataclass(frozen=True, eq=False)
class Stencils:
    """Per facet of a frame the nodes that rows of places on it reach; constant."""

    nodes: Array  # (f, s) numbers; the last are repeated where there are fewer
    window: Array  # (f, k, s) A: 1 where J shares a facet with the facet's node K, or is it
    own: Array  # (f, k, s) 1 where the stencil's node is the facet's node

    @classmethod
    def of(cls, facets: Array, m: int) -> Stencils:
        """Stencils of a frame of m nodes with facets (f, k)."""
        f, k = facets.shape
        incidence = csr_matrix((np.ones(f * k), facets.ravel(), np.arange(f + 1) * k), (f, m))
        around = adjacency(facets, m)  # which nodes share a facet
        reached = incidence @ around
        reached.sort_indices()
        counts = np.diff(reached.indptr)
        place = np.arange(counts.max())
        there = place < counts[:, None]
        index = reached.indptr[:-1, None] + np.minimum(place, counts[:, None] - 1)
        nodes = reached.indices[index]
        shares = _looked_up(around, facets, nodes)
        return cls(
            nodes,
            shares * there[:, None],
            (facets[:, :, None] == nodes[:, None, :]) * there[:, None].astype(float),
        )


def _looked_up(A: csr_matrix, rows: Array, cols: Array) -> Array:
    """(f, k, s) 1 where A has an entry at rows (f, k) and columns (f, s)."""
    f, k = rows.shape
    at = np.broadcast_to(rows[:, :, None], (f, k, cols.shape[1]))
    to = np.broadcast_to(cols[:, None, :], at.shape)
    return np.asarray(A[at.ravel(), to.ravel()]).reshape(at.shape)


@dataclass(frozen=True, eq=False)
class DesignedRows:
    """Rows of n nodes on a frame of m nodes, s entries each."""

    nodes: Array  # (n, s) frame node of each entry
    N: Array  # (n, s) entries
    delta: Array  # (n, s) corrections, part of N
    whole: Array  # (n, s) entries with all of the corrections, for which (28) holds
    M: csr_matrix  # (m, m) sum_p f_p P_p, how mu changes the residual [area]
    G: Array  # (m, c) what no correction removes [area]
    mu: Array  # (m,)
    left: Array  # (m,) pressure whose forces no correction removes
    parts: dict[str, Any] = field(repr=False)  # of which derivatives are made

    def matrix(self, m: int, whole: bool = False) -> csr_matrix:
        """(n, m) rows as a matrix; those with all of the corrections."""
        n, s = self.nodes.shape
        entries = self.whole if whole else self.N
        parts = entries.ravel(), self.nodes.ravel(), np.arange(n + 1) * s
        found = csr_matrix(parts, (n, m), copy=True)  # entries are sorted in place
        found.sum_duplicates()
        return found


@dataclass(frozen=True, eq=False)
class Design:
    """What stays of a frame's design while it moves."""

    stencils: Stencils
    facets: Array  # (f, k) of the frame
    element: Element  # of these
    part: Array  # (m,) connected part of its nodes
    size: float  # h, of the chart of a stencil [length]
    control: tuple[csr_matrix, csr_matrix]  # E, C (m, m): see ``sides``
    wanted: bool = True  # False: rows stay as they are

    @classmethod
    def of(cls, Y: Array, facets: Array, wanted: bool = True) -> Design:
        """Design of a frame with nodes Y (m, gdim) as drawn."""
        span = np.linalg.norm(Y[facets] - np.roll(Y[facets], 1, axis=1), axis=2).max()
        element = element_of(Y.shape[1] - 1, facets.shape[1])
        of = Stencils.of(facets, len(Y)), facets, element, connected(facets, len(Y))[1]
        return cls(*of, float(span), control_of(element, facets, len(Y)), wanted)

    @property
    def soft(self) -> Array:
        """(c,) how much functions of the chart yield [area]."""
        return yielding(self.element, self.part) * self.size**self.element.dim

    @property
    def bernstein(self) -> Array:
        """(k, k) E of the frame's facets: weights follow control values, which are not negative."""
        return self.element.bernstein

    def rows(
        self,
        at: OnFrame,
        x: Array,
        y: Array,
        forces: tuple[Array, Array],
        chart: Array,
    ) -> DesignedRows:
        """Rows with the smallest corrections.

        Args:
            at: places of the nodes on the frame.
            x: (n, gdim) nodes [length].
            y: (m, gdim) the frame's nodes [length].
            forces: (n,), (m,) of unit pressure on the common area [area].
            chart: (m, c) of ``chart_of``.

        Raises:
            ContactError: the equations are singular.
        """
        m = len(y)
        nodes, window = self.stencils.nodes[at.facet], self.stencils.window[at.facet]
        N0 = np.einsum("nk,nks->ns", at.N, self.stencils.own[at.facet])
        plus = np.maximum(at.N @ self.bernstein, 0.0)
        total = plus.sum(axis=1)
        w = np.einsum("nk,nks->ns", plus, window) / total[:, None]
        tangents = local_bases(at.normal)[:, :-1]
        arm = y[nodes] - x[:, None]
        along = np.einsum("nai,nsi->nas", tangents, arm) / self.size
        squares = [along[:, a] * along[:, b] for a, b in products(self.element)]
        C = np.stack([np.ones_like(w), *np.moveaxis(along, 1, 0), *squares], axis=1)
        CW = C * w[:, None]
        inverse = np.linalg.inv(np.einsum("nas,nbs->nab", CW, C))
        lift = np.einsum("nas,nab->nsb", CW, inverse)  # W Cᵀ S⁻¹
        P = -np.einsum("nsa,nat->nst", lift, CW)
        own = np.arange(w.shape[1])
        P[:, own, own] += w
        M, faint = self._held(assembled(forces[0][:, None, None] * P, nodes, m))
        G = borne(self.control, chart, forces[1], self.part)
        r = np.bincount(nodes.ravel(), (forces[0][:, None] * N0).ravel(), m) - forces[1]
        mu, kappa = bordered(M, faint, G, r, self.soft)
        t = np.einsum("nsa,ns->na", lift, mu[nodes])  # S⁻¹ C W mu
        v = mu[nodes] - np.einsum("nas,na->ns", C, t)
        delta = -w * v
        height = np.einsum("nsi,ni->ns", arm, at.normal)
        borne_part, fades, *by_excess = self._borne_part(delta, height)
        parts = {
            "P": P, "lift": lift, "C": C, "t": t, "v": v, "tangents": tangents, "arm": arm,
            "window": window, "plus": plus, "total": total, "w": w, "delta": delta,
            "part": borne_part, "fades": fades, "excess": by_excess,
        }  # fmt: skip
        taken, pressure = borne_part[:, None] * delta, chart @ kappa
        return DesignedRows(nodes, N0 + taken, taken, N0 + delta, M, G, mu, pressure, parts)

    def _held(self, M: csr_matrix) -> tuple[csr_matrix, float]:
        """M with pins at nodes that no row reaches, and what it has beyond itself elsewhere."""
        largest = float(M.diagonal().max(initial=0.0)) or 1.0  # nothing is covered: mu is 0
        added = largest * (FAINT if self.wanted else UNDESIGNED)
        pins = np.where(M.diagonal() > UNREACHED * largest, added, largest)
        return M + diagonal(pins), added if self.wanted else 0.0

    def _borne_part(self, delta: Array, height: Array) -> tuple[Array, Array, Array, Array]:
        """Part c of each row's corrections that it bears, so that no entry changes and no
        place moves beyond its limit; smooth in the latter, as no state may lie beside a kink.

        They do not move places along the surface, but along the normal of a curved one, and
        otherwise elsewhere: contact that slides would lose energy. In space they stay.

        Args:
            delta: (n, s) corrections.
            height: (n, s) n·(y_J - x_p) of the frame's nodes [length].

        Returns:
            (n,) c, and -dc/de with e what is larger of both over its limit; where c is less than 1,
            else 0, derivatives of e: (n, s) by delta, (n,) by that place [1 / length].
        """
        every, largest = np.arange(len(delta)), np.abs(delta).argmax(axis=1)
        most = delta[every, largest] / CORRECTED
        allowed = RAISED * self.size if self.element.dim == 1 else np.inf
        raised = np.einsum("ns,ns->n", delta, height) / allowed
        whole, far = np.maximum(np.abs(most), 1.0), np.maximum(np.abs(raised), BORNE_WHOLE)
        rising = np.tanh((far - BORNE_WHOLE) / (1.0 - BORNE_WHOLE))
        parts = 1.0 / whole, (BORNE_WHOLE + (1.0 - BORNE_WHOLE) * rising) / far
        bends = parts[1] < parts[0]
        part = np.where(bends, parts[1], parts[0])
        fades = np.where(bends, (part - (1.0 - rising**2)) / far, part / whole)
        sign = np.sign(np.where(bends, raised, most)) * (part < 1.0)
        by_raised = np.where(bends, sign, 0.0) / allowed
        by_delta = by_raised[:, None] * height
        by_delta[every, largest] += np.where(bends, 0.0, sign) / CORRECTED
        return part, fades, by_delta, by_raised

    def derivatives(
        self,
        rows: DesignedRows,
        at: OnFrame,
        d: LocationDerivatives,
        columns: tuple[Array, int],
        width: int,
    ) -> tuple[csr_matrix, csr_matrix, csr_matrix]:
        """(n s, width) and (n s, m): how entries change with positions, and with mu; (n s, width)
        how those with all of the corrections change with positions.

            d delta_p = -P dmu - Π (v ∘ dw) + P dCᵀ t - W Cᵀ S⁻¹ dC delta,  Π = 1 - W Cᵀ S⁻¹ C,

        dmu being an unknown of its own, for which (28) is differentiated; d(c delta) = c d delta
        + delta dc.

        Args:
            rows, at, d: rows, places, and the places' derivatives.
            columns: (n, gdim) numbers of the coordinates of the nodes x; of the frame's first.
            width: number of all coordinates.
        """
        q, (n, s) = rows.parts, rows.nodes.shape
        m, gdim = rows.M.shape[0], q["arm"].shape[2]
        by_mu = jacobian(-q["P"], rows.nodes, m)
        # Shape functions and weights, through xi.
        dplus = np.einsum("nkd,kj->njd", at.dN, self.bernstein)
        dplus = np.where((q["plus"] > 0.0)[:, :, None], dplus, 0.0)
        dw = np.einsum("nkd,nks->nsd", dplus, q["window"])
        dw -= q["w"][:, :, None] * dplus.sum(axis=1)[:, None]
        dw /= q["total"][:, None, None]
        vdw = q["v"][:, :, None] * dw
        dN = np.einsum("nkd,nks->nsd", at.dN, self.stencils.own[at.facet])
        wane = np.einsum("nsa,nad->nsd", q["lift"], np.einsum("nas,nsd->nad", q["C"], vdw)) - vdw
        # Constraints: dc_aJ = (t_a·(dy_J - dx_p) - t_a·dn n·(y_J - x_p)) / h.
        height = np.einsum("nsi,ni->ns", q["arm"], at.normal)
        places = np.concatenate([columns[0], coordinates(rows.nodes, gdim, columns[1])], axis=1)
        by_row = [
            t[:, None, None] * q["P"] - lift[:, :, None] * q["delta"][:, None, :]
            for t, lift in zip(q["t"].T, np.moveaxis(q["lift"], 2, 0), strict=True)
        ]
        moves, turns = np.zeros((n, s, (s + 1) * gdim)), np.zeros((n, s, gdim))
        for a in range(gdim - 1):
            Q = by_row[1 + a]
            for ends, of_product in zip(products(self.element), by_row[gdim:], strict=True):
                for one, other in (ends, ends[::-1]):
                    if one == a:
                        Q = Q + of_product * q["C"][:, None, 1 + other]
            tangent = q["tangents"][:, a] / self.size
            moved = Q[:, :, :, None] * tangent[:, None, None]
            moves[:, :, :gdim] -= Q.sum(axis=2)[:, :, None] * tangent[:, None]
            moves[:, :, gdim:] += moved.reshape(n, s, s * gdim)
            turns -= (Q @ height[:, :, None]) * tangent[:, None]
        own, delta = per_item(dN) @ d.xi, q["delta"]
        change = per_item(wane) @ d.xi + per_item(turns) @ d.normal + jacobian(moves, places, width)
        # Parts that rows bear: the excess through delta, the normal and places.
        by_delta, by_raised = q["excess"]
        less = q["fades"][:, None] * delta
        cut = q["part"][:, None, None] * np.eye(s) - less[:, :, None] * by_delta[:, None]
        lean = by_raised[:, None] * np.einsum("ns,nsi->ni", delta, q["arm"])
        shift = (by_raised[:, None] * delta)[:, :, None] * at.normal[:, None]
        shift = np.concatenate([np.zeros((n, 1, gdim)), shift], axis=1)  # sum delta is 0
        excess = per_item(lean[:, None]) @ d.normal
        excess = excess + jacobian(shift.reshape(n, 1, (s + 1) * gdim), places, width)
        taken = per_item(cut) @ change - per_item(less[:, :, None]) @ excess
        return own + taken, per_item(cut) @ by_mu, own + change
