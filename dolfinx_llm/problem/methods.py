"""How a problem is solved: ties at once, other laws by iteration and in load steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx_llm.base.log import progress
from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.contact.iteration import ContactIteration
from dolfinx_llm.forms.choice import build_steps, build_system, warn
from dolfinx_llm.operators.system import ContactOperators
from dolfinx_llm.problem.bulk import LinearBulk


@dataclass(frozen=True)
class Setting:
    """What a method works with."""

    form: str  # of the system: "saddle", "condensed" or "flexibility"
    bulk: LinearBulk
    operators: ContactOperators
    prefix: str  # of the PETSc options
    options: dict | None  # PETSc options
    times: StageTimes


class TiedMethod:
    """Ties: one solve of (31); what was factorised serves the next.

    Attributes:
        system: of (31), once there is one.
        states: None: there is nothing that may change.
        history: see ``ContactProblem``.
    """

    states = None

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.history: list[dict] = []
        self.system: Any = build_system(*vars(setting).values())

    def solve(self, f: np.ndarray, increments: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """This rank's u, and all of λ and v, for a load f (n_local,)."""
        operators = self.setting.operators
        g = operators.gap(f)
        with self.setting.times.timed("solve"):
            u, multiplier, v = self.system.solve(f, g)
        warn(self.system, operators.comm)
        multiplier = operators.least(operators.gather(operators.rows.numbering, multiplier))
        n = sum(len(pairs.nodes) for pairs in operators.pairs)
        self.history = [
            {"iteration": 1, "active": n, "stick": n, "slip": 0, "residual": self.system.residual}
        ]
        return u, multiplier, operators.gather(operators.frames, v)

    def reset(self) -> None:
        """Nothing to forget: every solve is for the whole load."""

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.system.destroy()


class LawMethod:
    """Laws that let bodies part or slip: load steps, iterated, smaller where they do not converge.

    Attributes:
        system: what solves the linear steps.
        iteration: ``ContactIteration``, which holds the state.
    """

    def __init__(self, setting: Setting) -> None:
        form, bulk, operators, *_ = vars(setting).values()
        self.setting = setting
        with setting.times.timed("factorisation"):
            self.system: Any = build_steps(form, bulk, operators, setting.prefix, setting.options)
        at_rest = np.zeros(len(operators.dofs.fixed))
        gaps = operators.gather(operators.rows.numbering, operators.gap(at_rest, moved=False))
        self.iteration = ContactIteration(operators, self.system, at_rest, gaps)

    @property
    def states(self) -> Any:
        """Per interface its ``InterfaceState``."""
        return self.iteration.states

    @property
    def history(self) -> list[dict]:
        """See ``ContactProblem``."""
        return self.iteration.history

    def solve(self, f: np.ndarray, increments: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """This rank's u, and all of λ and v, at the end of the step to a load f (n_local,)."""
        operators, stage = self.setting.operators, "iteration of contact laws"
        g = operators.gap(f)
        with self.setting.times.timed(stage), progress(None, stage) as self.iteration.bar:
            return self.iteration.advance(
                f, operators.gather(operators.rows.numbering, g), increments
            )

    def reset(self) -> None:
        """Forget the last load steps: contact state, slip and loads."""
        self.iteration.forget()

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.system.destroy()


def method_of(setting: Setting) -> TiedMethod | LawMethod:
    """The method that the laws of the interfaces need, set up."""
    laws = [model.interface.law for model in setting.operators.models]
    return (LawMethod if any(law.unilateral for law in laws) else TiedMethod)(setting)
