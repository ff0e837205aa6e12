"""Iteration of contact laws: which pairs are in contact, which stick and which slip.

Frictionless contact is a convex quadratic programme: the frame is a surface that separates the
bodies; on each side λ_n >= 0, gap >= 0, λ_n gap = 0, and L_bᵀ λ = 0 ((12), (15)). v is free where
contact is open; a proximal term -ε c (v - v_c) settles it, first about the mid-surface between the
bodies, then about its own last value, where it carries no force. Friction adds Newton rows per
frame node (``friction``) in the slip κ of (13). Works on the interface alone: arrays that are the
same on every rank.
"""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
from scipy.sparse import block_diag, bsr_matrix, coo_matrix, csr_matrix, diags, hstack, identity
from scipy.sparse import vstack as stack
from scipy.sparse.linalg import splu
from tqdm import tqdm

from dolfinx_llm._log import tell_iteration
from dolfinx_llm._parallel import ContactError
from dolfinx_llm.friction import OPEN, SLIP, STICK, newton_rows, projection_miss, switch_rows
from dolfinx_llm.linear_step import InterfaceSystem, force_level
from dolfinx_llm.states import InterfaceState, interface_states

log = logging.getLogger("dolfinx_llm")

EPSILON = (1e-4, 1e-6, 1e-8)  # ε about the mid-surface; about the values settled on before
UNBALANCED = 1e-8  # residual of K u + B λ = f, over the forces' size
STALLED = 100.0  # times the accuracy asked for: what a residual may stop falling at
MAXIMUM = 60  # iterations
STEADY = 1e-3  # relative change of a frame's motion below which it drifts
CREEPS = 5  # calm iterations before slip that still moves steadily counts as creep
PATIENCE = 8  # iterations before steps are halved; earlier that only delays Newton's
SMALLEST = 1.0 / 16.0  # part of an increment that is tried before giving up


class ContactIteration:
    """States of all interfaces and the equations that follow from them.

    Args:
        models: the interfaces.
        redundant: (n,) multiplier rows that stay out.
        scale: mean stiffness of the surfaces, c [force / length].
        backend: solves linear steps: load(f), solve(step, spring, centre, may_open),
            correct(multiplier, alpha) and displacement(multiplier, alpha), to ``accuracy`` of the
            largest multiplier in L_bᵀ λ and the law of friction; see ``Flexibility``.
        f, g: this rank's load and the gaps at rest, from which the first load step starts.
    """

    def __init__(self, models, redundant: np.ndarray, scale: float, backend, f, g):
        self.scale, self.backend, self._rest = scale, backend, (f, g)
        self.bar: tqdm | None = None  # progress line, while there is one
        self.states = interface_states(models, redundant)
        self.n = sum(state.rows.size for state in self.states)
        L = block_diag([state.L for state in self.states], format="csr")
        L_kappa = block_diag([state.L_kappa for state in self.states], format="csr")
        kept = diags(np.concatenate([s.kept for s in self.states]).astype(float))
        self.L = (kept @ hstack([L, L_kappa])).tocsr()
        self.n_v, self.m = L.shape[1], self.L.shape[1]
        self._L_t = self.L[:, : self.n_v].T.tocsr()
        self._fit: Any = (
            splu((self.L.T @ self.L + 1e-10 * identity(self.m)).tocsc()) if self.m else None
        )
        self._normal = np.zeros(self.n, dtype=bool)  # rows that may open
        self._slips = np.arange(self.m) >= self.n_v  # κ
        self._waits = np.zeros(self.m, dtype=bool)  # normal motion of frames that may open
        for s in self.states:
            self._normal[s.rows[:, -1]] = s.law.unilateral
            if len(s.v):
                self._waits[s.v.reshape(-1, s.model.directions.shape[1])[:, -1]] = True
        self.forget()

    def forget(self):
        """Start anew: at rest, all in contact, no slip history."""
        for state in self.states:
            state.forget()
        self.multiplier: Any = None  # (n,) [force]; None: nothing has been solved
        self.w: Any = None  # (m,) [length]
        self.alpha: Any = None  # motion of floating bodies
        self.f, self.g = self._rest
        self.history: list[dict] = []

    def advance(self, f: np.ndarray, g: np.ndarray, increments: int):
        """One load step to this rank's load f and gaps g, in parts; halved where one fails.

        Returns:
            u of this rank, λ (n,) and the frames' displacement (n_v,).

        Raises:
            ContactError: no convergence even in small parts.
        """
        start, end = (self.f, self.g), (f, g)
        done, part, self.history = 0.0, 1.0 / increments, []
        first = self._snapshot()
        while done < 1.0 - 1e-9:
            reached = min(done + part, 1.0)
            f_t, g_t = (a + reached * (b - a) for a, b in zip(start, end, strict=True))
            if reached > 1.0 - 1e-9:
                f_t, g_t = end
            before = self._snapshot()
            self.backend.load(f_t)
            try:
                multiplier, y, w = self._iterate(g_t)
            except ContactError:
                self._restore(before)
                if part <= SMALLEST / increments:
                    self._restore(first)
                    raise
                part /= 2.0
                log.info("no convergence: the load is applied in parts of %.3g", part)
                continue
            u = self.backend.displacement(multiplier, self.alpha)
            if not self.backend.residual <= UNBALANCED:
                self._restore(first)
                raise ContactError(
                    f"contact and supports do not balance the load: {self.backend.residual:.1e} of "
                    "the forces' size is left. A body that only contact holds is pulled off, or "
                    "slides away. Add supports, or springs, or prescribe its motion"
                )
            self._accept(y, w, g_t)
            done = reached
        self.f, self.g = end
        return u, multiplier, w[: self.n_v]

    def _snapshot(self):
        """What a load step may have to be taken back to."""
        return [s.snapshot() for s in self.states], self.multiplier, self.w, self.alpha

    def _restore(self, snapshot):
        states, self.multiplier, self.w, self.alpha = snapshot
        for state, kept in zip(self.states, states, strict=True):
            state.restore(kept)

    def _accept(self, y, w, g):
        """End a load step: what has slipped is the reference of the next."""
        fitted = self._middle(y + g)
        for s in self.states:
            s.accept(w, fitted)

    def _iterate(self, g: np.ndarray):
        """Iterate to a state that meets all conditions, for the load that the backend holds.

        Returns:
            λ (n,) [force], y (n,) and w (m,) [length].

        Raises:
            ContactError: no convergence.
        """
        first, known = len(self.history), self.w is not None
        w = self.w if known else np.zeros(self.m)
        centre = w if known else self._middle(g)
        alpha = self.alpha if known else np.zeros(self.backend.floating)
        about = (self.multiplier if known else np.zeros(self.n), w)
        alpha_centre, before, phase, calm, w_last = alpha, np.inf, 0, 0, w
        drift, frictional = np.full(self.m, np.inf), any(s.kappa.size for s in self.states)
        for s in self.states:
            s.closings[:] = 0
        for iteration in range(1, MAXIMUM + 1):
            epsilon = EPSILON[min(phase, len(EPSILON) - 1)]
            step = self._step(*about, g, centre, epsilon, EPSILON[0] * 0.1**calm)
            if not known and iteration == 1:
                step = self._all_stick(step)
            multiplier, y, w, alpha, active, wrong = self.backend.solve(
                step, epsilon * self.scale, alpha_centre, self._normal
            )
            largest = force_level(multiplier, y + g, self.scale)
            changes = sum(self._take(s, active, wrong, multiplier, w) for s in self.states)
            miss = max(self._imbalance(multiplier), self._friction_miss(multiplier, w)) / largest
            entry = {"iteration": iteration, **self._count(), "changes": changes, "residual": miss}
            self.history.append(entry)
            tell_iteration(entry, self.bar)
            calm, last_miss = 0 if changes else calm + 1, before
            # Friction is linearised about the last iterate; halfway where that keeps not helping.
            half = iteration > PATIENCE and changes and miss > 0.9 * before
            about = tuple(0.5 * (a + b) if half else b for a, b in zip(about, (multiplier, w)))
            if calm > CREEPS and miss > 0.5 * before:  # slip creeps: go on to where it turns round
                w = w + self._until_reversal(w, w - w_last) * np.where(self._slips, w - w_last, 0.0)
                about = multiplier, w
            w_last = w
            before = miss
            # About a centre that stays, without friction, a step chooses its pairs exactly.
            if changes == 0 or (phase and not (frictional or wrong.any())):
                # Settled about this centre: go on about the values found.
                if phase and self._accurate(miss, last_miss):
                    self.multiplier, self.w, self.alpha = multiplier, w, alpha
                    return multiplier, y, w
                last, drift, ahead = drift, np.where(self._waits, w - centre, 0.0), 0.0
                if np.abs(drift - last).max(initial=0.0) <= STEADY * np.abs(drift).max(initial=0.0):
                    ahead = self._until_next(active, y, w, drift, g)
                phase, centre, alpha_centre = phase + 1, w + ahead * drift, alpha
                self.backend.correct(multiplier, alpha)
            elif phase == 0:
                centre, alpha_centre = self._middle(y + g), alpha
            else:  # tangentially the centre follows, normally it waits
                centre = np.where(self._waits, centre, w)
        raise ContactError(self._failure(self.history[first:]))

    def _accurate(self, miss: float, before: float) -> bool:
        """Whether the residual is small, or as small as rounding lets it become."""
        goal = self.backend.accuracy
        return miss <= goal or (miss <= STALLED * goal and miss > 0.5 * before)

    def _until_reversal(self, w, drift) -> float:
        """How many steps like the last one it takes until slip at some friction node turns round.

        At the rim of contact, where a node's slip moves hardly any pair, the wrong sense of slip
        is felt by a tiny force only, and slip creeps towards the right one.
        """
        least = np.inf
        for s in self.states:
            if s.kappa.size:
                delta, rate = (
                    s.slip(w)[s.status == SLIP],
                    drift[s.kappa][s.status == SLIP] / s.theta,
                )
                towards = -np.einsum("ni,ni->n", delta, rate)
                speed = np.linalg.norm(rate, axis=1)
                quick = (towards > 0.0) & (speed > STEADY * speed.max(initial=0.0))
                size = np.linalg.norm(delta, axis=1)[quick]
                least = min(least, (size / speed[quick]).min(initial=np.inf))
        return 1.01 * least if np.isfinite(least) else 0.0

    def _until_next(self, active, y, w, drift, g) -> float:
        """How many steps like the last one the frame drifts until it touches the next pair.

        A frame node that few pairs hold moves steadily under a force that is too small for the
        proximal term to feel, by force / (ε c) a step.
        """
        gap, rate = self.L @ w - y - g, self.L @ drift
        closing = self._normal & ~active & (rate < -1e-12 * np.abs(rate).max(initial=0.0))
        if not closing.any():
            return 0.0
        return float((gap[closing] / -rate[closing]).clip(0.0).min())

    def _failure(self, history) -> str:
        last = history[-5:]
        return (
            f"the contact law did not converge in {len(history)} iterations, also not with the "
            f"load in {round(1 / SMALLEST)} parts; the last iterations changed "
            f"{[h['changes'] for h in last]} states, with residuals "
            f"{', '.join(format(h['residual'], '.1e') for h in last)}. Apply the load in smaller "
            "steps (solve(increments=...)), and check that supports hold the bodies when they slip"
        )

    def _middle(self, position: np.ndarray) -> np.ndarray:
        """(m,) frame that fits the positions of all rows best."""
        return self._fit.solve(self.L.T @ position) if self.m else np.zeros(0)

    def _step(self, multiplier, w, g, centre, epsilon: float, sideways: float) -> InterfaceSystem:
        """The linear equations of one iteration about λ and w.

        Args:
            multiplier, w: last iterate.
            g: gaps.
            centre: of the proximal term.
            epsilon, sideways: its size along the normal and along tangents.
        """
        active = np.concatenate([s.closed_rows() for s in self.states])
        P = self._proximal(epsilon, sideways)
        E, D, rhs = [self._L_t], [P[: self.n_v]], [P[: self.n_v] @ centre]
        for s in self.states:
            if s.kappa.size:
                rows = self._friction_rows(s, multiplier, w)
                C_T, C_delta = _blocks(rows.C_T), _blocks(rows.C_delta) / s.theta
                E.append(s.friction_operator(C_T, _blocks(rows.C_N[:, :, None]), self.n))
                own = s.theta * C_T @ P[s.kappa.ravel()]  # the proximal force stands beside T
                D.append(own + C_delta @ s.selection(self.m))
                rhs.append(own @ centre + rows.rhs.ravel() + C_delta @ s.kappa_before.ravel())
        return InterfaceSystem(
            active, self.L, g, stack(E, format="csr"), stack(D, format="csr"), np.concatenate(rhs)
        )

    def _friction_rows(self, s: InterfaceState, multiplier, w):
        T, N = s.forces(multiplier)
        delta, c = s.slip(w), s.slip_stiffness(self.scale)
        if s.law.method == "switch":
            return switch_rows(T, N, delta, s.law.mu, c, s.status)
        return newton_rows(T, N, delta, s.law.mu, c)

    def _all_stick(self, step: InterfaceSystem) -> InterfaceSystem:
        """The first step, when nothing is known: all stick, as in the paper."""
        for s in self.states:
            s.status[:] = STICK
        first, count = self.n_v, self.m - self.n_v
        select = csr_matrix((np.ones(count), (np.arange(count), first + np.arange(count))),
                            (count, self.m))  # fmt: skip
        E = stack([step.E[:first], csr_matrix((count, self.n))], format="csr")
        D = stack([step.D[:first], self.scale * select], format="csr")
        before = [s.kappa_before.ravel() for s in self.states]
        rhs = np.concatenate([step.rhs[:first], self.scale * np.concatenate(before)])
        return InterfaceSystem(step.active, step.L, step.g, E, D, rhs)

    def _proximal(self, epsilon: float, sideways: float) -> csr_matrix:
        """(m, m) matrix of the proximal term -ε c (w - w_c).

        With friction each side's own field, v + κ and v - κ, is held as firmly as its pairs are.
        """
        row, col, value = [np.empty(0, dtype=int)], [np.empty(0, dtype=int)], [np.empty(0)]

        def add(i, j, x):
            row.append(i)
            col.append(j)
            value.append(-self.scale * x)

        for s in self.states:
            if not s.law.unilateral:
                continue
            support, t = s.support(tied=True), s.kappa.shape[1] if s.kappa.size else 0
            both = sideways * sum(support)
            if len(s.v):
                v = s.v.reshape(-1, s.model.directions.shape[1])
                add(v[:, -1], v[:, -1], epsilon * sum(s.support(tied=False)))
                for i in range(t):
                    difference = sideways * (support[0] - support[1])
                    add(v[:, i], v[:, i], both)
                    add(v[:, i], s.kappa[:, i], difference)
                    add(s.kappa[:, i], v[:, i], difference)
            for i in range(t):
                add(s.kappa[:, i], s.kappa[:, i], both)
        index = np.concatenate(row), np.concatenate(col)
        return coo_matrix((np.concatenate(value), index), (self.m, self.m)).tocsr()

    def _take(self, s: InterfaceState, active, wrong, multiplier, w) -> int:
        """Take over the pairs in contact, and find what sticks and slips; number of changes."""
        normal = s.rows[:, -1]
        chosen = active[normal] ^ wrong[normal] if s.law.unilateral else s.active
        changes = int((chosen != s.active).sum())
        s.closings += chosen & ~s.active
        s.active = chosen
        if s.kappa.size:
            status = self._friction_rows(s, multiplier, w).status
            changes += int((status != s.status).sum())
            s.status = status
        return changes

    def _imbalance(self, multiplier) -> float:
        """Largest entry of L_bᵀ λ [force]."""
        return float(np.abs(self._L_t @ multiplier).max(initial=0.0))

    def _friction_miss(self, multiplier, w) -> float:
        """Largest distance of a tangential force from Coulomb's law [force]."""
        worst = 0.0
        for s in self.states:
            if s.kappa.size:
                T, N = s.forces(multiplier)
                miss = projection_miss(T, N, s.slip(w), s.law.mu, s.slip_stiffness(self.scale))
                worst = max(worst, float(miss.max(initial=0.0)))
        return worst

    def _count(self) -> dict:
        """Numbers of pairs in contact, and of those that stick and slip."""
        status = np.concatenate([s.pair_status() for s in self.states])
        counts = np.bincount(status, minlength=3)
        return {
            "active": int(len(status) - counts[OPEN]),
            "stick": int(counts[STICK]),
            "slip": int(counts[SLIP]),
        }


def _blocks(C: np.ndarray) -> csr_matrix:
    """Block diagonal matrix of (n, a, b)."""
    n = len(C)
    return bsr_matrix((C, np.arange(n), np.arange(n + 1)), (n * C.shape[1], n * C.shape[2])).tocsr()
