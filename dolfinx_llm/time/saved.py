"""Steps in time as a file: saved and read again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_llm.problem.bulk import fill
from dolfinx_llm.problem.saving import Saving
from dolfinx_llm.problem.state_file import Arrays
from dolfinx_llm.time.impact import Touch


class SavedSteps(Saving):
    """Saving of ``TimeStepper``."""

    problem: Any
    t: float
    dt: float
    _u: list[fem.Function]
    _v: list[fem.Function]
    _left: np.ndarray
    _touch: Touch

    @property
    def interfaces(self) -> Any:
        """Of the problem."""
        return self.problem.interfaces

    def saved_spaces(self) -> Sequence[Any]:
        """Spaces of the bodies' dofs."""
        return self.problem.saved_spaces()

    def places(self) -> np.ndarray:
        """Places of the interfaces, which tell this scene from others."""
        return self.problem.places()

    def state_arrays(self) -> tuple[Arrays, Arrays]:
        """What is the same on every rank, and this rank's values at the bodies' dofs."""
        common, local = self.problem.state_arrays()
        touch = self._touch
        common |= {"time": np.array([self.t, self.dt, touch.kinetic, touch.largest])}
        common |= {"touch": np.array([touch.gap, touch.force])}
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
        self._left = local["inertia"]

    def _values(self, functions: Sequence[fem.Function]) -> np.ndarray:
        """(n_local,) of this rank."""
        counts = self.problem.bulk.dofs.counts
        return np.concatenate([w.x.array[:n] for w, n in zip(functions, counts, strict=True)])

    def _rate(self, dt: float) -> float:
        """Of inertia in steps of dt [1 / time²]."""
        raise NotImplementedError

    def _use(self, c: float, starts: bool = False) -> None:
        """Take another rate of inertia [1 / time²]; ``starts``: for the forces at the start."""
        raise NotImplementedError
