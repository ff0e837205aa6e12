"""Steps of contact laws on the whole system, set up anew in each: for large interfaces.

The same as ``flexibility``, where the surfaces have so many nodes that asking the bodies for their
answer to every multiplier costs more than a few factorisations. They are asked for the few whose
sign is wrong, and for those that get it wrong in turn.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dolfinx_llm.base.parallel import gather_rows
from dolfinx_llm.forms.step import DRIFT, SIGN, InterfaceSystem, force_level, wrong_signs
from dolfinx_llm.laws.complementarity import complementarity
from dolfinx_llm.operators.petsc import times
from dolfinx_llm.operators.support import floating_modes, pins


class WholeSteps:
    """What steps on the whole system share.

    Args:
        K, B, bodies, fixed, scale, prefix, options: as of ``Flexibility``.
        rows: the multipliers' ``Numbering``.
        frames: ``Numbering`` of frame and slip unknowns.
    """

    accuracy = 1e-13  # of balance and law, relative
    proximal = 1e-10  # what holds frame nodes that nothing touches, of the surfaces' stiffness
    most = 200  # pairs that are asked for; where more have a wrong sign, all of these change
    eager = True  # asks whenever it may, not only where change has brought nothing

    def __init__(self, K, B, rows, frames, bodies, fixed, scale, prefix, options=None):
        self.K, self.B, self.rows, self.frames, self.scale = K, B, rows, frames, scale
        self.comm, self.fixed, self._prefix, self._options = bodies.comm, fixed, prefix, options
        modes = floating_modes(bodies, K, fixed)
        self._pins, self.floating = pins(self.comm, modes), modes.shape[1]
        self._u = np.zeros(0)  # of the last step
        self._wrong = np.inf  # signs that were wrong there

    def load(self, f: np.ndarray) -> None:
        """Take this rank's load."""
        self.f, self._wrong = f, np.inf

    def correct(self, multiplier: np.ndarray, alpha: np.ndarray) -> None:
        """Nothing to correct: every step solves the whole system."""

    def solve(self, step: InterfaceSystem, spring: float, centre: np.ndarray, may_open: np.ndarray):
        """One linear step; see ``Flexibility.solve``. α: motion of the dofs that springs hold."""
        f = self.f.copy()
        first = sum(self.comm.allgather(len(self._pins))[: self.comm.rank])
        f[self._pins] += spring * centre[first : first + len(self._pins)]
        ask, done = self._set_up(step, spring)
        try:
            multiplier, y, w = self._answer(ask, f, step.g, step.rhs)
            active = step.active
            wrong = wrong_signs(step, may_open, multiplier, y, w, self.scale)
            before, self._wrong = self._wrong, wrong.sum()
            if 0 < self._wrong <= self.most and (self.eager or self._wrong >= before):
                pairs, forces = self._choose(ask, step, may_open, wrong, multiplier, y, w)
                if len(pairs):
                    active = active.copy()
                    active[pairs] ^= True
                    df, dg, drhs = self._loads(step, pairs, forces)
                    multiplier, y, w = self._answer(ask, f + df, step.g + dg, step.rhs + drhs)
                    multiplier[pairs] = np.where(active[pairs], forces, 0.0)
                    chosen = replace(step, active=active)
                    wrong = wrong_signs(chosen, may_open, multiplier, y, w, self.scale)
        finally:
            done()
        return multiplier, y, w, gather_rows(self.comm, self._u[self._pins]), active, wrong

    def _set_up(self, step: InterfaceSystem, spring: float):
        """Two functions: of this rank's f, (n,) g and (m,) rhs that gives u of this rank, λ (n,)
        and w (m,) on every rank, and one that ends its use. K has springs at the pins."""
        raise NotImplementedError

    def _answer(self, ask, f, g, rhs):
        """λ (n,), y (n,) and w (m,); keeps u."""
        self._u, multiplier, w = ask(f, g, rhs)
        return multiplier, self._gather(self.rows, times(self.B, self._u, transposed=True)), w

    def _loads(self, step: InterfaceSystem, pairs, forces):
        """What is added to f, g and rhs for pairs that are to change: those out of contact get
        forces, the others gaps of forces / c."""
        closing = np.zeros(len(step.active))
        closing[pairs] = np.where(step.active[pairs], 0.0, forces)
        opening = np.zeros(len(step.active))
        opening[pairs] = np.where(step.active[pairs], forces / self.scale, 0.0)
        return -times(self.B, closing[self.rows.mine]), opening, -(step.E @ closing)

    def _choose(self, ask, step, may_open, wrong, multiplier, y, w):
        """Pairs that have to change so that all signs are right, and their forces (gaps times c,
        where they open): linear complementarity among those whose sign is or becomes wrong."""
        rows = np.flatnonzero(may_open)
        place = np.cumsum(may_open) - 1
        on = step.active[rows]
        band = SIGN * force_level(multiplier, y + step.g, self.scale)

        def signs(multiplier, y, w, g):
            """What must not be negative: forces in contact, gaps times c elsewhere."""
            gap = step.L[rows] @ w - y[rows] - g[rows]
            return np.where(on, multiplier[rows], self.scale * gap)

        now = signs(multiplier, y, w, step.g)
        pairs, new, answers = np.empty(0, dtype=np.int64), np.flatnonzero(wrong), []
        change, forces = np.zeros(0, dtype=bool), np.zeros(0)
        while len(new) and len(pairs) + len(new) <= 2 * self.most:
            for p in new:
                load = self._loads(step, np.array([p]), np.ones(1))
                force, position, motion = self._answer(ask, *load)
                answers.append(signs(force, position, motion, load[1]))
            pairs = np.concatenate([pairs, new])
            at, columns = place[pairs], np.column_stack(answers)
            M, q = columns[at], now[at]
            change = complementarity(M, q, q < 0.0)
            forces = np.zeros(len(pairs))
            forces[change] = np.linalg.solve(M[np.ix_(change, change)], -q[change])
            after = now + columns @ forces
            after[at] = 0.0
            new = rows[after < -band]
        return pairs[change], forces[change]

    def _K_times(self, u: np.ndarray) -> np.ndarray:
        """This rank's part of K u, without springs."""
        return times(self.K, u)

    def displacement(self, multiplier: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        """This rank's u of the last step; sets ``residual``, of K u + B λ = f."""
        load = self.f - times(self.B, multiplier[self.rows.mine])
        miss = np.abs(self._K_times(self._u) - load).max(initial=0.0)
        sizes = [np.abs(self.f), np.abs(load), DRIFT * self.scale * np.abs(self._u)]
        found = self.comm.allgather((miss, max(a.max(initial=0.0) for a in sizes)))
        miss, size = np.max(found, axis=0)
        self.residual = miss / max(size, 1e-300)
        return self._u

    def _gather(self, numbering, local: np.ndarray) -> np.ndarray:
        return gather_rows(self.comm, local)[numbering.number]

    def destroy(self) -> None:
        """Nothing outlives a step."""
