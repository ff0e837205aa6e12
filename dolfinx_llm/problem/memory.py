"""Load steps of bodies with a memory: what is called when a part of one has been found, what goes
back where the rest of it cannot be, and what bodies remember at points, by UFL expressions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.algorithms import extract_arguments, extract_coefficients

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import agree, collective

INSTANT = 1e-6  # of a step in time, in which no body creeps
CLOCKS = "give the Constant of the forms that is the step in time, or a list of them, one per mesh"
STATE = "give a list of Functions"
RULES = "give a dict of Functions, and for each a UFL expression of its shape"


class Evolution:
    """Functions that take new values after each part of a load step: plastic strain, viscous
    stress, the displacement before. Give it as ``accepted`` of ``solve`` or ``TimeStepper``.

    All new values are found from the old ones before the first is replaced.

    Args:
        rules: for each Function what it becomes, a UFL expression of its shape, in which it and the
            others stand for what they are before. Functions of ``compat.quadrature_space`` take the
            values at their points, others are interpolated.

    Attributes:
        state: the Functions.

    Raises:
        ContactInputError: no such rules, or an expression that cannot be compiled.
    """

    def __init__(self, rules: Mapping[fem.Function, Any]) -> None:
        if not isinstance(rules, Mapping) or not rules:
            checks.refuse("rules", rules, RULES)
        self.state = list(rules)
        for function, new in rules.items():
            checks.instance("rules: key", function, fem.Function, RULES)
            checks.instance("rules: value", new, ufl.core.expr.Expr, RULES)
            if new.ufl_shape != function.ufl_shape:
                raise ContactInputError(
                    f"rules: the Function {function.name} has the shape {function.ufl_shape}, and "
                    f"what it becomes {new.ufl_shape}: {RULES}"
                )
            if extract_arguments(new):
                raise ContactInputError(
                    f"rules: what the Function {function.name} becomes has a test or trial "
                    f"function, which has no values: {RULES}"
                )
            parts = (p for p in extract_coefficients(new) if isinstance(p, fem.Function))
            mesh = function.function_space.mesh
            if other := [p.name for p in parts if p.function_space.mesh is not mesh]:
                raise ContactInputError(
                    f"rules: the Function {function.name} follows from {', '.join(other)} of "
                    "another mesh: interpolate onto its own"
                )
        with collective(self.state[0].function_space.mesh.comm):
            self._new = [_compiled(f, new) for f, new in rules.items()]

    def __call__(self, problem: Any = None) -> None:
        """Replace all values by the new ones; collective."""
        found = [_values(f, new) for f, new in zip(self.state, self._new, strict=True)]
        for function, values in zip(self.state, found, strict=True):
            function.x.array[:] = values
            function.x.scatter_forward()


def _compiled(function: fem.Function, new: Any) -> fem.Expression:
    """An expression for the points where a Function takes its values."""
    V = function.function_space
    points = compat.points_of(V)
    if points is None:
        points = V.element.interpolation_points
        points = points() if callable(points) else points
    try:
        return fem.Expression(new, points)
    except Exception as error:
        text = " ".join(str(error).split())[:300]
        raise ContactInputError(
            f"rules: what the Function {function.name} becomes cannot be compiled: {text}"
        ) from error


def _values(function: fem.Function, new: fem.Expression) -> Array:
    """All of this rank's new values of a Function; those of ghosts need not be right."""
    V = function.function_space
    points = compat.points_of(V)
    if points is None:
        own = fem.Function(V)
        own.interpolate(new)
        return own.x.array
    at = compat.evaluate(new, points, V.mesh, function.ufl_shape)
    values, cells = function.x.array.copy(), compat.cell_dofs(V)[: len(at)]
    size = V.dofmap.index_map_bs
    values.reshape(-1, size)[cells] = at.reshape(*cells.shape, size)
    return values


class Memory:
    """What bodies remember in a load step.

    Args:
        problem: whose step it is.
        accepted, state, dt: as of ``solve``.

    Attributes:
        state: the Functions that go back where the step is given up; empty: what has been found is
            kept.

    Raises:
        ContactInputError: arguments of other types.
    """

    def __init__(self, problem: Any, accepted: Any, state: Any, dt: Any) -> None:
        comm: MPI.Comm = problem.comm
        with collective(comm):
            if accepted is not None and not callable(accepted):
                checks.refuse("accepted", accepted, "give a function of the problem, or None")
            one = isinstance(state, fem.Function)
            self.state = [state] if one else checks.items("state", state, STATE)
            for function in self.state:
                checks.instance("state: item", function, fem.Function, STATE)
            self.state += accepted.state if isinstance(accepted, Evolution) else []
            clocks = [] if dt is None else [dt] if isinstance(dt, fem.Constant) else dt
            self._clocks = checks.items("dt", clocks, CLOCKS)
            for clock in self._clocks:
                checks.instance("dt", clock, fem.Constant, CLOCKS)
                checks.number("dt", clock.value, "give Constants above 0", above=0.0)
        self._problem, self._accepted = problem, accepted
        self._whole = [float(clock.value) for clock in self._clocks]
        agree(comm, "accepted, state and dt", (accepted is None, len(self.state), self._whole))
        self._before = [function.x.array.copy() for function in self.state]

    def begins(self, part: float) -> None:
        """This part of the load step is tried now: so long is dt."""
        for clock, whole in zip(self._clocks, self._whole, strict=True):
            clock.value = part * whole

    def found(self) -> None:
        """A part has been found: the user's call."""
        if self._accepted is not None:
            with collective(self._problem.comm):
                self._accepted(self._problem)

    def ends(self, given_up: bool) -> None:
        """The load step is over; where it is given up, the state is as before."""
        self.begins(1.0)
        for function, values in zip(self.state, self._before if given_up else []):
            function.x.array[:] = values


class Remembering:
    """A problem whose bodies may have a memory."""

    def solve(
        self,
        increments: int = 1,
        *,
        accepted: Callable[[Any], None] | None = None,
        state: fem.Function | Sequence[fem.Function] = (),
        dt: fem.Constant | Sequence[fem.Constant] | None = None,
    ) -> Any:
        """Take a load step: from the last state to what conditions, loads and forms say now. All
        that has changed since is noticed. ``reset()`` forgets the last state.

        At finite deformation increments are halved where Newton's iteration fails. Linear bodies:
        the change of the load is applied in parts where a law does not converge, which are no
        steps in time and have no memory of their own; what is tied takes one part.

        Args:
            increments: equal parts of the step.
            accepted: called with the problem after each part that has been found, of linear bodies
                after the step: ``problem.u`` and ``results`` are those of the part. Update there
                what bodies remember, or give an ``Evolution``, which does so.
            state: the Functions that ``accepted`` changes; those of an ``Evolution`` are known.
                With them a step that fails is given up as a whole: they, u and contact are then
                as before it, so that it may be tried with other loads or a shorter dt.
            dt: Constant of the forms that holds the step in time, or one per mesh: at finite
                deformation it is that of the part while a part is sought and in ``accepted``.

        Returns:
            The displacement, of a mixed space all blocks: a Function, or a list for several meshes.
            At finite deformation it is the u that was given, updated in place.

        Raises:
            ContactInputError: increments below 1, arguments of other types, values that are not
                finite, also those of F where the step starts.
            ContactError: a system that cannot be solved, NaN in the load, a law that does not
                converge. At finite deformation, Newton's iteration fails however small increments
                are; without ``state`` u is then the last that was found, and ``solve`` may be
                called again.
        """
        memory = Memory(self, accepted, state, dt)
        given_up = True
        try:
            found = self._take(increments, memory)
            given_up = False
        finally:
            memory.ends(given_up)
        return found

    def _take(self, increments: int, memory: Memory) -> Any:
        """The load step of ``solve``."""
        raise NotImplementedError
