"""Steps in time that are taken in parts, where they fail or bodies meet or part in them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.log import log
from dolfinx_llm.operators.petsc import times
from dolfinx_llm.problem.bulk import fill
from dolfinx_llm.time.impact import Touch
from dolfinx_llm.time.saved import SavedSteps


class DividedSteps(SavedSteps):
    """Division of the steps of ``TimeStepper``."""

    _M: Any
    _adaptive: float | None
    _accepted: Callable[[Any], None] | None

    def _once(self, dt: float) -> None:
        """One step of dt."""
        raise NotImplementedError

    def _advance(self, dt: float, divisions: int) -> None:
        """Go on by dt, in parts where that fails, or where bodies meet or part in it."""
        before = self._values(self._u)
        kept = self.state_arrays() if self._adaptive and divisions else None
        try:
            self._once(dt)
        except ContactInputError:
            raise
        except ContactError as failed:
            fill(self._u, before, self.problem.bulk.dofs.counts)
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
        kinetic = 0.5 * self.comm.allreduce(float(v @ times(self._M, v)))
        of = zip(self.problem.interfaces, self.problem.results, strict=True)
        results = [result for i, result in of if i.law.opens and not i.law.gives]
        touch = Touch.of(results, kinetic, self._touch)
        return touch, touch.divides(self._touch, self._adaptive)
