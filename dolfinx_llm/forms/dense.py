"""Small dense systems of a contact step: refined solves, and the rows in contact by pivoting."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.forms.step import SIGN, LinearStep
from dolfinx_llm.laws.complementarity import complementarity


def choose(step: LinearStep, A: Array, rhs: Array) -> Array:
    """Rows in contact: linear complementarity among those whose sign is or becomes wrong. A x = rhs
    are the equations of all rows, the frame and the rigid motions.

    The others keep their state and are eliminated. Eliminating the frame without them would leave
    its nodes to the proximal term, whose compliance drowns that of the bodies.
    """
    n, rows = len(step.active), np.flatnonzero(step.may_open)
    kept = np.concatenate([np.flatnonzero(step.active), np.arange(n, len(A))])
    place = np.cumsum(step.active) - 1
    on = step.active[rows]
    solve = refined(A[np.ix_(kept, kept)])
    look = A[np.ix_(rows, kept)]

    def signs(x: Array, gap: Array) -> Array:
        """What must not be negative: λ / c in contact, gaps elsewhere."""
        found = look @ x + gap
        found[on] = x[place[rows[on]]]
        return found

    x = solve(rhs[kept][:, None])
    now = signs(x, -rhs[rows][:, None])[:, 0]
    band = SIGN * max(np.abs(x[: int(step.active.sum())]).max(initial=0.0), 1e-300)
    pairs, new = np.empty(0, dtype=np.int64), np.flatnonzero(now < -band)
    columns, change = np.empty((len(rows), 0)), np.zeros(0, dtype=bool)
    while len(new):
        load = np.where(on[new], 0.0, -1.0) * A[np.ix_(kept, rows[new])]
        load[place[rows[new[on[new]]]], np.flatnonzero(on[new])] = 1.0
        gap = np.where(on[new], 0.0, 1.0) * A[np.ix_(rows, rows[new])]
        columns = np.hstack([columns, signs(solve(load), gap)])
        pairs = np.concatenate([pairs, new])
        change = complementarity(columns[pairs], now[pairs], now[pairs] < 0.0)
        M = columns[pairs][np.ix_(change, change)]
        after = now + columns[:, change] @ np.linalg.solve(M, -now[pairs][change])
        after[pairs] = 0.0
        new = np.flatnonzero(after < -band)
    active = step.active.copy()
    active[rows[pairs[change]]] ^= True
    return active


def refined(A: Array) -> Callable[[Array], Array]:
    """Solves dense systems with A, rows scaled and with one step of refinement; ``LinAlgError``
    where A is singular."""
    if not len(A):  # supports hold the body, and nothing touches the obstacle
        return lambda b: b
    scale = 1.0 / np.maximum(np.abs(A).max(axis=1), 1e-300)[:, None]
    A = A * scale
    factor = scipy.linalg.lu_factor(A, check_finite=False)
    if not np.abs(np.diagonal(factor[0])).min(initial=np.inf) > 0.0:
        raise np.linalg.LinAlgError("a pivot is zero")

    def solve(b: Array) -> Array:
        b = b * scale
        x = scipy.linalg.lu_solve(factor, b, check_finite=False)
        x += scipy.linalg.lu_solve(factor, b - A @ x, check_finite=False)
        if not np.isfinite(x).all():
            raise np.linalg.LinAlgError("the solution is not finite")
        return x

    return solve
