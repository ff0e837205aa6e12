"""How a problem is solved: ties at once, other laws by iteration and in load steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx_llm.base.log import progress
from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.contact.iteration import ContactIteration
from dolfinx_llm.contact.load_steps import advance
from dolfinx_llm.forms.choice import build_steps, build_system, describe, warn
from dolfinx_llm.operators.petsc import times
from dolfinx_llm.operators.reactions import with_reactions
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
    why: str  # this form


class TiedMethod:
    """Ties: one solve of (31); what was factorised serves the next.

    Attributes:
        setting: what it works with.
        system: of (31), once there is one.
        states: None: there is nothing that may change.
        history: see ``ContactProblem``.
    """

    states = None

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.history: list[dict] = []
        self.system: Any = None

    def renew(self, setting: Setting, keep: bool = False) -> None:
        """Work with another stiffness or other operators; there is no state to keep."""
        self.destroy()
        self.setting = setting

    def solve(self, f: np.ndarray, increments: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """This rank's u, and all of λ and v, for a load f (n_local,)."""
        operators = self.setting.operators
        if self.system is None:
            of = self.setting
            self.system = build_system(
                of.form, of.bulk, of.operators, of.prefix, of.options, of.times
            )
        g = operators.gap(f, operators.obstacle_motions())
        with self.setting.times.timed("solve"):
            u, multiplier, v = self.system.solve(f, g)
        warn(self.system, operators.comm)
        multiplier = operators.least(operators.gather(operators.rows.numbering, multiplier))
        n = sum(len(pairs.nodes) for pairs in operators.pairs)
        self.history = [
            {"iteration": 1, "active": n, "stick": n, "slip": 0, "residual": self.system.residual}
        ]
        v = operators.gather(operators.frames, v)
        return u, _with_reactions(self.setting, u, multiplier, v), v

    def describe(self) -> str:
        """For ``print(problem)``: the form, why, and what the last solve took."""
        return f"{describe(self.setting.form, self.system)} ({self.setting.why})"

    def reset(self) -> None:
        """Nothing to forget: every solve is for the whole load."""

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        if self.system is not None:
            self.system.destroy()
        self.system = None


class LawMethod:
    """Laws that let bodies part or slip: load steps, iterated, smaller where they do not converge.

    Attributes:
        setting: what it works with.
        system: what solves the linear steps, once there is one.
        iteration: ``ContactIteration``, which holds the state, once there is one.
    """

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.system: Any = None
        self.iteration: Any = None
        self._last: tuple[np.ndarray, list[np.ndarray]]  # u of this rank, motions of obstacles

    @property
    def states(self) -> Any:
        """Per interface its ``InterfaceState``."""
        return self.iteration.states

    @property
    def history(self) -> list[dict]:
        """See ``ContactProblem``."""
        return self.iteration.history

    def renew(self, setting: Setting, keep: bool = False) -> None:
        """Work with another stiffness or other operators.

        Args:
            setting: what to work with from now on.
            keep: go on from the state of contact and from the displacement that there were, held by
                the load that it takes with the new stiffness; else from rest.
        """
        self.destroy()
        self.setting = setting
        if not keep:
            self.iteration = None

    def _set_up(self) -> None:
        """The system, and an iteration that goes on from the one before, if there is one."""
        of, operators = self.setting, self.setting.operators
        before, at_rest = self.iteration, np.zeros(len(operators.dofs.fixed))
        known = before is not None and before.multiplier is not None
        held = self._holding(before.multiplier) if known else at_rest
        with of.times.timed("factorisation"):
            self.system = build_steps(of.form, of.bulk, operators, of.prefix, of.options)
        self.iteration = ContactIteration(operators, self.system, at_rest, self._gaps(at_rest))
        if known:
            self.iteration.resume(before, held, self._gaps(*self._last), self._last[0])

    def _gaps(self, u: np.ndarray, motions: Any = None) -> np.ndarray:
        """(n,) g where supports are as u (n_local,), and obstacles moved."""
        operators = self.setting.operators
        return operators.gather(operators.rows.numbering, operators.gap(u, motions))

    def _holding(self, multiplier: np.ndarray) -> np.ndarray:
        """This rank's load that holds the last displacement, prescribed values at fixed dofs."""
        bulk, operators = self.setting.bulk, self.setting.operators
        own = multiplier[operators.rows.numbering.mine]
        return times(bulk.K, self._last[0]) + times(operators.B, own)

    def solve(self, f: np.ndarray, increments: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """This rank's u, and all of λ and v, at the end of the step to a load f (n_local,)."""
        if self.system is None:
            self._set_up()
        motions, stage = self.setting.operators.obstacle_motions(), "iteration of contact laws"
        g = self._gaps(f, motions)
        with self.setting.times.timed(stage), progress(None, stage) as self.iteration.bar:
            u, multiplier, w = advance(self.iteration, f, g, increments)
        self._last = u, motions
        sticks = np.concatenate([state.sticking_rows() for state in self.states])
        return u, _with_reactions(self.setting, u, multiplier, w, sticks), w

    def describe(self) -> str:
        """For ``print(problem)``: the form, and why."""
        return f"{describe(self.setting.form, None)} ({self.setting.why})"

    def reset(self) -> None:
        """Forget the last load steps: contact state, slip and loads."""
        if self.iteration is not None:
            self.iteration.forget()

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        if self.system is not None:
            self.system.destroy()
        self.system = None


def _with_reactions(
    setting: Setting,
    u: np.ndarray,
    multiplier: np.ndarray,
    v: np.ndarray,
    sticks: np.ndarray | None = None,
) -> np.ndarray:
    """Multipliers (n,) with what bodies pass on at nodes that supports hold."""
    if not setting.operators.held.any():
        return multiplier
    return with_reactions(setting.operators, multiplier, v, u, setting.bulk.force(u), sticks)


def method_of(setting: Setting) -> TiedMethod | LawMethod:
    """The method that the laws of the interfaces need."""
    laws = [model.interface.law for model in setting.operators.models]
    return (LawMethod if any(not law.ties for law in laws) else TiedMethod)(setting)
