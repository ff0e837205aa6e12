"""The start of steps in time, also where other dofs are prescribed: forces without inertia."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.operators.petsc import diagonal_of, times
from dolfinx_llm.problem.bulk import fill
from dolfinx_llm.problem.form_arguments import listed
from dolfinx_llm.problem.saving import Saving
from dolfinx_llm.time.for_a_while import numbers, on_the_way, slippery, unmoved

INERT = 1e7, 1e5  # inertia over stiffness and that of a step, by which bodies stay where they are
# at first: linear ones, and others, whose forces are known to rounding of theirs


class Starting(Saving):
    """What steps of ``TimeStepper`` start from."""

    problem: Any
    dt: float
    _u: list[fem.Function]
    _v: list[fem.Function]
    _M: Any
    _mean: Any
    _bare: Array
    _pushes: list[Any]
    _nodal: list[Any]  # the user's own
    _loads: list[Any]  # both, the problem's
    _left: Array
    _started: bool  # whether it is known
    _fixed: Array  # which dofs were prescribed when it was found
    _at: Array  # u (n_local,) where the last step has ended [length]
    _led: Array  # what obstacles, ties and pressures were given where contact was last found
    _touch: Any  # what bodies meet with now

    def start(self) -> None:
        """Find the forces at the start, from u, v and the loads as they are; the first ``step``
        does so unless you have done it before. Surfaces without mass come to rest with what lies
        behind them; ties have the forces that hold them as bodies accelerate. Where bodies slide
        with v on others, or on obstacles at rest, friction acts already. Prescribed dofs are where
        u has them, as are rigid ends where u is 0; where it is not call this yourself before they
        move on, or they pull at what inertia holds. Collective.

        Raises:
            ContactError: contact does not balance what presses it.
        """
        self._begin(anew=True)

    def _begin(self, anew: bool) -> None:
        """Find the forces at the start of a step; ``anew``: nothing is known of contact."""
        u, c, counts = self._values(self._u), self._rate(self.dt), self.problem.bulk.dofs.counts
        came = u - self.dt * self._values(self._v) if anew and self._slides() else u
        self._use(c)
        if self._mean:
            self._mean.begin(u, counts, 0.0)
        held = INERT[bool(self._mean)] * self._stiffness(u)
        self._use(held, starts=True)
        try:
            if self._mean and anew:
                self.problem.bulk.put(came)
                self.problem.reset(moved=True)
            elif came is not u:
                with slippery([i.law for i in self.problem.interfaces]):
                    self._hold(held, came)
                    left = self.problem.bulk.unbalanced(came, self.problem.pushed)
                    self._hold(held, came, force=np.where(self._bare, left, 0.0))
            rests = self._hold(held, u)
            if self._mean:  # and by how much inertia has given way
                rests = self._hold(held, u, u - rests)
            if not self._mean:  # inertia held the bodies: no step is judged by its forces
                self.problem.method.iteration.ended = 0.0
        finally:
            fill(self._u, u, counts)
        fixed = self.problem.bulk.dofs.fixed
        u = np.where(self._bare & ~fixed, rests, u)
        self._use(c)
        self._left = np.where(self._bare | fixed, 0.0, self._unmoving(u, c))
        fill(self._u, u, counts)
        self._touch, _ = self._met()
        self._started, self._fixed, self._at = True, fixed, u

    def _unmoving(self, u: Array, c: float) -> Array:
        """(n_local,) forces of the bodies less loads and contact, as these were last found at u
        (n_local,), without inertia of the rate c; collective."""
        self._push(np.zeros(len(u)))
        bulk, pushed = self.problem.bulk, self.problem.pushed
        left = bulk.residual(u) - pushed if self._mean else bulk.unbalanced(u, pushed)
        return np.asarray(left - c * times(self._M, u))

    def _follow(self) -> None:
        """Where supports have come or gone since the last step, forces at the start of this one are
        others than at the end of that; where contact has been forgotten, as of an obstacle that was
        drawn anew, or u was set by hand, nothing is known of them. Collective."""
        self.problem.update()
        held = bool((self.problem.bulk.dofs.fixed != self._fixed).any())
        moved = bool((self._values(self._u) != self._at).any())
        held, moved = self.comm.allreduce(np.array([held, moved])) > 0
        anew = bool(moved) or not self.problem.results
        if held or anew:
            self._begin(anew)

    def _slides(self) -> bool:
        """Whether bodies move, or have moved, and slip on what they touch."""
        moves = self.comm.allreduce(any(self._values(w).any() for w in (self._u, self._v)))
        return bool(moves) and any(i.law.slips for i in self.problem.interfaces)

    def _stiffness(self, u: Array) -> float:
        """Of the bodies at u (n_local,) with the inertia of a step, over their mass [1 / time²]."""
        if not self._mean:
            self.problem.update()
        K = self.problem.bulk.tangent(u) if self._mean else self.problem.K
        free = ~self.problem.bulk.dofs.fixed  # K has ones elsewhere
        sums = np.array([np.abs(diagonal_of(A)[free]).sum() for A in (K, self._M)])
        if self._mean:
            K.destroy()
        stiffness, mass = self.comm.allreduce(sums)
        return float(stiffness / mass) if mass > 0.0 else 1.0

    def _hold(
        self, c: float, u: Array, beyond: Array | float = 0.0, force: Array | float = 0.0
    ) -> Array:
        """Find contact of bodies that inertia of a rate c holds at u (n_local,), and what leads
        them: it may have moved on already, and ties would pull at what does not follow.

        Args:
            c, u: rate and place.
            beyond: (n_local,) by which inertia pulls farther, against what moves the bodies.
            force: (n_local,) that holds what has no mass [force].

        Returns:
            (n_local,) where they are.
        """
        self._push(c * times(self._M, u + beyond) + force)
        bulk, led = self.problem.bulk, [i for i in self.problem.interfaces if not i.law.opens]
        at_rest = not self.comm.allreduce(bool(u.any()))
        bulk.held = u
        try:
            with unmoved([i.obstacle for i in led if i.obstacle is not None and at_rest]):
                self.problem.solve()
                self._led = numbers(self.problem)
        finally:
            bulk.held = None
        return self._values(listed(self.problem.u))

    def _solve(self, part: float) -> None:
        """Find contact at the end of a step, all of it or nothing, where supports and all else that
        leads bodies have gone this part, in (0, 1], of their way since it was found last;
        collective."""
        bulk = self.problem.bulk
        way: AbstractContextManager[None] = nullcontext()
        if part < 1.0:
            with collective(self.comm):
                way = on_the_way(self.problem, self._led, part)
            u = self._values(self._u)
            bulk.held = u + part * (bulk.values() - u)
        try:
            with way:
                self.problem.solve(state=self._u)
                self._led = numbers(self.problem)
        finally:
            bulk.held = None

    def _push(self, force: Array) -> None:
        """Take this rank's nodal forces (n_local,) of inertia, beside the nodal loads of now."""
        self._loads[:] = [*self._nodal, *self._pushes]
        fill(self._pushes, force, self.problem.bulk.dofs.counts)

    def _met(self) -> tuple[Any, float]:
        """See ``Steps``."""
        raise NotImplementedError

    def _values(self, functions: Sequence[fem.Function]) -> Array:
        """(n_local,) of this rank."""
        counts = self.problem.bulk.dofs.counts
        return np.concatenate([w.x.array[:n] for w, n in zip(functions, counts, strict=True)])

    def _rate(self, dt: float) -> float:
        """Of inertia in steps of dt [1 / time²]."""
        raise NotImplementedError

    def _use(self, c: float, starts: bool = False) -> None:
        """Take another rate of inertia [1 / time²]; ``starts``: for the forces at the start."""
        raise NotImplementedError
