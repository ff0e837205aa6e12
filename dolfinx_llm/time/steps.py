"""What a stepper does beside its steps: their division where bodies meet or part in them, and files
of where it stands.

Over a step energy changes by the mean force of a pair times the change of its gap. Where it closes
that takes λ₁ gap₀ / 2; where it parts it has been held for a moment, and what it pulled with at the
end of one step, -λ₀, takes -λ₀ gap₁ / 2 in the next one. Both fall with the square of the step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.log import log, warn
from dolfinx_llm.base.parallel import collective, told
from dolfinx_llm.operators.petsc import times
from dolfinx_llm.problem.bulk import fill
from dolfinx_llm.problem.state_file import Arrays
from dolfinx_llm.time.given import KnownMass
from dolfinx_llm.time.pulls import Pulls
from dolfinx_llm.time.starting import Starting

NO_PULL = 1e-9  # of the force that stops a node in a step: pulls by less are rounding
GAP_ROUNDED = 1e-9  # of what bodies have moved by: gaps below are rounding
LATEST_PART = 0.95  # of a step: what comes after it is not worth a step of its own


@dataclass(frozen=True, eq=False)
class Touch:
    """What bodies meet with at the end of a step; n nodes of all surfaces that may part."""

    gap: Array  # (n,) to the frame, 0 where a node meets none [length]
    force: Array  # (n,) normal, positive in compression [force]
    pressing: Array  # (n,) the same of control values, which alone are not to pull [force]
    kinetic: float  # largest kinetic energy so far [force length]
    largest: float  # largest of the forces so far [force]

    @classmethod
    def of(cls, results: Sequence[Any], kinetic: float, moved: float, before: Touch) -> Touch:
        """At the end of a step.

        Args:
            results: of the interfaces that may part.
            kinetic: energy now [force length].
            moved: by what bodies have, at most [length]: at rest both energies are rounding.
            before: at its start.
        """
        sides = [side for result in results for side in result.sides]
        gap = np.concatenate([np.zeros(0), *(getattr(s, "frame_gap", s.gap) for s in sides)])
        force = np.concatenate([np.zeros(0), *(s.normal_force for s in sides)])
        pressing = np.concatenate([np.zeros(0), *(s.pressing for s in sides)])
        largest = max(before.largest, float(force.max(initial=0.0)))
        gap = np.where(np.isfinite(gap) & (gap > GAP_ROUNDED * moved), gap, 0.0)
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


class Steps(Starting):
    """The division and the saving of the steps of ``TimeStepper``."""

    t: float
    _touch: Touch
    _adaptive: float | None
    _accepted: Callable[[Any], None] | None
    _known_mass: KnownMass
    _pulls: list[Pulls | None]  # per interface; None: without friction
    _end: float  # weight of what there is at the end of a step: (1 + damping) / 2

    def _speed(self, u: Array) -> Array:
        """(n_local,) velocity at the start of a step from u (n_local,): none where supports do not
        move in it, of which the rule would turn it round in every step."""
        bulk, v = self.problem.bulk, self._values(self._v)
        return np.where(bulk.dofs.fixed & (bulk.values() == u), 0.0, v)

    def _once(self, dt: float, part: float) -> None:
        """One step of dt, this part of what is still to be gone."""
        raise NotImplementedError

    def _advance(self, dt: float, divisions: int, later: float = 0.0) -> None:
        """Go on by dt, in parts where that fails, or where bodies meet or part in it; ``later``:
        what of the user's step comes after it."""
        self._known_mass.require()
        self._follow()
        kept = self.state_arrays() if self._adaptive and divisions else None
        try:
            self._once(dt, dt / (dt + later))
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
                self._touch, self._at = touch, self._values(self._u)
                self.t += dt
                warn(self.comm, self._pulled(dt), ())
                if self._accepted is not None:
                    with collective(self.comm):
                        self._accepted(self)
                return
            self.take_back(*kept)
            log.info("a step of %.3g in which bodies meet or part is divided", dt)
        self._advance(at * dt, divisions - 1, later + (1.0 - at) * dt)
        self._advance((1.0 - at) * dt, divisions - 1, later)

    def _pulled(self, dt: float) -> list[str]:
        """What is to be said of pairs that have pulled, with a step of length dt."""
        both = zip(self._pulls, self.problem.results, strict=True)
        rubs = [(pulls, result.sides) for pulls, result in both if pulls]
        for pulls, sides in rubs:
            pulls.take(sides, dt)
        largest = max((pulls.pressed for pulls, _ in rubs), default=0.0)
        damping = 2.0 * self._end - 1.0
        return [words for pulls, _ in rubs for words in pulls.told(largest, damping)]

    def _met(self) -> tuple[Touch, float]:
        """What bodies meet with now, and where the step is to be divided; 0: nowhere."""
        if self._adaptive is None:
            return self._touch, 0.0
        v = self._values(self._v)
        momentum = times(self._M, v)
        most = (float(np.abs(a).max(initial=0.0)) for a in (momentum, self._values(self._u)))
        found = self.comm.allgather((float(v @ momentum), *most))
        kinetic = 0.5 * sum(energy for energy, *_ in found)
        fastest, moved = np.max([most for _, *most in found], axis=0)
        of = zip(self.problem.interfaces, self.problem.results, strict=True)
        results = [result for i, result in of if i.law.opens and not i.law.gives]
        touch = Touch.of(results, kinetic, moved, self._touch)
        at = touch.divides(self._touch, self._adaptive, NO_PULL * fastest / self.dt)
        return touch, told(self.comm, at)

    @property
    def interfaces(self) -> Any:
        """Of the problem."""
        return self.problem.interfaces

    @property
    def saved_bulk(self) -> Any:
        """Of the problem."""
        return self.problem.bulk

    def places(self) -> Array:
        """Places of the interfaces, which tell this scene from others."""
        return self.problem.places()

    def led(self) -> list[int | None]:
        """Of the problem."""
        return list(self.problem.led())

    def update(self) -> None:
        """Of the problem."""
        self.problem.update()

    def state_arrays(self) -> tuple[Arrays, Arrays]:
        """What is the same on every rank, and this rank's values at the bodies' dofs."""
        common, local = self.problem.state_arrays()
        touch = self._touch
        common |= {"time": np.array([self.t, self.dt, touch.kinetic, touch.largest])}
        common |= {"touch": np.array([touch.gap, touch.force, touch.pressing]), "led": self._led}
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
        self._led = common["led"]
        self.problem.take_arrays(common, local)
        counts = self.problem.bulk.dofs.counts
        fill(self._u, local["displacement"], counts)
        fill(self._v, local["velocity"], counts)
        self._left, self._started = local["inertia"], True
        self._fixed, self._at = self.problem.bulk.dofs.fixed, local["displacement"]
