"""Steps with jumps in coordinates in which their matrix is symmetric but for a small part.

What no force enters (nodes that stick, that follow others, that nothing touches) says how frame
unknowns depend on each other: w = C z + w_0. The rows of a law that are left are multiplied so that
they read T = (stiffness) × jump + (part that depends on the normal force): the first two parts are
symmetric. Where a node slips, each side moves on its own: with a = v + κ and b = v - κ in the
place of v and κ a multigrid method sees two bodies that do not touch.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import splu

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.forms.step import LinearStep
from dolfinx_llm.operators.system import ContactOperators

REGULAR = 1e-3  # of a law's forces, added to them where it does not depend on them
AS_STIFF = 0.1  # of the stiffer side
EXACT = 1e-14  # of a product's factors, below which it is zero


class Reduced:
    """A step in the unknowns z; arrays are the same on every rank.

    Args:
        step: the step.
        operators: of the interfaces.

    Attributes:
        on: rows in contact.
        told: (m,) unknowns w that geometry alone tells from the others; their z are idle.
        rim: (m,) others that pairs out of contact would see as well: some of their motions next to
            nothing holds.
        C: (m, m) w = C z + w_0.
        L: (n, m) motion of the frames by z.
        E, D: (m, n), (m, m) rows E λ + D z.
        jumps, alike: (m,) unknowns that are jumps; those whose sides are about equally stiff.
        stiff: (m, m) symmetric and positive: what the rows hold z by, less what K does.
        parts: (m, m) z = parts × coordinates in which sides that slip stand apart.
        parted: (m, m) inverse of it.
    """

    def __init__(self, step: LinearStep, operators: ContactOperators) -> None:
        self._step, self._jumps, self._scale = step, jumps_of(operators), operators.scale
        self.on = on = np.flatnonzero(step.active)
        m = step.L.shape[1]
        E = step.E[:, on]
        self.told = np.asarray(abs(E).sum(axis=1)).ravel() == 0.0
        self._eliminate(step.D, m)
        self.L = _clean(step.L @ self.C)
        self._scaled = self._law_scaling(E, self.L[on])
        apart = np.asarray(abs(self.L[~step.active]).sum(axis=0)).ravel() > 0.0
        self.rim = apart & ~self.told
        kept = diags((~self.told).astype(float))
        idle = diags(-self._scale * self.told.astype(float))
        self._rows = (kept @ self._scaled).tocsr()
        self.E = (self._rows @ step.E).tocsr()
        self.D = (self._rows @ step.D @ self.C + idle).tocsr()
        self._part()
        self.jumps, self.alike = np.zeros((2, m), dtype=bool)
        for place, of in zip(operators.places, operators.stiffness, strict=True):
            self.jumps[place.slips] = True
            self.alike[place.slips] = len(of) > 1 and of.min() > AS_STIFF * of.max()

    def _eliminate(self, D: csr_matrix, m: int) -> None:
        """C, from rows that say how unknowns depend on each other."""
        told, others = np.flatnonzero(self.told), np.flatnonzero(~self.told)
        free = diags((~self.told).astype(float)).tocsr()
        self._size = np.zeros(0)
        if not len(told):
            self.C = free
            return
        own = D[told]
        size = abs(own).max(axis=1).toarray().ravel()
        if not size.all():
            raise np.linalg.LinAlgError("a row of a law says nothing")
        self._size = 1.0 / size
        own = (diags(self._size) @ own).tocsc()
        self._factor = splu(own[:, told].tocsc())
        on = own[:, others]
        used = np.flatnonzero(np.diff(on.indptr))
        X = -self._factor.solve(on[:, used].toarray()) if len(used) else np.zeros((len(told), 0))
        row, col = np.nonzero(np.abs(X) > EXACT)
        at = told[row], others[used[col]]
        self.C = (free + csr_matrix((X[row, col], at), shape=(m, m))).tocsr()

    def _law_scaling(self, E: csr_matrix, L: csr_matrix) -> csr_matrix:
        """(m, m) blocks by which rows of laws are multiplied, so that they begin with L_κᵀ λ."""
        m = E.shape[0]
        self._support = np.ones(m)
        products = (E @ L).tocsr(), (L.T @ L).tocsr()
        blocks, at = [], []
        for kappa, _ in self._jumps:
            kappa = kappa[~self.told[kappa].all(axis=1)]
            unit = np.eye(kappa.shape[1])
            own, size = (at_blocks(M, kappa) for M in products)
            least = 1e-12 * (size.max(initial=0.0) or 1.0) * unit  # 0: nothing in contact moves
            self._support[kappa] = np.einsum("nii->ni", size)
            X = own @ np.linalg.inv(size + least)
            blocks.append(np.linalg.inv(X + REGULAR * unit))
            at.append(kappa)
        return _with_blocks(m, blocks, at, at)

    def _part(self) -> None:
        """Stiffness of the symmetric part, and coordinates for it."""
        m, hold = len(self.told), self._scale * self.told - np.minimum(self.D.diagonal(), 0.0)
        hold = np.where(self.told, self._scale, hold)
        stiff, forth, back, at_stiff, at_parts = [], [], [], [], []
        self.slips = np.zeros(m, dtype=bool)
        for kappa, v in self._jumps:
            chosen = ~self.told[kappa].all(axis=1)
            kappa = kappa[chosen]
            H = -at_blocks(self.D, kappa)
            h, V = np.linalg.eigh(0.5 * (H + np.swapaxes(H, 1, 2)))
            h = np.maximum(h, 0.0)
            hold[kappa] = 0.0
            stiff.append((V * h[:, None]) @ np.swapaxes(V, 1, 2))
            at_stiff.append(kappa)
            if v is None:
                continue
            v = v[chosen]
            held = self.told[v].any(axis=1)
            V = np.where(held[:, None, None], np.eye(V.shape[1]), V)
            soft = h <= self._scale * self._support[kappa].mean(axis=1)[:, None]
            soft &= ~held[:, None]
            self.slips[kappa] = soft.any(axis=1)[:, None]
            half, one = np.where(soft, 0.5, 1.0), soft.astype(float)
            Vt = np.swapaxes(V, 1, 2)
            forth.append(_two_by_two(V, half, 0.5 * one, 0.5 * one, half - one, after=True))
            back.append(_two_by_two(Vt, 1.0 + 0.0 * one, one, one, 1.0 - 2.0 * one, after=False))
            at_parts.append(np.concatenate([v, kappa], axis=1))
        floor = 1e-13 * self._scale
        self.stiff = (_with_blocks(m, stiff, at_stiff, at_stiff, 0.0)
                      + diags(np.maximum(hold, floor))).tocsr()  # fmt: skip
        self.parts = _with_blocks(m, forth, at_parts, at_parts)
        self.parted = _with_blocks(m, back, at_parts, at_parts)

    @property
    def stiffness(self) -> Array:
        """(m,) what bodies set against the motion of unknowns, about [force / length]."""
        return self._scale * self._support

    def complete(self, chosen: Array) -> None:
        """Add to chosen unknowns (m,) all of the same nodes."""
        for kappa, v in self._jumps:
            every = kappa if v is None else np.concatenate([v, kappa], axis=1)
            chosen[every] = chosen[every].any(axis=1)[:, None]

    def loads(self, g: Array, rhs: Array) -> tuple[Array, Array, Array]:
        """Gaps (n,) and right-hand side (m,) for z, and w_0 (m,), of those for w."""
        w_0 = np.zeros(len(rhs))
        if len(self._size):
            w_0[self.told] = self._factor.solve(self._size * rhs[self.told])
        return g - self._step.L @ w_0, self._rows @ (rhs - self._step.D @ w_0), w_0

    @cached_property
    def L_parted(self) -> csr_matrix:
        """(n, m) motion of the frames by the coordinates of ``parts``."""
        return _clean(self.L @ self.parts)


def jumps_of(operators: ContactOperators) -> list[tuple[Array, Array | None]]:
    """Per interface whose law has jumps (k, q) places of these in w, and of the frame's motion in
    the same directions; None where these are of pairs."""
    found = []
    for geometry, place in zip(operators.geometries, operators.places, strict=True):
        k, gdim = len(geometry.law_nodes[0]), operators.dofs.gdim
        law = geometry.interface.law
        q = law.jumps(gdim)
        if not q:
            continue
        kappa = np.arange(place.slips.start, place.slips.stop).reshape(k, q)
        v = None
        if geometry.law_side is None:
            v = np.arange(place.frame.start, place.frame.stop).reshape(k, -1)
            v = v[:, law.components_of_jumps(v.shape[1])]
        found.append((kappa, v))
    return found


def items_of(operators: ContactOperators) -> Array:
    """(m,) number of the block that each unknown w stands in: the motions of a frame node, and its
    jumps."""
    sizes = [np.zeros(0, dtype=np.int64)]
    for geometry in operators.geometries:
        sizes.append(np.full(len(geometry.directions), geometry.directions.shape[1]))
    for kappa, _ in jumps_of(operators):
        sizes.append(np.full(len(kappa), kappa.shape[1]))
    size = np.concatenate(sizes)
    return np.repeat(np.arange(len(size)), size)


def at_blocks(M: csr_matrix, at: Array) -> Array:
    """(k, q, q) entries of a matrix in the rows and columns ``at`` (k, q)."""
    k, q = at.shape
    if not k:
        return np.zeros((0, q, q))
    row, col = np.broadcast_arrays(at[:, :, None], at[:, None, :])
    return np.asarray(M[row.ravel(), col.ravel()]).reshape(k, q, q)


def _with_blocks(
    m: int,
    blocks: list[Array],
    rows: list[Array],
    cols: list[Array],
    other: float = 1.0,
) -> csr_matrix:
    """(m, m) matrix with given blocks (k, q, q), and ``other`` on the diagonal elsewhere."""
    index = [np.broadcast_arrays(r[:, :, None], c[:, None, :]) for r, c in zip(rows, cols)]
    empty = np.zeros(0, dtype=np.int64)
    row = np.concatenate([empty, *(i[0].ravel() for i in index)])
    col = np.concatenate([empty, *(i[1].ravel() for i in index)])
    value = np.concatenate([np.zeros(0), *(b.ravel() for b in blocks)])
    rest = np.full(m, other)
    rest[row] = 0.0
    return (csr_matrix((value, (row, col)), shape=(m, m)) + diags(rest)).tocsr()


def _two_by_two(V: Array, a: Array, b: Array, c: Array, d: Array, after: bool) -> Array:
    """(k, 2 q, 2 q) blocks of diagonals (k, q), multiplied by V from the left, or the right."""
    k, q = a.shape
    found = np.zeros((k, 2 * q, 2 * q))
    for i, row in enumerate(((a, b), (c, d))):
        for j, diagonal in enumerate(row):
            block = V * diagonal[:, None, :] if after else diagonal[:, :, None] * V
            found[:, i * q : (i + 1) * q, j * q : (j + 1) * q] = block
    return found


def _clean(M: csr_matrix) -> csr_matrix:
    """Without what rounding has made of zero."""
    M = M.tocsr()
    M.data[np.abs(M.data) < EXACT * np.abs(M.data).max(initial=0.0)] = 0.0
    M.eliminate_zeros()
    return M
