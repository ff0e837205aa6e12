"""Steps in time as a file: saved and read again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_llm.problem.bulk import fill
from dolfinx_llm.problem.saving import Saving
from dolfinx_llm.problem.state_file import Arrays


class SavedSteps(Saving):
    """Saving of ``TimeStepper``."""

    problem: Any
    t: float
    dt: float
    _u: list[fem.Function]
    _v: list[fem.Function]
    _left: np.ndarray

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
        common |= {"time": np.array([self.t, self.dt])}
        own = {"displacement": self._values(self._u), "velocity": self._values(self._v)}
        return common, local | own | {"inertia": self._left}

    def take_arrays(self, common: Arrays, local: Arrays) -> None:
        """Go on from what ``state_arrays`` returned; collective.

        Args:
            common, local: as it returned them.
        """
        self.t, self.dt = map(float, common["time"])
        self._use(4.0 / self.dt**2)
        self.problem.take_arrays(common, local)
        counts = self.problem.bulk.dofs.counts
        fill(self._u, local["displacement"], counts)
        fill(self._v, local["velocity"], counts)
        self._left = local["inertia"]

    def _values(self, functions: Sequence[fem.Function]) -> np.ndarray:
        """(n_local,) of this rank."""
        counts = self.problem.bulk.dofs.counts
        return np.concatenate([w.x.array[:n] for w, n in zip(functions, counts, strict=True)])

    def _use(self, c: float) -> None:
        """Take another rate of inertia [1 / time²]."""
        raise NotImplementedError
