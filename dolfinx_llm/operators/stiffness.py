"""How stiff the surfaces of bodies are: diagonals of K there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from dolfinx_llm.operators.system import ContactOperators


def surface_stiffness(operators: ContactOperators) -> float:
    """Mean diagonal of K on the free surface dofs [force / length]; the geometric mean where
    bodies may part, since there the softer one tells the forces."""
    fixed, rows = operators.dofs.fixed, operators.rows.dofs.ravel() - operators.dofs.first
    rows = rows[(rows >= 0) & (rows < len(fixed))]
    values = np.abs(operators.diagonal[rows[~fixed[rows]]])
    values = values if operators.tied else np.log(np.maximum(values, 1e-300))
    total, count = operators.comm.allreduce(np.array([values.sum(), float(len(values))]))
    mean = total / count if count else float(operators.tied)
    return float(mean if operators.tied else np.exp(mean))


def side_stiffness(operators: ContactOperators, sides: slice) -> np.ndarray:
    """(s,) geometric mean of K's diagonal on the free dofs of some sides [force / length]; that of
    all surfaces where a side has none."""
    found, dofs = [], operators.dofs
    size = np.log(np.maximum(np.abs(operators.diagonal), 1e-300))
    for at in operators.side_dofs[sides]:
        values, free = (dofs.values(at, of) for of in (size, 1.0 - dofs.fixed))
        count = free.sum()
        found.append(np.exp((values * free).sum() / count) if count else operators.scale)
    return np.array(found)


def body_stiffness(operators: ContactOperators) -> np.ndarray:
    """(bodies,) geometric mean of K's diagonal on the free dofs of each body [force / length]; that
    of the surfaces where there are none."""
    dofs, count, components = operators.dofs, operators.bodies.count, operators.bodies.components
    at = operators.bodies.dofs
    label = np.repeat(operators.bodies.label, components)[~dofs.fixed[at]]
    values = np.log(np.maximum(np.abs(operators.diagonal[at[~dofs.fixed[at]]]), 1e-300))
    sums = [np.bincount(label, of, minlength=count) for of in (values, np.ones(len(values)))]
    total, number = operators.comm.allreduce(np.array(sums))
    found = np.exp(total / np.maximum(number, 1.0))
    return np.where(number > 0.0, found, operators.scale)


def in_series(stiffness: np.ndarray) -> float:
    """Mean stiffness of sides (s,) that yield together: the softer one tells [force / length].

    >>> in_series(np.array([2.0, 2.0])), round(in_series(np.array([1.0, 1e6])), 3)
    (2.0, 2.0)
    """
    return float(len(stiffness) / np.sum(1.0 / stiffness))
