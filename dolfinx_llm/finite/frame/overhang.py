"""Facets of the moving side, in the plane, that hang over an end of the frame.

A node beyond the end has nothing to touch but what the frame's last facet goes on to there, which
may dip into the moving side while the end itself is away, or lie clear of it where the end presses.
Its pair is therefore the point of the facet that the end faces: with control values g of the gap
along a facet that is covered from s to t those of the covered part are

    g' = S g,   S_i = b(s, .., s, t, .., t),

b the polar form of the facet's polynomial, linear in each place. Forces are those of the parts,
lambda' >= 0, lambda = Sᵀ lambda' at control values, and a pressure passes as without. Places are
those of the configuration, and so is the derivative.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, vstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, picking, summing
from dolfinx_llm.finite.frame.cover_line import cut_by_end
from dolfinx_llm.finite.frame.jacobians import nodal_normals
from dolfinx_llm.finite.frame.sides import Sides
from dolfinx_llm.laws.rows import OPEN

BEARS_ON = 1e-2  # entry of S up to which a part does not bear on a control value
COVERED_AT_LEAST = 0.05  # of a facet: rows of less would be those of the next node


@dataclass(frozen=True, eq=False)
class Overhang:
    """S of n control values, whose rows have e entries that change with c places."""

    S: csr_matrix  # (n, n)
    entries: tuple[Array, Array, Array]  # (e,) rows, columns, and which place each follows
    slopes: Array  # (e,) their derivatives by it
    places: csr_matrix  # (c, width) derivatives of the places [1 / length]

    @cached_property
    def inverse(self) -> csr_matrix:
        """(n, n): but for a few rows S is the identity."""
        n, of = self.S.shape[0], np.unique(self.entries[0])
        stays = np.ones(n)
        stays[of] = 0.0
        own = csr_matrix(np.linalg.inv(self.S[of][:, of].toarray()))
        others = picking(of, n) - self.S[of] @ diagonal(stays)
        return (diagonal(stays) + summing(of, n) @ own @ others).tocsr()

    def as_if_fixed(self) -> Overhang:
        """The same, of places that do not move."""
        return replace(self, slopes=np.zeros_like(self.slopes))

    def at_nodes(self, status: Array) -> Array:
        """(n,) status of control values: where they are open that of parts that bear on them."""
        bears = (abs(self.S) > BEARS_ON).T @ diagonal(status)
        most = np.asarray(bears.max(axis=1).todense()).ravel()
        return np.where(status == OPEN, most.astype(status.dtype), status)

    def change(self, g: Array) -> csr_matrix:
        """(n, width) derivative of S g for values g (n,)."""
        rows, columns, which = self.entries
        shape = len(g), self.places.shape[0]
        return csr_matrix((self.slopes * g[columns], (rows, which)), shape) @ self.places

    def change_of_forces(self, forces: Array) -> csr_matrix:
        """(n d, width) derivative of Sᵀ f for forces f (n, d)."""
        rows, columns, which = self.entries
        n, d = forces.shape
        at = columns[:, None] * d + np.arange(d), np.repeat(which[:, None], d, axis=1)
        values = self.slopes[:, None] * forces[rows]
        shape = n * d, self.places.shape[0]
        return csr_matrix((values.ravel(), tuple(a.ravel() for a in at)), shape) @ self.places


def overhang(sides: Sides, z: Array, facing: Array) -> Overhang | None:
    """Of facets that an end of the frame cuts, and of those next to them: they may come in, or the
    others leave, in the same increment. None: there are none, or in space.

    Args:
        sides: that meet.
        z: all coordinates [length].
        facing: (f,) facets of the moving side that can touch.
    """
    if sides.chains is None:
        return None
    chains, cells, columns = sides.chains, sides.mover.cells, sides.first
    (x, y), at = sides.split(z), sides.meet(z, facing).at
    high, low = chains.beyond(at)
    a, b = cells[:, :2].T
    out = np.stack([high[a], low[b]], axis=1)
    chain = chains.chain[at.facet]
    used = facing & at.met[a] & at.met[b] & (chain[a] == chain[b])
    on = ~(high | low)
    cut = used & out.any(axis=1) & (on[a] | on[b] | out.all(axis=1))
    of_cut = np.zeros(len(x), dtype=bool)
    of_cut[cells[cut, :2]] = True
    cut |= used & (out[:, 0] & high[b] & of_cut[b] | out[:, 1] & low[a] & of_cut[a])
    facets = np.flatnonzero(cut)
    if not len(facets):
        return None
    normals = nodal_normals(y, sides.carrier.skin, columns[1], sides.width)
    nodes, out, count = cells[facets], out[facets], 0
    st, places = np.tile([0.0, 1.0], (len(facets), 1)), []
    which = np.zeros((len(facets), 2), dtype=np.int64)
    for local, (least, most) in enumerate(((0.0, 1.0 - COVERED_AT_LEAST), (COVERED_AT_LEAST, 1.0))):
        of = np.flatnonzero(out[:, local])
        end = chains.ends[at.facet[nodes[of, local]], 1 - local]
        eta, by_z = cut_by_end(x, nodes[of, :2], y, end, normals, columns, sides.width)
        within = (eta >= least) & (eta <= most)
        st[of, local] = np.clip(eta, least, most)
        places.append(diagonal(within.astype(float)) @ by_z)
        which[of, local] = count + np.arange(len(of))
        count += len(of)
    values, slopes = polar(cells.shape[1] - 1, st)
    f, j = nodes.shape
    # Rows of the ends beyond, and of the middle; (f, j, j) entries that follow s, then t.
    rows = np.broadcast_to(nodes[:, :, None], (f, j, j))
    cols = np.broadcast_to(nodes[:, None, :], (f, j, j))
    own = np.concatenate([out, np.ones((f, j - 2), dtype=bool)], axis=1)
    own = np.broadcast_to(own[:, :, None], (f, j, j))
    changed = np.zeros(len(x), dtype=bool)
    changed[rows[own]] = True
    S = csr_matrix((values[own], (rows[own], cols[own])), (len(x), len(x)))
    S = S + diagonal((~changed).astype(float))
    entries, derivatives = [], []
    for local in (0, 1):
        follow = own & out[:, local, None, None]
        place = np.broadcast_to(which[:, local, None, None], (f, j, j))
        entries.append(np.stack([rows[follow], cols[follow], place[follow]]))
        derivatives.append(slopes[:, local][follow])
    row, col, place = np.concatenate(entries, axis=1)
    by = np.concatenate(derivatives), vstack(places, format="csr")
    return Overhang(S.tocsr(), (row, col, place), *by)


def polar(degree: int, st: Array) -> tuple[Array, Array]:
    """(f, j, j) control values of polynomials on [s, t], of those on [0, 1], and (f, 2, j, j) their
    derivatives by s and t.

    >>> polar(2, np.array([[0.0, 0.5]]))[0].tolist()
    [[[1.0, 0.0, 0.0], [0.25, 0.25, 0.5], [0.5, 0.0, 0.5]]]
    """
    s, t = st.T
    one, none = np.ones_like(s), np.zeros_like(s)
    if degree == 1:
        values = [[1.0 - s, s], [1.0 - t, t]]
        by_s, by_t = [[-one, one], [none, none]], [[none, none], [-one, one]]
    else:
        both = [(1.0 - s) * (1.0 - t), s * t, s + t - 2.0 * s * t]
        values = [[(1.0 - p) ** 2, p**2, 2.0 * p * (1.0 - p)] for p in (s, t)] + [both]
        own = [[-2.0 * (1.0 - p), 2.0 * p, 2.0 - 4.0 * p] for p in (s, t)]
        by_s = [own[0], [none] * 3, [t - 1.0, t, 1.0 - 2.0 * t]]
        by_t = [[none] * 3, own[1], [s - 1.0, s, 1.0 - 2.0 * s]]
    found, of_s, of_t = (np.moveaxis(np.array(a), 2, 0) for a in (values, by_s, by_t))
    return found, np.stack([of_s, of_t], axis=1)
