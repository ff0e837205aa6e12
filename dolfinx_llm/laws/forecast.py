"""Which pairs will press, from forces and motions of a guess; NumPy and SciPy only.

Where all wrong signs change at once, frame nodes at the rim of contact, which few pairs hold, go
far, and whole rims open and close by turns. Here each pair answers with a stiffness of its own, as
if its node alone moved, and the frame goes to where it balances under forces that press:

    λ' = max(0, λ + k (y + g - L w')),  Lᵀ λ' = Lᵀ λ,

but for what holds the frame about the guess. That is the least of a convex function of w'. The λ of
a solution come back, whatever k > 0 is; near it the set λ' > 0 is better than the signs, as the
frame has followed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags, identity
from scipy.sparse.linalg import splu

from dolfinx_llm.base.arrays import Array

HOLDS = 10.0 ** -np.arange(2.0, 13.0, 2.0)  # of k: what holds the frame, less and less
NEWTON_STEPS = 60  # of Newton's method, for each of these
BALANCED = 10.0  # times what holds the frame, over k: part of the largest force that nodes may miss
UNBALANCED_LEAST = 1e-13  # the least of that


@dataclass(frozen=True, eq=False)
class Forecast:
    """The function of w whose least value tells what presses."""

    L: csr_matrix  # (n, m) motion of the frame as the rows see it
    k: Array  # (n,) stiffness of rows; 0: their forces stay as they are [force / length]
    press: Array  # (n,) rows whose force must not be negative
    hold: Array  # (m,) what holds the frame about the guess [force / length]
    w: Array  # (m,) the guess [length]

    def normal(self) -> tuple[Forecast, Array]:
        """The same of normal forces alone, and of the motions that mainly these see, with the
        places of these among all: with friction, whose forces are told otherwise, for the time
        being those of the guess."""
        squares = self.L.power(2)
        of_press = np.asarray(squares[self.press].sum(axis=0)).ravel()
        seen = of_press > 0.5 * np.asarray(squares.sum(axis=0)).ravel()
        at = np.flatnonzero(seen)
        L = self.L[:, at]
        own = np.asarray(L.power(2).sum(axis=1) - 0.5 * squares.sum(axis=1)).ravel() > 0.0
        return Forecast(L, np.where(own, self.k, 0.0), self.press, self.hold[at], self.w[at]), at

    def borne(self, force: Array) -> Array:
        """(m,) Lᵀ λ of the rows that may change [force].

        Args:
            force: (n,) λ [force].
        """
        return np.asarray(self.L.T @ np.where(self.k > 0.0, force, 0.0))

    def pressing(self, force: Array, position: Array, loads: Array | None = None) -> Array:
        """(n,) rows of ``press`` with λ' > 0.

        Args:
            force: (n,) λ of a guess [force].
            position: (n,) y + g there [length].
            loads: what Lᵀ λ' is for the last columns of L, where the guess does not tell [force].
        """
        target = self.borne(force)
        if loads is not None and len(loads):
            target[-len(loads) :] = loads
        return self.settled(force, position, target)[0]

    def settled(self, force: Array, position: Array, target: Array) -> tuple[Array, Array]:
        """(n,) rows of ``press`` with λ' > 0, and w' (m,) [length].

        Args:
            force, position: as of ``pressing``.
            target: (m,) Lᵀ λ' but for what holds the frame [force].
        """
        told = self.k > 0.0
        force, untold = np.where(told, force, 0.0), np.where(told, 0.0, force)
        pull = force + self.k * position
        used = self.L.multiply(self.k[:, None]).tocsc()
        fit = used.T @ self.L + HOLDS[-1] * self.k.mean() * identity(used.shape[1])
        w = splu(csc_matrix(fit)).solve(used.T @ position) if used.shape[1] else np.zeros(0)
        if len(w):
            holds, own = HOLDS * self.k.mean(), self.hold.max()
            share = max(BALANCED * own / self.k.mean(), UNBALANCED_LEAST)
            enough = share * np.abs(force).max(initial=0.0)
            for hold in holds[holds > own]:
                w = self._least(pull, target, w, w, np.full(len(w), hold), enough)
            if own > holds[-1]:
                about = np.where(self.hold > 0.0, self.w, w)
                hold = np.maximum(self.hold, holds[-1])
                w = self._least(pull, target, w, about, hold, enough)
        return (self._answer(pull, w) + untold > 0.0) & self.press, w

    def _answer(self, pull: Array, w: Array) -> Array:
        """λ'."""
        z = pull - self.k * (self.L @ w)
        return np.where(self.press, np.maximum(z, 0.0), z)

    def _least(
        self, pull: Array, target: Array, w: Array, about: Array, hold: Array, enough: float
    ) -> Array:
        """Newton's method from w, with the best length of each step; springs of stiffness ``hold``
        hold the frame about some place."""
        for _ in range(NEWTON_STEPS):
            z = pull - self.k * (self.L @ w)
            on = np.where(self.press, z > 0.0, True)
            missed = self.L.T @ np.where(on, z, 0.0) - target - hold * (w - about)
            if np.abs(missed).max() <= enough:
                break
            H = self.L.T @ diags(self.k * on) @ self.L + diags(hold)
            step = splu(csc_matrix(H)).solve(missed)
            w = w + self._length(z, step, target, w - about, hold) * step
        return w

    def _length(self, z: Array, step: Array, target: Array, moved: Array, hold: Array) -> float:
        """Up to 1: where the slope along a step vanishes; it is linear between the places where
        rows begin or cease to press."""
        seen = self.L @ step
        falls = self.k * seen

        def slope(t: float) -> float:
            force = z - t * falls
            force = np.where(self.press, np.maximum(force, 0.0), force)
            return float(step @ target - seen @ force + (hold * step) @ (moved + t * step))

        if slope(1.0) <= 0.0:
            return 1.0
        moving = self.press & (falls != 0.0)
        kinks = z[moving] / falls[moving]
        kinks = np.unique(np.concatenate([[0.0, 1.0], kinks[(kinks > 0.0) & (kinks < 1.0)]]))
        low, high = 0, len(kinks) - 1
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if slope(kinks[middle]) > 0.0 else (middle, high)
        a, b = slope(kinks[low]), slope(kinks[high])
        share = -a / (b - a) if b > a else 1.0
        return float(kinks[low] + share * (kinks[high] - kinks[low]))
