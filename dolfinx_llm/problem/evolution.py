"""What bodies remember at points: brought up to date by UFL expressions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms import extract_coefficients

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import collective

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


def _values(function: fem.Function, new: fem.Expression) -> np.ndarray:
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
