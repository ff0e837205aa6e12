"""How stiff the surfaces of bodies are: diagonals of K (n_local,) there."""

from collections.abc import Sequence

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.numbering import BodyDofs, Rows


def surface_stiffness(dofs: BodyDofs, diagonal: Array, rows: Rows, tied: bool) -> float:
    """Mean diagonal of K on the free surface dofs [force / length]; the geometric mean where
    bodies may part, since there the softer one tells the forces."""
    at = rows.dofs.ravel() - dofs.first
    at = at[(at >= 0) & (at < len(dofs.fixed))]
    values = np.abs(diagonal[at[~dofs.fixed[at]]])
    values = values if tied else np.log(np.maximum(values, 1e-300))
    total, count = dofs.comm.allreduce(np.array([values.sum(), float(len(values))]))
    mean = total / count if count else float(tied)
    return float(mean if tied else np.exp(mean))


def side_stiffness(
    dofs: BodyDofs, diagonal: Array, sides: Sequence[Array], otherwise: float
) -> Array:
    """(s,) geometric mean of K's diagonal on the free dofs of some sides [force / length];
    ``otherwise`` where a side has none."""
    found, size = [], np.log(np.maximum(np.abs(diagonal), 1e-300))
    for at in sides:
        values, free = (dofs.values(at, of) for of in (size, 1.0 - dofs.fixed))
        count = free.sum()
        found.append(np.exp((values * free).sum() / count) if count else otherwise)
    return np.array(found)


def body_stiffness(dofs: BodyDofs, diagonal: Array, bodies: Bodies, otherwise: float) -> Array:
    """(bodies,) geometric mean of K's diagonal on the free dofs of each body [force / length];
    ``otherwise`` where there are none."""
    free = ~dofs.fixed[bodies.dofs]
    label = np.repeat(bodies.label, bodies.components)[free]
    values = np.log(np.maximum(np.abs(diagonal[bodies.dofs[free]]), 1e-300))
    sums = [np.bincount(label, of, minlength=bodies.count) for of in (values, np.ones(len(values)))]
    total, number = dofs.comm.allreduce(np.array(sums))
    return np.where(number > 0.0, np.exp(total / np.maximum(number, 1.0)), otherwise)


def in_series(stiffness: Array) -> float:
    """Mean stiffness of sides (s,) that yield together: the softer one tells [force / length].

    >>> in_series(np.array([2.0, 2.0])), round(in_series(np.array([1.0, 1e6])), 3)
    (2.0, 2.0)
    """
    return float(len(stiffness) / np.sum(1.0 / stiffness))
