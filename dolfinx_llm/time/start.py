"""Forces at the start of steps in time."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx_llm.operators.petsc import diagonal_of, times
from dolfinx_llm.problem.bulk import fill
from dolfinx_llm.problem.form_arguments import listed
from dolfinx_llm.time.divided import DividedSteps

INERT = 1e7, 1e5  # inertia over stiffness and that of a step, by which bodies stay where they are
# at first: linear ones, and others, whose forces are known to rounding of theirs


class StartedSteps(DividedSteps):
    """The start of ``TimeStepper``."""

    _mean: Any
    _bare: np.ndarray
    _pushes: list[Any]

    def start(self) -> None:
        """Find the forces at the start, from u, v and the loads as they are; the first ``step``
        does so unless you have done it before. Surfaces without mass come to rest with what lies
        behind them; ties have the forces that hold them as bodies accelerate. Where bodies slide
        with v on others, or on obstacles at rest, friction acts already. Collective.

        Raises:
            ContactError: contact does not balance what presses it.
        """
        u, c = self._values(self._u), self._rate(self.dt)
        fixed, counts = self.problem.bulk.dofs.fixed, self.problem.bulk.dofs.counts
        came = u - self.dt * self._values(self._v) if self._slides() else u
        self._use(c)
        if self._mean:
            self._mean.begin(u, counts, 0.0)
        held = INERT[bool(self._mean)] * self._stiffness(u)
        self._use(held, starts=True)
        try:
            if self._mean:
                self.problem.bulk.put(came)
                self.problem.reset(moved=True)
            elif came is not u:
                self._hold(held, came)
            self._hold(held, u)
            rests = self._values(listed(self.problem.u))
        finally:
            fill(self._u, u, counts)
        u = np.where(self._bare & ~fixed, rests, u)
        self._use(c)
        self._push(np.zeros(len(u)))
        left = self.problem.bulk.residual(u) if self._mean else -self.problem.bulk.force(u)
        left -= self.problem.pushed + c * times(self._M, u)
        self._left = np.where(self._bare | fixed, 0.0, left)
        fill(self._u, u, counts)
        self._touch, _ = self._met()

    def _slides(self) -> bool:
        """Whether bodies move, and slip on what they touch."""
        moves = self.comm.allreduce(bool(self._values(self._v).any()))
        return bool(moves) and any(i.law.slips for i in self.problem.interfaces)

    def _stiffness(self, u: np.ndarray) -> float:
        """Of the bodies at u (n_local,) with the inertia of a step, over their mass [1 / time²]."""
        if not self._mean:
            self.problem.update()
        K = self.problem.bulk.tangent(u) if self._mean else self.problem.K
        sums = np.array([np.abs(diagonal_of(A)).sum() for A in (K, self._M)])
        if self._mean:
            K.destroy()
        stiffness, mass = self.comm.allreduce(sums)
        return float(stiffness / mass)

    def _hold(self, c: float, u: np.ndarray) -> None:
        """Find contact of bodies that inertia of a rate c holds at u (n_local,)."""
        self._push(c * times(self._M, u))
        self.problem.solve()

    def _push(self, force: np.ndarray) -> None:
        """Take this rank's nodal forces (n_local,) of inertia."""
        fill(self._pushes, force, self.problem.bulk.dofs.counts)
