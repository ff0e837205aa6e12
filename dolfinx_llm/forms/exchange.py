"""Steps of contact laws on the whole system, set up anew in each: for large interfaces.

The same as ``flexibility``, where the surfaces have so many nodes that asking the bodies for their
answer to every multiplier costs more than a few factorisations. They are asked for the few whose
sign is wrong, and for those that get it wrong in turn.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from dolfinx_llm.base.parallel import gather_rows
from dolfinx_llm.forms.floating import Floating
from dolfinx_llm.forms.step import (
    SIGN,
    Displacement,
    LinearStep,
    StepResult,
    force_level,
    wrong_signs,
)
from dolfinx_llm.forms.verdict import EPS, SEVERAL
from dolfinx_llm.laws.complementarity import complementarity
from dolfinx_llm.operators.numbering import Numbering
from dolfinx_llm.operators.petsc import diagonal_of, times


class WholeSteps:
    """What steps on the whole system share.

    Args:
        K, B, bodies, fixed, scale, prefix, options: as of ``Flexibility``.
        rows: the multipliers' ``Numbering``.
        frames: ``Numbering`` of frame and slip unknowns.
    """

    name = "the whole system"
    accuracy = 1e-13  # of balance and law, relative
    proximal = 1e-10  # as small as factorisation and preconditioner bear
    noise = 0.0  # of forces, by rounding [force]
    most = 200  # pairs that are asked for; where more have a wrong sign, all of these change
    eager = True  # asks whenever it may, not only where change has brought nothing

    def __init__(
        self,
        K: Any,
        B: Any,
        rows: Any,
        frames: Any,
        bodies: Any,
        fixed: np.ndarray,
        scale: float,
        prefix: str,
        options: dict | None = None,
    ) -> None:
        self.K, self.B, self.rows, self.frames, self.scale = K, B, rows, frames, scale
        self.comm, self.fixed, self._prefix, self._options = bodies.comm, fixed, prefix, options
        self.floating = Floating(K, B, rows, bodies, fixed)
        self._pins = self.floating.pins
        self._diagonal = diagonal_of(K)
        self.f: Any = None  # this rank's load of the last step
        self._u = np.zeros(0)  # of the last step
        self._wrong = np.inf  # signs that were wrong there

    def correct(self, found: StepResult) -> None:
        """Nothing to correct: every step solves the whole system."""

    def solve(self, f: np.ndarray, step: LinearStep) -> StepResult:
        """See ``StepForm``."""
        if f is not self.f:
            self.f, self._wrong = f, np.inf
        f = f.copy()
        f[self._pins] += step.spring * self.floating.at_pins(step.anchor)
        ask, done = self._set_up(step)
        try:
            multiplier, y, w = self._answer(ask, f, step.g, step.rhs)
            active = step.active
            wrong = wrong_signs(step, multiplier, y, w, self.scale)
            before, self._wrong = self._wrong, wrong.sum()
            if 0 < self._wrong <= self.most and (self.eager or self._wrong >= before):
                pairs, forces = self._choose(ask, step, wrong, multiplier, y, w)
                if len(pairs):
                    active = active.copy()
                    active[pairs] ^= True
                    df, dg, drhs = self._loads(step, pairs, forces)
                    multiplier, y, w = self._answer(ask, f + df, step.g + dg, step.rhs + drhs)
                    multiplier[pairs] = np.where(active[pairs], forces, 0.0)
                    chosen = replace(step, active=active)
                    wrong = wrong_signs(chosen, multiplier, y, w, self.scale)
        finally:
            done()
        terms = np.abs(~self.fixed * self._diagonal * self._u).max(initial=0.0)
        self.noise = SEVERAL * EPS * max(self.comm.allgather(terms))
        return StepResult(multiplier, y, w, self.floating.amounts(self._u), active, wrong)

    def _set_up(self, step: LinearStep) -> Any:
        """Two functions: of this rank's f, (n,) g and (m,) rhs that gives u of this rank, λ (n,)
        and w (m,) on every rank, and one that ends its use. K has springs at the pins."""
        raise NotImplementedError

    def _answer(self, ask: Any, f: np.ndarray, g: np.ndarray, rhs: np.ndarray) -> Any:
        """λ (n,), y (n,) and w (m,); keeps u."""
        self._u, multiplier, w = ask(f, g, rhs)
        return multiplier, self._gather(self.rows, times(self.B, self._u, transposed=True)), w

    def _loads(self, step: LinearStep, pairs: np.ndarray, forces: np.ndarray) -> Any:
        """What is added to f, g and rhs for pairs that are to change: those out of contact get
        forces, the others gaps of forces / c."""
        closing = np.zeros(len(step.active))
        closing[pairs] = np.where(step.active[pairs], 0.0, forces)
        opening = np.zeros(len(step.active))
        opening[pairs] = np.where(step.active[pairs], forces / self.scale, 0.0)
        return -times(self.B, closing[self.rows.mine]), opening, -(step.E @ closing)

    def _choose(
        self,
        ask: Any,
        step: LinearStep,
        wrong: np.ndarray,
        multiplier: np.ndarray,
        y: np.ndarray,
        w: np.ndarray,
    ) -> Any:
        """Pairs that have to change so that all signs are right, and their forces (gaps times c,
        where they open): linear complementarity among those whose sign is or becomes wrong."""
        rows = np.flatnonzero(step.may_open)
        place = np.cumsum(step.may_open) - 1
        on = step.active[rows]
        band = SIGN * force_level(multiplier, y + step.g, self.scale)

        def signs(multiplier: np.ndarray, y: np.ndarray, w: np.ndarray, g: np.ndarray) -> Any:
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
                column = signs(force, position, motion, load[1])
                column[place[p]] += 0.0 if on[place[p]] else self.scale * step.compliance[p]
                answers.append(column)
            pairs = np.concatenate([pairs, new])
            at, columns = place[pairs], np.column_stack(answers)
            M, q, forces = columns[at], now[at], np.zeros(len(pairs))
            try:
                change = complementarity(M, q, q < 0.0)
                forces[change] = np.linalg.solve(M[np.ix_(change, change)], -q[change])
            except np.linalg.LinAlgError:  # forces that nothing determines: all wrong ones change
                return pairs[:0], forces[:0]
            after = now + columns @ forces
            after[at] = 0.0
            new = rows[after < -band]
        return pairs[change], forces[change]

    def _K_times(self, u: np.ndarray) -> np.ndarray:
        """This rank's part of K u, without springs."""
        return times(self.K, u)

    def displacement(self, found: StepResult) -> Displacement:
        """See ``StepForm``."""
        load = self.f - times(self.B, found.multiplier[self.rows.mine])
        free, u = ~self.fixed, self._u
        left = free * (self._K_times(u) - load)
        return Displacement(u, left, free * self._diagonal * u, free * self.f)

    def _gather(self, numbering: Numbering, local: np.ndarray) -> np.ndarray:
        return gather_rows(self.comm, local)[numbering.number]

    def destroy(self) -> None:
        """Nothing outlives a step."""
