"""The bodies as their interfaces see them: factorised once, then a small dense system.

With few contact pairs the cheapest way through opening and friction is to ask the bodies only once
how their surfaces answer to contact forces, y = Bᵀu = h - F λ + G α with F = Bᵀ K⁻¹ B (α: motion of
bodies that supports alone do not hold), and to iterate on that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg
from scipy.sparse import csr_matrix

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.log import progress
from dolfinx_llm.forms.direct import DirectSolver
from dolfinx_llm.forms.step import DRIFT, SIGN, SOFT, InterfaceSystem, wrong_signs
from dolfinx_llm.laws.complementarity import complementarity
from dolfinx_llm.operators.petsc import with_springs
from dolfinx_llm.operators.support import floating_modes, pins

COLUMNS = 64  # right-hand sides solved at once


class Flexibility:
    """K factorised, and the answer of the surfaces to unit multipliers.

    Args:
        K: stiffness, identity rows at prescribed dofs.
        B: (31).
        rows: the multipliers' ``Numbering``.
        bodies: ``Bodies`` of the meshes.
        fixed: (n_local,) prescribed dofs.
        scale: mean stiffness of the surface [force / length].
        prefix, options: PETSc options, of the factorisation.
        soft: (n,) rows of prescribed dofs, which get a compliance ``SOFT``: they may say the same.
    """

    accuracy = 1e-13  # of balance and law, relative
    proximal = 1e-13  # what holds frame nodes that nothing touches, of the surfaces' stiffness: the
    # smaller, the sooner those under a tiny force are where they touch

    def __init__(self, K, B, rows, bodies, fixed, scale, prefix, options=None, *, soft):
        self.K, self.B, self.rows, self.scale = K, B, rows, scale
        self.comm = bodies.comm
        self.modes = floating_modes(bodies, K, fixed)
        self._local_B = _local_csr(B)
        # Springs hold the floating modes; under forces in balance they carry nothing.
        diagonal = K.getDiagonal()
        pinned = with_springs(K, pins(bodies.comm, self.modes), diagonal.array_r)
        diagonal.destroy()
        self._solver = DirectSolver(pinned, prefix, options, own=True)
        self.floating = self.modes.shape[1]
        self.G = self._interface_sum(self._local_B.T @ self.modes)
        self.F: Any = self._flexibility()  # (n, n) on rank 0, None elsewhere
        if self.F is not None:
            self.F[soft, soft] += SOFT / scale

    def _interface_sum(self, part: np.ndarray) -> np.ndarray:
        """Sum over ranks of a part with one row per multiplier, in their own order."""
        return self.comm.allreduce(part)[self.rows.number]

    def _flexibility(self) -> np.ndarray | None:
        """F on rank 0, None elsewhere."""
        n = self.rows.sizes[1]
        F = np.empty((n, n)) if self.comm.rank == 0 else None
        columns = self._local_B.tocsc()
        for first in progress(range(0, n, COLUMNS), "flexibility of the surfaces"):
            last = min(first + COLUMNS, n)
            solved = self._solver.solve_many(columns[:, first:last].toarray())
            part = self.comm.reduce(self._local_B.T @ solved, root=0)
            if F is not None:
                F[:, first:last] = part
        if F is None:
            return None
        F = F[np.ix_(self.rows.number, self.rows.number)]
        return 0.5 * (F + F.T)

    def load(self, f: np.ndarray):
        """Take this rank's load: h, and the resultant along the floating modes."""
        self.f = f
        self.h = self._interface_sum(self._local_B.T @ self._solver.solve(f))
        self.r = self.comm.allreduce(self.modes.T @ f)

    def solve(self, step: InterfaceSystem, spring: float, centre: np.ndarray, may_open: np.ndarray):
        """One linear step, and which pairs are in contact.

        Contact is first taken as ``step.active`` says; where that gives tension or overlap, the
        complementarity λ >= 0, gap >= 0, λ gap = 0 is solved.

        Args:
            step: the law's equations.
            spring: stiffness that holds floating modes at ``centre`` [force / length]; with
                centre at the solution it carries nothing.
            centre: (k,) their last values.
            may_open: (n,) rows of normal forces that may open.

        Returns:
            λ (n,), y (n,), w (m,), α (k,), (n,) rows in contact and (n,) those where a sign is
            still wrong; on every rank.
        """
        result, error = None, ""
        if self.comm.rank == 0:
            try:
                active = step.active
                found = self._dense(step, spring, centre)
                wrong = wrong_signs(step, may_open, found[0], found[1], found[2], self.scale)
                if wrong.any():
                    active = self._choose(step, spring, centre, may_open)
                    chosen = replace(step, active=active)
                    found = self._dense(chosen, spring, centre)
                    wrong = wrong_signs(chosen, may_open, found[0], found[1], found[2], self.scale)
                result = *found, active, wrong
            except (np.linalg.LinAlgError, ValueError) as failed:
                error = str(failed)
        result, error = self.comm.bcast((result, error))
        if result is None:
            raise ContactError(f"a step of the contact law is singular: {error}")
        return result

    def _equations(self, step: InterfaceSystem, on: np.ndarray, spring: float, centre):
        """Matrix and right-hand side of the rows ``on``, the frame and the floating modes.

        Unknowns λ / c, w, α: every entry is then a pure number.
        """
        c, n, m, k = self.scale, len(on), step.L.shape[1], len(centre)
        A = np.zeros((n + m + k, n + m + k))
        A[:n, :n] = c * self.F[np.ix_(on, on)]
        A[:n, n : n + m] = step.L[on].toarray()
        A[:n, n + m :] = -self.G[on]
        A[n : n + m, :n] = step.E[:, on].toarray()
        A[n : n + m, n : n + m] = step.D.toarray() / c
        A[n + m :, :n] = self.G[on].T
        A[n + m :, n + m :] = spring / c * np.eye(k)
        rhs = np.concatenate(
            [self.h[on] + step.g[on], step.rhs / c, self.r / c + spring / c * centre]
        )
        return A, rhs

    def _dense(self, step: InterfaceSystem, spring: float, centre: np.ndarray):
        on, c, m = np.flatnonzero(step.active), self.scale, step.L.shape[1]
        A, rhs = self._equations(step, on, spring, centre)
        x = _refined(A)(rhs[:, None])[:, 0]
        multiplier, n = np.zeros(len(step.active)), len(on)
        multiplier[on] = c * x[:n]
        alpha = x[n + m :]
        y = self.h - self.F @ multiplier + self.G @ alpha
        return multiplier, y, x[n : n + m], alpha

    def _choose(self, step: InterfaceSystem, spring: float, centre, may_open) -> np.ndarray:
        """Rows in contact: linear complementarity among those whose sign is or becomes wrong.

        The others keep their state and are eliminated. Eliminating the frame without them would
        leave its nodes to the proximal term, whose compliance drowns that of the bodies.
        """
        n, rows = len(step.active), np.flatnonzero(may_open)
        A, rhs = self._equations(step, np.arange(n), spring, centre)
        kept = np.concatenate([np.flatnonzero(step.active), np.arange(n, len(A))])
        place = np.cumsum(step.active) - 1
        on = step.active[rows]
        solve = _refined(A[np.ix_(kept, kept)])
        look = A[np.ix_(rows, kept)]

        def signs(x, gap):
            """What must not be negative: λ / c in contact, gaps elsewhere."""
            return np.where(on[:, None], x[place[rows]], look @ x + gap)

        x = solve(rhs[kept][:, None])
        now = signs(x, -rhs[rows][:, None])[:, 0]
        band = SIGN * max(np.abs(x[: int(step.active.sum())]).max(initial=0.0), 1e-300)
        pairs, new = np.empty(0, dtype=np.int64), np.flatnonzero(now < -band)
        columns, change = np.empty((len(rows), 0)), np.zeros(0, dtype=bool)
        while len(new):
            load = np.where(on[new], 0.0, -1.0) * A[np.ix_(kept, rows[new])]
            load[place[rows[new[on[new]]]], np.flatnonzero(on[new])] = 1.0
            gap = np.where(on[new], 0.0, 1.0) * A[np.ix_(rows, rows[new])]
            columns = np.hstack([columns, signs(solve(load), gap)])
            pairs = np.concatenate([pairs, new])
            change = complementarity(columns[pairs], now[pairs], now[pairs] < 0.0)
            M = columns[pairs][np.ix_(change, change)]
            after = now + columns[:, change] @ np.linalg.solve(M, -now[pairs][change])
            after[pairs] = 0.0
            new = np.flatnonzero(after < -band)
        active = step.active.copy()
        active[rows[pairs[change]]] ^= True
        return active

    def displacement(self, multiplier: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        """This rank's u for multipliers and floating motions; sets ``residual``."""
        load = self.f - self._local_B @ self._in_petsc_order(multiplier)
        u = self._solver.solve(load) + self.modes @ alpha
        x, y = self.K.createVecs()
        x.array_w[:] = u
        self.K.mult(x, y)
        miss = np.abs(y.array_r - load).max(initial=0.0)
        sizes = [np.abs(self.f), np.abs(load), DRIFT * self.scale * np.abs(u)]
        size = max(a.max(initial=0.0) for a in sizes)
        for vector in (x, y):
            vector.destroy()
        found = np.max(self.comm.allgather((miss, size)), axis=0)
        self.residual = found[0] / max(found[1], 1e-300)
        return u

    def correct(self, multiplier: np.ndarray, alpha: np.ndarray) -> None:
        """Take h from the displacement for these multipliers: F and the pinned solve of the load
        alone are subject to rounding that the forces together are not."""
        u = self.displacement(multiplier, alpha)
        y = self._interface_sum(self._local_B.T @ u) - self.G @ alpha
        if self.comm.rank == 0:
            self.h = y + self.F @ multiplier

    def _in_petsc_order(self, values: np.ndarray) -> np.ndarray:
        """Values of the multipliers by their global number."""
        ordered = np.empty_like(values)
        ordered[self.rows.number] = values
        return ordered

    def destroy(self):
        self._solver.destroy()


def _local_csr(M) -> csr_matrix:
    """This rank's rows of a PETSc matrix, all columns."""
    indptr, indices, data = M.getValuesCSR()
    return csr_matrix((data, indices, indptr), (len(indptr) - 1, M.getSize()[1]))


def _refined(A: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Solves dense systems with A, rows scaled and with one step of refinement.

    Raises:
        numpy.linalg.LinAlgError: singular; when called.
    """
    if not len(A):  # supports hold the body, and nothing touches the obstacle
        return lambda b: b
    scale = 1.0 / np.maximum(np.abs(A).max(axis=1), 1e-300)[:, None]
    A = A * scale
    factor = scipy.linalg.lu_factor(A, check_finite=False)
    if not np.abs(np.diagonal(factor[0])).min(initial=np.inf) > 0.0:
        raise np.linalg.LinAlgError("a pivot is zero")

    def solve(b: np.ndarray) -> np.ndarray:
        b = b * scale
        x = scipy.linalg.lu_solve(factor, b, check_finite=False)
        x += scipy.linalg.lu_solve(factor, b - A @ x, check_finite=False)
        if not np.isfinite(x).all():
            raise np.linalg.LinAlgError("the solution is not finite")
        return x

    return solve
