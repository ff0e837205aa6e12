"""Where a step in time in which bodies meet or part is to be divided.

Over a step energy changes by the mean force of a pair times the change of its gap. Where it closes
that takes λ₁ gap₀ / 2; where it parts it has been held for a moment, and what it pulled with at the
end of one step, -λ₀, takes -λ₀ gap₁ / 2 in the next one. Both fall with the square of the step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

LATEST_PART = 0.95  # of a step: what comes after it is not worth a step of its own


@dataclass(frozen=True, eq=False)
class Touch:
    """What bodies meet with at the end of a step; n nodes of all surfaces that may part."""

    gap: np.ndarray  # (n,) to the frame, 0 where a node meets none [length]
    force: np.ndarray  # (n,) normal, positive in compression [force]
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
        largest = max(before.largest, float(force.max(initial=0.0)))
        gap = np.where(np.isfinite(gap), gap, 0.0)
        return cls(gap, force, max(before.kinetic, kinetic), largest)

    def divides(self, before: Touch, part: float) -> float:
        """Where a step from ``before`` to here is to be divided, as a part of it; 0: nowhere.

        Args:
            before: at its start.
            part: of the kinetic energy, that closing may take; its root, of the largest force,
                pairs may pull with.
        """
        if len(self.gap) != len(before.gap):  # nothing is known
            return 0.0
        taken = 0.5 * float(self.force @ np.maximum(before.gap, 0.0))
        if taken > part * self.kinetic:
            return 0.5
        pulls = (self.force < 0.0) & (before.force > 0.0)
        pressed, now = float(before.force[pulls].sum()), float(self.force[pulls].sum())
        allowed = np.sqrt(part) * self.largest
        if -now <= allowed:
            return 0.0
        at = (pressed + 0.5 * allowed) / (pressed - now)  # there they hardly pull
        return at if at < LATEST_PART else 0.0
