"""Iteration of contact laws: which pairs are in contact, which stick and which slip.

Frictionless contact is a convex quadratic programme: the frame is a surface that separates the
bodies; on each side λ_n >= 0, gap >= 0, λ_n gap = 0, and L_bᵀ λ = 0 ((12), (15)). A primal-dual
active set finds it: a pair is in contact where λ_n - c gap > 0. v is free where contact is open; a
proximal term ε c (v - v_c) settles it, first about the mid-surface between the bodies, then about
its own last value, where it carries no force. Friction adds Newton rows per frame node
(``friction``). Works on the interface alone: arrays that are the same on every rank.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import block_diag, bsr_matrix, csr_matrix, diags, hstack, identity, vstack
from scipy.sparse.linalg import splu

from dolfinx_llm._parallel import ContactError
from dolfinx_llm.flexibility import InterfaceSystem
from dolfinx_llm.friction import OPEN, SLIP, STICK, newton_rows, projection_miss, switch_rows
from dolfinx_llm.operators import interface_operator

log = logging.getLogger("dolfinx_llm")

EARLY, LATE = 1e-4, 1e-8  # ε about the mid-surface, about the last value
HYSTERESIS = 1e-11  # relative: what rounding may not switch
EQUILIBRIUM = 1e-13  # residual of L_bᵀ λ and of the friction law, over the largest multiplier
MAXIMUM = 60  # iterations
SMALLEST = 1.0 / 16.0  # part of an increment that is tried before giving up


@dataclass
class InterfaceState:
    """One interface in the iteration: its place in the vectors, and what is in contact."""

    model: object
    rows: np.ndarray  # (n, c) its multiplier rows
    v: np.ndarray  # (m d,) its frame unknowns
    kappa: np.ndarray  # (k, d) its slip unknowns; empty without friction
    kept: np.ndarray  # (n c,) rows that are not redundant (prescribed on both sides)
    L: csr_matrix  # (n c, m d)
    L_kappa: csr_matrix  # (n c, k d)
    normal_weight: csr_matrix  # (k, n) normal force at the friction nodes from λ_n
    theta: float  # T = θ L_kappaᵀ λ, δ = Δκ / θ: 1/2 with two sides, 1 against an obstacle
    active: np.ndarray = field(init=False)  # (n,) pairs in contact
    status: np.ndarray = field(init=False)  # (k,) of the friction nodes
    kappa_before: np.ndarray = field(init=False)  # (k, d) at the end of the last load step [length]

    def __post_init__(self):
        self.active = np.ones(len(self.rows), dtype=bool)
        self.status = np.full(len(self.kappa), STICK)
        self.kappa_before = np.zeros(self.kappa.shape)

    @property
    def law(self):
        return self.model.interface.law

    def forces(self, multiplier: np.ndarray):
        """Tangential and normal forces (k, d), (k,) at the friction nodes."""
        own = multiplier[self.rows]
        T = self.theta * (self.L_kappa.T @ own.ravel())
        return T.reshape(self.kappa.shape), self.normal_weight @ own[:, -1]

    def slip(self, w: np.ndarray) -> np.ndarray:
        """(k, d) slip of this load step [length]."""
        return (w[self.kappa] - self.kappa_before) / self.theta


class ContactIteration:
    """States of all interfaces and the equations that follow from them.

    Args:
        models: the interfaces.
        redundant: (n,) multiplier rows that stay out.
        scale: mean stiffness of the surfaces [force / length].
        backend: linear steps, has load(f), solve(step, spring, centre) and
            displacement(multiplier, alpha), as ``Flexibility``.
        f, g: load and gaps at rest, from which the first load step starts.
    """

    def __init__(self, models, redundant: np.ndarray, scale: float, backend, f, g):
        self.scale, self.states, self.backend = scale, _states(models, redundant), backend
        self._rest, self._report = (f, g), None
        self.n = sum(state.rows.size for state in self.states)
        L = block_diag([state.L for state in self.states], format="csr")
        L_kappa = block_diag([state.L_kappa for state in self.states], format="csr")
        self.n_v = L.shape[1]
        kept = diags(np.concatenate([s.kept for s in self.states]).astype(float))
        self.L = (kept @ hstack([L, L_kappa])).tocsr()
        self.m = self.L.shape[1]
        self._fit = splu((self.L.T @ self.L + 1e-10 * identity(self.m)).tocsc()) if self.m else None
        self.forget()

    def forget(self):
        """Start anew: at rest, all in contact, no slip history."""
        for state in self.states:
            state.__post_init__()
        self.w = self.alpha = None
        self.f, self.g = self._rest

    def advance(self, f: np.ndarray, g: np.ndarray, increments: int):
        """One load step to this rank's load f and gaps g, in parts; halved where one fails.

        Returns:
            u of this rank, λ (n,), frame displacement (n_v,) and the pairs' status per interface.

        Raises:
            ContactError: no convergence even in small parts.
        """
        start, end = (self.f, self.g), (f, g)
        done, part, self.history = 0.0, 1.0 / increments, []
        while done < 1.0 - 1e-9:
            reached = min(done + part, 1.0)
            before = self.snapshot()
            f_t, g_t = (a + reached * (b - a) for a, b in zip(start, end, strict=True))
            if reached == 1.0:
                f_t, g_t = end
            self.backend.load(f_t)
            try:
                multiplier, y, w = self._iterate(g_t)
            except ContactError:
                self.restore(before)
                if part <= SMALLEST / increments:
                    raise
                part /= 2.0
                log.info("no convergence: the load is applied in parts of %.3g", part)
                continue
            self._accept(y, w, g_t)
            done = reached
        self.f, self.g = end
        u = self.backend.displacement(multiplier, self.alpha)
        return u, multiplier, w[: self.n_v], [self.pair_status(s) for s in self.states]

    def snapshot(self):
        """What a load step may have to be taken back to."""
        kept = [(s.active.copy(), s.status.copy(), s.kappa_before.copy()) for s in self.states]
        return kept, self.w, self.alpha

    def restore(self, snapshot):
        kept, self.w, self.alpha = snapshot
        for state, (active, status, before) in zip(self.states, kept, strict=True):
            state.active, state.status = active.copy(), status.copy()
            state.kappa_before = before.copy()

    def _iterate(self, g: np.ndarray):
        """Iterate to a state that meets all conditions, for the load that the backend holds.

        Returns:
            λ (n,) [force], y (n,) and w (m,) [length].

        Raises:
            ContactError: no convergence.
        """
        late, frozen, seen, history = False, False, set(), self.history
        first = len(history)
        w = np.zeros(self.m) if self.w is None else self.w
        multiplier, centre, alpha = np.zeros(self.n), w, self.alpha
        if self.w is None:
            centre = self._middle(g)
        alpha = np.zeros(self.backend.G.shape[1]) if alpha is None else alpha
        for iteration in range(1, MAXIMUM + 1):
            epsilon = LATE if late else EARLY
            step = self._step(multiplier, w, g, centre, epsilon)
            multiplier, y, w, alpha = self.backend.solve(step, epsilon * self.scale, alpha)
            largest = max(np.abs(multiplier).max(initial=0.0), 1e-300)
            changes, status_changes = self._update(multiplier, y, w, g, largest, frozen)
            balance = self._imbalance(multiplier) / largest
            friction = self._friction_miss(multiplier, w) / largest
            entry = self._count() | {
                "iteration": iteration, "changes": changes + status_changes,
                "residual": max(balance, friction),
            }  # fmt: skip
            history.append(entry)
            log.debug("contact law: %s", entry)
            settled = changes == 0 and friction <= max(EQUILIBRIUM, 1e-10 * (not late))
            if settled and late and balance <= EQUILIBRIUM:
                self.w, self.alpha = w, alpha
                return multiplier, y, w
            late = late or settled
            key = b"".join(s.active.tobytes() + s.status.tobytes() for s in self.states)
            if changes and key in seen and not frozen:
                frozen = True
                log.info("active set repeats in iteration %d: pairs one by one", iteration)
            seen.add(key)
            if late:
                centre = w
                self.backend.correct(multiplier, alpha)
            elif not frozen:
                centre = np.concatenate([self._middle(y + g)[: self.n_v], w[self.n_v :]])
        raise ContactError(self._failure(history[first:]))

    def _failure(self, history) -> str:
        last = history[-5:]
        return (
            f"the contact law did not converge in {len(history)} iterations; the last ones changed "
            f"{[h['changes'] for h in last]} states, with residuals "
            f"{', '.join(format(h['residual'], '.1e') for h in last)}. Apply the load in smaller "
            "steps (solve(increments=...)), or check that supports hold the bodies when they slip"
        )

    def _middle(self, position: np.ndarray) -> np.ndarray:
        """(m,) frame that fits the positions of all rows best."""
        return self._fit.solve(self.L.T @ position) if self.m else np.zeros(0)

    def _step(self, multiplier, w, g, centre, epsilon: float) -> InterfaceSystem:
        """The linear equations of one iteration about λ and w."""
        active = np.concatenate([
            np.repeat(s.active, s.rows.shape[1]) & s.kept for s in self.states
        ])  # fmt: skip
        frame = self.L[:, : self.n_v].T.tocsr()
        holds = np.concatenate([
            np.full(len(s.v), epsilon * self.scale * s.law.unilateral) for s in self.states
        ])  # fmt: skip
        E, D, rhs = [frame], [diags(-holds)], [-holds * centre[: self.n_v]]
        for s in self.states:
            if not s.kappa.size:
                continue
            T, N = s.forces(multiplier)
            delta = s.slip(w)
            if s.law.method == "switch":
                rows = switch_rows(T, N, delta, s.law.mu, self.scale, s.status)
            else:
                rows = newton_rows(T, N, delta, s.law.mu, self.scale)
            if self.w is None and not multiplier.any():  # nothing is known: stick, as in the paper
                rows = newton_rows(T, np.ones(len(N)), 0.0 * delta, 1.0, self.scale)
            E_k, D_k, rhs_k = self._friction_equations(s, rows, w, epsilon)
            E.append(E_k)
            D.append(D_k)
            rhs.append(rhs_k)
        return InterfaceSystem(
            active, self.L, g, vstack(E, format="csr"), block_diag(D, format="csr"),
            np.concatenate(rhs),
        )  # fmt: skip

    def _friction_equations(self, s: InterfaceState, rows, w, epsilon: float):
        """Rows of one interface's κ: E, D and right-hand side."""
        C_T, C_delta, C_N = _blocks(rows.C_T), _blocks(rows.C_delta), _blocks(rows.C_N[:, :, None])
        own = C_T @ (s.theta * s.L_kappa.T)
        normal = csr_matrix(
            (np.ones(len(s.rows)), (np.arange(len(s.rows)), s.rows[:, -1] - s.rows[0, 0])),
            (len(s.rows), s.rows.size),
        )
        own = own + C_N @ (s.normal_weight @ normal)
        before = s.kappa_before.ravel() / s.theta
        rhs = rows.rhs.ravel() + C_delta @ before
        # Where nothing else holds κ it stays: a term in its change, which vanishes at the solution.
        hold = epsilon * self.scale * np.repeat(rows.status != STICK, s.kappa.shape[1])
        D = C_delta / s.theta - diags(hold)
        rhs = rhs - hold * w[s.kappa.ravel()]
        at = own.tocoo()
        E = csr_matrix((at.data, (at.row, at.col + s.rows[0, 0])), (own.shape[0], self.n))
        return E, D, rhs

    def _update(self, multiplier, y, w, g, largest: float, single: bool):
        """New active sets and friction states; how many changed."""
        gap = self.L @ w - y - g
        changes = status_changes = 0
        worst = None
        for i, s in enumerate(self.states):
            if s.law.unilateral:
                normal = s.rows[:, -1]
                value = multiplier[normal] - self.scale * gap[normal]
                band = HYSTERESIS * max(largest, self.scale * np.abs(y + g).max(initial=0.0))
                active = np.where(s.active, value >= -band, value > band)
                flips = np.flatnonzero(active != s.active)
                changes += len(flips)
                if single:  # Murty's rule: the last one of all that are wrong
                    worst = (i, flips[-1]) if len(flips) else worst
                else:
                    s.active = active
            if s.kappa.size:
                T, N = s.forces(multiplier)
                before = s.status
                delta = s.slip(w)
                if s.law.method == "switch":
                    s.status = switch_rows(T, N, delta, s.law.mu, self.scale, before).status
                else:
                    s.status = newton_rows(T, N, delta, s.law.mu, self.scale).status
                status_changes += int((s.status != before).sum())
        if worst is not None:
            state = self.states[worst[0]]
            state.active = state.active.copy()
            state.active[worst[1]] ^= True
        return changes, status_changes

    def _imbalance(self, multiplier) -> float:
        """Largest entry of L_bᵀ λ [force]."""
        return float(np.abs(self.L[:, : self.n_v].T @ multiplier).max(initial=0.0))

    def _friction_miss(self, multiplier, w) -> float:
        """Largest distance of a tangential force from Coulomb's law [force]."""
        worst = 0.0
        for s in self.states:
            if s.kappa.size:
                T, N = s.forces(multiplier)
                miss = projection_miss(T, N, s.slip(w), s.law.mu, self.scale)
                worst = max(worst, float(miss.max(initial=0.0)))
        return worst

    def _count(self) -> dict:
        """Numbers of pairs in contact and of friction nodes that stick and slip."""
        active = stick = slip = 0
        for s in self.states:
            active += int(s.active.sum())
            if s.law.friction:
                stick += int((s.status == STICK).sum())
                slip += int((s.status == SLIP).sum())
            elif s.law.unilateral:
                slip += int(s.active.sum())
            else:
                stick += int(s.active.sum())
        return {"active": active, "stick": stick, "slip": slip}

    def _accept(self, y, w, g):
        """End a load step: what has slipped is the reference of the next; where contact is open, κ
        follows the bodies."""
        fitted = self._middle(y + g)
        for s in self.states:
            if s.kappa.size:
                opened = (s.status == OPEN)[:, None]
                s.kappa_before = np.where(opened, fitted[s.kappa], w[s.kappa])

    def pair_status(self, s: InterfaceState) -> np.ndarray:
        """(n,) OPEN, STICK or SLIP per pair; with friction that of the frame node next to it."""
        if not s.law.unilateral:
            return np.full(len(s.rows), STICK)
        status = np.full(len(s.rows), SLIP)
        if s.law.friction:
            N = vstack([p.N for p in s.model.pairs]) if s.model.frame else identity(len(s.rows))
            status = s.status[np.asarray(N.tocsr().argmax(axis=1)).ravel()]
            status = np.where(status == OPEN, STICK, status)
        return np.where(s.active, status, OPEN)


def _blocks(C: np.ndarray):
    """Block diagonal matrix of (n, a, b)."""
    n = len(C)
    return bsr_matrix((C, np.arange(n), np.arange(n + 1)), (n * C.shape[1], n * C.shape[2])).tocsr()


def _states(models, redundant: np.ndarray) -> list[InterfaceState]:
    """States of the interfaces, numbered through: rows, frame unknowns, then slip unknowns."""
    states, row, col = [], 0, 0
    first_kappa = sum(model.directions.shape[0] * model.directions.shape[1] for model in models)
    for model in models:
        n, c = sum(len(p.nodes) for p in model.pairs), model.pairs[0].base.shape[1]
        rows = row + np.arange(n * c).reshape(n, c)
        v = col + np.arange(model.directions.shape[0] * model.directions.shape[1])
        L_kappa, weight, theta = _slip_operators(model)
        d = c - 1 if model.interface.law.friction else 1
        kappa = first_kappa + np.arange(L_kappa.shape[1]).reshape(-1, d)
        L = interface_operator(model.pairs, model.directions)
        kept = ~redundant[row : row + n * c]
        states.append(InterfaceState(model, rows, v, kappa, kept, L, L_kappa, weight, theta))
        row, col, first_kappa = row + n * c, col + len(v), first_kappa + L_kappa.shape[1]
    return states


def _slip_operators(model):
    """L_kappa (n c, k d), weights of λ_n at the friction nodes (k, n), and θ."""
    n, c = sum(len(p.nodes) for p in model.pairs), model.pairs[0].base.shape[1]
    if not model.interface.law.friction:
        return csr_matrix((n * c, 0)), csr_matrix((0, n)), 1.0
    if model.frame is None:
        tangential = np.flatnonzero(np.arange(n * c) % c != c - 1)
        L = identity(n * c, format="csr")[:, tangential]
        return L, identity(n, format="csr"), 1.0
    sides = []
    for p, sign in zip(model.pairs, (1.0, -1.0), strict=True):
        base = sign * p.base  # the same tangents on both sides: both slip by κ in their own base
        base[:, -1] = 0.0
        sides.append(replace(p, base=base))
    L = interface_operator(sides, model.directions[:, :-1])
    weight = 0.5 * vstack([p.N for p in model.pairs]).T.tocsr()
    return L, weight, 0.5
