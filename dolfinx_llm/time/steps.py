"""What a stepper does beside its steps: their start, their division where bodies meet or part in
them, and files of where it stands.

Over a step energy changes by the mean force of a pair times the change of its gap. Where it closes
that takes λ₁ gap₀ / 2; where it parts it has been held for a moment, and what it pulled with at the
end of one step, -λ₀, takes -λ₀ gap₁ / 2 in the next one. Both fall with the square of the step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.log import log
from dolfinx_llm.base.parallel import collective, told
from dolfinx_llm.operators.petsc import diagonal_of, times
from dolfinx_llm.problem.bulk import fill
from dolfinx_llm.problem.form_arguments import listed
from dolfinx_llm.problem.saving import Saving
from dolfinx_llm.problem.state_file import Arrays
from dolfinx_llm.time.unmoved import unmoved

NO_PULL = 1e-9  # of the force that stops a node in a step: pulls by less are rounding
LATEST_PART = 0.95  # of a step: what comes after it is not worth a step of its own
INERT = 1e7, 1e5  # inertia over stiffness and that of a step, by which bodies stay where they are
# at first: linear ones, and others, whose forces are known to rounding of theirs


@dataclass(frozen=True, eq=False)
class Touch:
    """What bodies meet with at the end of a step; n nodes of all surfaces that may part."""

    gap: Array  # (n,) to the frame, 0 where a node meets none [length]
    force: Array  # (n,) normal, positive in compression [force]
    pressing: Array  # (n,) the same of control values, which alone are not to pull [force]
    kinetic: float  # largest kinetic energy so far [force length]
    largest: float  # largest of the forces so far [force]

    @classmethod
    def of(cls, results: Sequence[Any], kinetic: float, before: Touch) -> Touch:
        """At the end of a step.

        Args:
            results: of the interfaces that may part.
            kinetic: energy now [force length].
            before: at its start.
        """
        sides = [side for result in results for side in result.sides]
        gap = np.concatenate([np.zeros(0), *(getattr(s, "frame_gap", s.gap) for s in sides)])
        force = np.concatenate([np.zeros(0), *(s.normal_force for s in sides)])
        pressing = np.concatenate([np.zeros(0), *(s.pressing for s in sides)])
        largest = max(before.largest, float(force.max(initial=0.0)))
        gap = np.where(np.isfinite(gap), gap, 0.0)
        return cls(gap, force, pressing, max(before.kinetic, kinetic), largest)

    def divides(self, before: Touch, part: float, least: float) -> float:
        """Where a step from ``before`` to here is to be divided, as a part of it; 0: nowhere.

        Args:
            before: at its start.
            part: of the kinetic energy, that closing may take; its root, of the largest force,
                pairs may pull with.
            least: force up to which pulls are rounding [force].
        """
        if len(self.gap) != len(before.gap):  # nothing is known
            return 0.0
        taken = 0.5 * float(self.force @ np.maximum(before.gap, 0.0))
        if taken > part * self.kinetic:
            return 0.5
        pulls = (self.pressing < 0.0) & (before.pressing > 0.0)
        pressed, now = float(before.pressing[pulls].sum()), float(self.pressing[pulls].sum())
        allowed = max(np.sqrt(part) * self.largest, least)
        if -now <= allowed:
            return 0.0
        at = (pressed + 0.5 * allowed) / (pressed - now)  # there they hardly pull
        return at if at < LATEST_PART else 0.0


class Steps(Saving):
    """The start, the division and the saving of the steps of ``TimeStepper``."""

    problem: Any
    t: float
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
    _touch: Touch
    _adaptive: float | None
    _accepted: Callable[[Any], None] | None

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
        bulk, pushed = self.problem.bulk, self.problem.pushed
        left = bulk.residual(u) - pushed if self._mean else bulk.unbalanced(u, pushed)
        left -= c * times(self._M, u)
        self._left = np.where(self._bare | fixed, 0.0, left)
        fill(self._u, u, counts)
        self._touch, _ = self._met()
        self._started = True

    def _slides(self) -> bool:
        """Whether bodies move, and slip on what they touch."""
        moves = self.comm.allreduce(bool(self._values(self._v).any()))
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

    def _hold(self, c: float, u: Array) -> None:
        """Find contact of bodies that inertia of a rate c holds at u (n_local,), and what leads
        them: it may have moved on already, and ties would pull at what does not follow."""
        self._push(c * times(self._M, u))
        bulk, led = self.problem.bulk, [i for i in self.problem.interfaces if not i.law.opens]
        at_rest = not self.comm.allreduce(bool(u.any()))
        bulk.held = u
        try:
            with unmoved([i.obstacle for i in led if i.obstacle is not None and at_rest]):
                self.problem.solve()
        finally:
            bulk.held = None

    def _push(self, force: Array) -> None:
        """Take this rank's nodal forces (n_local,) of inertia, beside the nodal loads of now."""
        self._loads[:] = [*self._nodal, *self._pushes]
        fill(self._pushes, force, self.problem.bulk.dofs.counts)

    def _once(self, dt: float) -> None:
        """One step of dt."""
        raise NotImplementedError

    def _advance(self, dt: float, divisions: int) -> None:
        """Go on by dt, in parts where that fails, or where bodies meet or part in it."""
        kept = self.state_arrays() if self._adaptive and divisions else None
        try:
            self._once(dt)
        except ContactInputError:
            raise
        except ContactError as failed:
            if not divisions:
                raise
            log.info("a step of %.3g fails: %s; halved", dt, failed)
            at = 0.5
        else:
            touch, at = self._met()
            if kept is None or not at:
                self._touch = touch
                self.t += dt
                if self._accepted is not None:
                    with collective(self.comm):
                        self._accepted(self)
                return
            self.take_back(*kept)
            log.info("a step of %.3g in which bodies meet or part is divided", dt)
        self._advance(at * dt, divisions - 1)
        self._advance((1.0 - at) * dt, divisions - 1)

    def _met(self) -> tuple[Touch, float]:
        """What bodies meet with now, and where the step is to be divided; 0: nowhere."""
        if self._adaptive is None:
            return self._touch, 0.0
        v = self._values(self._v)
        momentum = times(self._M, v)
        found = self.comm.allgather((float(v @ momentum), float(np.abs(momentum).max(initial=0.0))))
        kinetic, fastest = 0.5 * sum(e for e, _ in found), max(p for _, p in found)
        of = zip(self.problem.interfaces, self.problem.results, strict=True)
        results = [result for i, result in of if i.law.opens and not i.law.gives]
        touch = Touch.of(results, kinetic, self._touch)
        at = touch.divides(self._touch, self._adaptive, NO_PULL * fastest / self.dt)
        return touch, told(self.comm, at)

    @property
    def interfaces(self) -> Any:
        """Of the problem."""
        return self.problem.interfaces

    def saved_spaces(self) -> Sequence[Any]:
        """Spaces of the bodies' dofs."""
        return self.problem.saved_spaces()

    def places(self) -> Array:
        """Places of the interfaces, which tell this scene from others."""
        return self.problem.places()

    def state_arrays(self) -> tuple[Arrays, Arrays]:
        """What is the same on every rank, and this rank's values at the bodies' dofs."""
        common, local = self.problem.state_arrays()
        touch = self._touch
        common |= {"time": np.array([self.t, self.dt, touch.kinetic, touch.largest])}
        common |= {"touch": np.array([touch.gap, touch.force, touch.pressing])}
        own = {"displacement": self._values(self._u), "velocity": self._values(self._v)}
        return common, local | own | {"inertia": self._left}

    def take_arrays(self, common: Arrays, local: Arrays) -> None:
        """Go on from what ``state_arrays`` returned; collective.

        Args:
            common, local: as it returned them.
        """
        self.dt = float(common["time"][1])
        self._use(self._rate(self.dt))
        self.take_back(common, local)

    def take_back(self, common: Arrays, local: Arrays) -> None:
        """The same with dt as it is now; collective.

        Args:
            common, local: as ``state_arrays`` returned them.
        """
        self.t = float(common["time"][0])
        self._touch = Touch(*common["touch"], *map(float, common["time"][2:]))
        self.problem.take_arrays(common, local)
        counts = self.problem.bulk.dofs.counts
        fill(self._u, local["displacement"], counts)
        fill(self._v, local["velocity"], counts)
        self._left, self._started = local["inertia"], True

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
