"""Iteration of contact laws: which pairs are in contact, which stick and which slip.

Frictionless contact is a convex quadratic programme: the frame is a surface that separates the
bodies; on each side λ_n >= 0, gap >= 0, λ_n gap = 0, and L_bᵀ λ = 0 ((12), (15)). v is free where
contact is open; a proximal term -ε c (v - v_c) settles it, about the mid-surface between the bodies
while contact changes, then about its own last value, where it carries no force. Friction adds
Newton rows per frame node (``friction``) in the slip κ of (13). Each iteration finds the pairs in
contact exactly, for the law of friction linearised about the last one. Works on the interface
alone: arrays that are the same on every rank.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse import block_diag, bsr_matrix, coo_matrix, csr_matrix, diags, hstack, identity
from scipy.sparse import vstack as stack
from scipy.sparse.linalg import splu
from tqdm import tqdm

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.log import tell_iteration
from dolfinx_llm.contact.state import InterfaceState, interface_states
from dolfinx_llm.forms.floating import Pull
from dolfinx_llm.forms.step import SIGN, SOFT, LinearStep, StepForm, StepResult, force_level
from dolfinx_llm.forms.verdict import FinalError, Verdict, judge
from dolfinx_llm.laws.law import OPEN, SLIP, STICK
from dolfinx_llm.operators.system import ContactOperators

log = logging.getLogger("dolfinx_llm")

ENOUGH = 1e-10  # residual that may be left where it has stopped falling
MAXIMUM = 60  # iterations
FEW = 0.02  # of the pairs: where no more change, those that close do so for reasons of their own
LIGHT = 1e-3  # of the largest force: pairs with less are at the rim of contact
CALM = 2  # iterations without a change after which a residual may have stopped falling
SMALLEST = 1.0 / 16.0  # part of an increment that is tried before giving up


class ContactIteration:
    """States of all interfaces and the equations that follow from them.

    Args:
        operators: of the interfaces.
        form: solves linear steps.
        f, g: this rank's load and the gaps at rest, from which the first load step starts.
    """

    def __init__(self, operators: ContactOperators, form: StepForm, f: np.ndarray, g: np.ndarray):
        self.scale, self.form, self._rest = operators.scale, form, (f, g)
        self._compliance = np.where(operators.soft, SOFT / self.scale, 0.0)
        self.bar: tqdm | None = None  # progress line, while there is one
        self.states = interface_states(operators)
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
        self._drifts = np.zeros(self.m, dtype=bool)  # normal motion of frames
        for s in self.states:
            self._normal[s.rows[:, -1]] = s.law.unilateral
            if len(s.v):
                self._drifts[s.v.reshape(-1, s.model.directions.shape[1])[:, -1]] = True
        self._calmed = False
        self.forget()

    def forget(self):
        """Start anew: at rest, all in contact, no slip history."""
        for state in self.states:
            state.forget()
        self.multiplier: Any = None  # (n,) [force]; None: nothing has been solved
        self.w: Any = None  # (m,) [length]
        self.alpha: Any = None  # rigid motion of bodies that nothing else holds
        self.forces = 0.0  # largest so far
        self.verdict = Verdict(0.0, 0.0)  # of the last load step
        self.f, self.g = self._rest
        self.history: list[dict] = []

    def resume(self, other: ContactIteration, f: np.ndarray, g: np.ndarray, u: np.ndarray):
        """Go on from the state of another iteration of the same pairs and frames.

        Args:
            other: where it ended.
            f, g: this rank's load and the gaps with which bodies and operators of this one are in
                balance there.
            u: this rank's displacement there.
        """
        if other.multiplier is None:
            return
        for state, kept in zip(self.states, other.states, strict=True):
            state.restore(kept.snapshot())
        self.multiplier, self.w = other.multiplier, other.w
        self.alpha = self.form.floating.amounts(u)  # of other modes, perhaps
        self.forces = other.forces
        self.f, self.g = f, g

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
            try:
                found = self._iterate(f_t, g_t)
            except FinalError:
                self._restore(first)
                raise
            except ContactError:
                self._restore(before)
                if part <= SMALLEST / increments:
                    self._restore(first)
                    raise
                part /= 2.0
                log.info("no convergence: the load is applied in parts of %.3g", part)
                continue
            try:
                u = self._judged(found)
            except ContactError:
                self._restore(first)
                raise
            self._accept(found.y, found.w, g_t)
            done = reached
        self.f, self.g = end
        return u, found.multiplier, found.w[: self.n_v]

    def _judged(self, found: StepResult) -> np.ndarray:
        """u of this rank, once its equations hold."""
        comm = self.form.comm
        u, left, terms, loads = self.form.displacement(found)
        largest = [np.abs(a).max(initial=0.0) for a in (loads, found.multiplier)]
        self.forces = max(self.forces, float(np.max(comm.allgather(largest))))
        verdict = judge(comm, left, terms, self.forces, self.form.name)
        on = diags(np.concatenate([s.closed_rows() for s in self.states]).astype(float))
        self.verdict = replace(
            verdict, drift=self.form.floating.drift((on @ self.L[:, : self.n_v]).tocsr())
        )
        for words in self.verdict.lost if comm.rank == 0 else []:
            log.warning(words)
        return u

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

    def _iterate(self, f: np.ndarray, g: np.ndarray) -> StepResult:
        """Iterate to a state that meets all conditions, for this rank's load f and gaps g (n,).

        Raises:
            ContactError: no convergence.
        """
        first, known = len(self.history), self.w is not None
        w = self.w if known else np.zeros(self.m)
        centre = w if known else self._middle(g)
        floating = self.form.floating
        alpha = self.alpha if known else np.zeros(floating.count)
        about: Any = (self.multiplier if known else np.zeros(self.n), w)
        calm, self._calmed = 0, False  # iterations without a change of state; whether any was
        before, w_last = np.inf, w  # last residual and motion
        corrections = min(floating.count, 1)  # what springs hold is corrected once at least
        spring = floating.spring(self.scale)
        pull = Pull(floating, spring, f, self.forces, alpha)
        for s in self.states:
            s.begin()
        for iteration in range(1, MAXIMUM + 1):
            step = self._step(about, g, centre, (pull.anchor, spring))
            if not known and iteration == 1:
                step = self._all_stick(step)
            found = self.form.solve(f, step)
            multiplier, y, w = found.multiplier, found.y, found.w
            largest = force_level(multiplier, y + g, self.scale)
            changes = sum(self._take(s, found) for s in self.states)
            miss = max(self._imbalance(multiplier), self._friction_miss(multiplier, w)) / largest
            entry = {"iteration": iteration, **self._count(), "changes": changes, "residual": miss}
            self.history.append(entry)
            tell_iteration(entry, self.bar)
            calm = 0 if changes else calm + 1
            pull.watch(found.floating, multiplier, calm, self.form.noise)
            stalled = calm > CALM and miss > 0.5 * before
            enough = max(ENOUGH, self.form.noise / largest)
            settled = miss <= self.form.accuracy or (stalled and miss <= enough)
            if settled and calm > corrections and pull.rests:
                self.multiplier, self.w, self.alpha = multiplier, w, found.floating
                return found
            # Friction is linearised about the last iterate, or halfway where that did not help.
            half = iteration > 1 and changes and miss > 0.9 * before
            about = tuple(0.5 * (a + b) if half else b for a, b in zip(about, (multiplier, w)))
            before = miss
            # From then on the frame goes on from where it is, and what no force holds stays.
            self._calmed = self._calmed or calm > 0
            centre = w if self._calmed else self._middle(y + g)
            if stalled:  # a frame node under a tiny force goes to where it touches, ever faster
                centre = w + (2.0**calm - 1.0) * np.where(self._drifts, w - w_last, 0.0)
            w_last = w
            if calm:
                self.form.correct(found)
        raise ContactError(self._failure(self.history[first:]))

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

    def _step(self, about: Any, g: np.ndarray, centre: np.ndarray, held: Any) -> LinearStep:
        """The linear equations of one iteration about λ and w.

        Args:
            about: λ and w of the last iterate.
            g: gaps.
            centre: of the proximal term.
            held: where springs hold free bodies, and their stiffness.
        """
        active = np.concatenate([s.closed_rows() for s in self.states])
        P = self._proximal()
        gather = self._frame_gather()
        own = gather @ P[: self.n_v]
        relative = block_diag([s.frame_relative for s in self.states], format="csr")
        relative.resize(own.shape)
        E, D, rhs = [gather @ self._L_t], [own + self.scale * relative], [own @ centre]
        for s in self.states:
            if s.kappa.size:
                rows = self._friction_rows(s, *about)
                C_T, C_delta = _blocks(rows.C_T), _blocks(rows.C_delta) / s.theta
                E.append(s.friction_operator(C_T, _blocks(rows.C_N[:, :, None]), self.n))
                # The proximal force stands beside T.
                own = s.theta * C_T @ s.gather @ P[s.kappa.ravel()]
                C_delta = C_delta @ s.relative
                D.append(own + C_delta @ s.selection(self.m))
                given = rows.rhs - rows.C_N * s.cohesion(about[0])[:, None]
                rhs.append(own @ centre + given.ravel() + C_delta @ s.kappa_before.ravel())
        frame = stack(E, format="csr"), stack(D, format="csr"), np.concatenate(rhs)
        every = active, self._normal, self.L, g, self._compliance
        return LinearStep(*every, *frame, *held)

    def _friction_rows(self, s: InterfaceState, multiplier, w):
        T, bound = s.forces(multiplier)
        rows = s.law.rows(T, bound, s.slip(w), s.slip_stiffness(self.scale), s.status)
        return rows.tied(s.speaker, s.unheld & self._calmed, self.scale)

    def _all_stick(self, step: LinearStep) -> LinearStep:
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
        return replace(step, E=E, D=D, rhs=rhs)

    def _proximal(self) -> csr_matrix:
        """(m, m) matrix of the proximal term -ε c (w - w_c).

        With friction each side's own field, v + κ and v - κ, is held as firmly as its pairs are.
        """
        row, col, value = [np.empty(0, dtype=int)], [np.empty(0, dtype=int)], [np.empty(0)]

        def add(i, j, x):
            row.append(i)
            col.append(j)
            value.append(-self.form.proximal * self.scale * x)

        for s in self.states:
            if not s.law.unilateral:
                continue
            support, t = s.support(tied=True), s.kappa.shape[1] if s.kappa.size else 0
            both = sum(support)
            if len(s.v):
                v = s.v.reshape(-1, s.model.directions.shape[1])
                add(v[:, -1], v[:, -1], sum(s.support(tied=False)))
                for i in range(t):
                    difference = support[0] - support[1]
                    add(v[:, i], v[:, i], both)
                    add(v[:, i], s.kappa[:, i], difference)
                    add(s.kappa[:, i], v[:, i], difference)
            for i in range(t):
                add(s.kappa[:, i], s.kappa[:, i], both)
        index = np.concatenate(row), np.concatenate(col)
        return coo_matrix((np.concatenate(value), index), (self.m, self.m)).tocsr()

    def _take(self, s: InterfaceState, found: StepResult) -> int:
        """Take over the pairs in contact, and find what sticks and slips; number of changes."""
        normal = s.rows[:, -1]
        chosen = found.active[normal] ^ found.wrong[normal] if s.law.unilateral else s.active
        changed, force = chosen != s.active, np.abs(found.multiplier)
        largest = force.max(initial=0.0)
        light = (changed.sum() <= FEW * len(chosen) + 2) | (force[normal] <= LIGHT * largest)
        s.closings += np.where(chosen & ~s.active, np.where(light, 4, 1), 0)
        s.touch(chosen)
        # What carries nothing is in contact or not, sticks or slips, to no effect; a sign that is
        # wrong has to change, also where its pair then is as it was.
        felt = changed & (force[s.rows].max(axis=1) > SIGN * largest)
        changes = int((felt | found.wrong[normal]).sum())
        if s.kappa.size:
            rows = self._friction_rows(s, found.multiplier, found.w)
            T, bound = s.forces(found.multiplier)
            z = T + s.slip_stiffness(self.scale)[:, None] * s.slip(found.w)
            # At the limit and without slip a node sticks and slips alike.
            apart = np.abs(np.linalg.norm(z, axis=1) - bound)
            size = np.maximum(np.linalg.norm(T, axis=1), np.abs(bound))
            felt = np.minimum(size, apart) > SIGN * largest
            changes += int(((rows.status != s.status) & felt).sum())
            s.status = rows.status
        return changes

    def _imbalance(self, multiplier) -> float:
        """Largest entry of L_bᵀ λ [force]; of nodes that follow others in the sum with theirs."""
        return float(np.abs(self._frame_gather() @ (self._L_t @ multiplier)).max(initial=0.0))

    def _frame_gather(self) -> csr_matrix:
        """(n_v, n_v) forces at the frame's nodes, summed up where equilibrium is asked for."""
        return block_diag([s.frame_gather for s in self.states], format="csr")

    def _friction_miss(self, multiplier, w) -> float:
        """Largest distance of a tangential force from Coulomb's law [force]."""
        worst = 0.0
        for s in self.states:
            if s.kappa.size:
                T, bound = s.forces(multiplier)
                miss = s.law.miss(T, bound, s.slip(w), s.slip_stiffness(self.scale))
                worst = max(worst, float(miss.max(initial=0.0)))
        return worst

    def _count(self) -> dict:
        """Numbers of pairs in contact, and of those that stick and slip."""
        status = np.concatenate([s.pair_status() for s in self.states])
        counts = np.bincount(status, minlength=4)
        return {
            "active": int(len(status) - counts[OPEN]),
            "stick": int(counts[STICK]),
            "slip": int(counts[SLIP]),
        }


def _blocks(C: np.ndarray) -> csr_matrix:
    """Block diagonal matrix of (n, a, b)."""
    n = len(C)
    return bsr_matrix((C, np.arange(n), np.arange(n + 1)), (n * C.shape[1], n * C.shape[2])).tocsr()
