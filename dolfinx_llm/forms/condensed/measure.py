"""By what residuals of steps with friction are measured, and how far a solve has to go."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.forms.condensed.friction_system import FrictionSystem
from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.forms.verdict import EPS
from dolfinx_llm.operators.petsc import diagonal_of

LEAVES = 1e-2  # of a residual about the last iterate, by a linear solve, at most
FIRMLY = 1e-6  # the same where that misleads the law
HARD = 12.0  # iterations per digit: so many
STALLS = 3  # solves towards a load that began no nearer than the last, with states that change
CLOSER = 0.1  # of what the last solve has left: less is left from then on
FORCES = 10.0  # times forces between bodies: as much load is usual
SMALLEST_FORCES = 1e-8  # of the load: forces count as no less
LEFT_BY_ROUNDING = 4.0 * EPS  # of the load: what rounding leaves
FINAL = 1e-13  # of the forces: nothing less is asked for


class Measure:
    """Of residuals of one step.

    Bodies bear the same forces, whichever is stiffer: residuals are those of unit diagonal, times
    the root of how much stiffer a body is. Else forces on the stiffer body would hardly show.

    Args:
        of: what steps keep.
        form: the step's places.
        corner: last block of its matrix.

    Attributes:
        scaling: of each place.
    """

    def __init__(self, of: FrictionSystem, form: Transformation, corner: Any) -> None:
        self._of, self._form, self._split = of, form, of.split
        diagonal = of.split.inside_diagonal, diagonal_of(corner)
        body, frame = of.shares
        tail, there = np.ones(form.tail.sizes[0]), form.tail.left >= 0
        tail[form.tail.left[there]] = body[of.split.surface[there]]
        tail[form.tail.seats] = frame[form.tail.mine_used]
        by = scales_of(np.concatenate(diagonal), of.operators.scale)
        self.scaling = by * np.concatenate([body, tail])

    def norm(self, r: Array) -> float:
        """Of this rank's residual of all places."""
        squares = float(np.sum((self.scaling * r) ** 2))
        return float(np.sqrt(self._split.comm.allreduce(squares)))

    def level(self, q: Array, around: Any, load: float) -> float:
        """What residuals are compared with: the load, or, where prescribed motions make that far
        larger, the forces on the softer sides of interfaces, which do not know rounding.

        Args:
            q: what is added to the start.
            around: this rank's loads and the start; None: the load counts.
            load: its norm.
        """
        if around is None:
            return load
        (f, u_0), operators, S = around, self._of.operators, self._split.surface
        force = np.zeros(len(f))
        force[S] = f[S] - self._split.rows(self._form.motion(q) + u_0)
        force[operators.dofs.fixed] = 0.0
        squares = np.array([float(force[at] @ force[at]) for at in self._of.sides])
        sides = self._split.comm.allreduce(squares) / operators.scale
        ends = zip(operators.places, operators.stiffness, strict=True)
        softer = [place.sides.start + stiffness.argmin() for place, stiffness in ends]
        between = FORCES * float(np.sqrt(sides[softer].max(initial=0.0)))
        return min(load, max(between, SMALLEST_FORCES * load))

    def goal(self, size: float, level: float, load: float, end: bool) -> float:
        """What a solve is to leave.

        Args:
            size: of the residual that it begins with.
            level, load: as of ``level``.
            end: nothing has changed since the last solve.
        """
        of, least = self._of, max(FINAL * level, LEFT_BY_ROUNDING * load)
        if end or of.loose is not None:
            return max((of.loose or 0.0) * load, least)
        goal = goal_of(size, level, of.usual < HARD)
        return max(min(goal, CLOSER * of.left) if of.stalls > STALLS else goal, least)


def scales_of(diagonal: Array, scale: float) -> Array:
    """Inverse square roots of a diagonal; of entries that are none that of ``scale``."""
    size = np.abs(diagonal)
    return 1.0 / np.sqrt(np.where(size > 1e-12 * scale, size, scale))


def goal_of(size: float, level: float, easily: bool) -> float:
    """What a solve is to leave of a residual about the last iterate, by the sizes of that and of
    the forces. Newton's next residual is about the square of one: less is not worth it. Where it
    does not follow ``easily`` loose solves mislead the law, and where forces are far smaller than
    what a solve begins with, what it leaves shows in them."""
    if not min(size, level) > 0.0:
        return 0.0
    leaves = (LEAVES if easily else FIRMLY) * min(1.0, float(np.sqrt(level / size)))
    return min(leaves, size / level) * min(size, level)
