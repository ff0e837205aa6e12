"""Linear complementarity: λ >= 0, s = M λ + q >= 0, λ s = 0. Plain NumPy."""

from __future__ import annotations

import numpy as np

from dolfinx_llm.base.arrays import Array

BLOCKS = 10  # exchanges of whole blocks without progress
TRANSPOSED = 1e-10  # of the largest entry: a difference from the transpose that is rounding


def complementarity(M: Array, q: Array, start: Array) -> Array:
    """Which λ are positive.

    All wrong signs are exchanged at once (Júdice and Pires, Computers & Operations Research 21
    (1994) 587-596). Where that turns in circles and M is symmetric (no friction), descent takes
    over from the best choice; without symmetry Lemke's method (Management Science 11 (1965)
    681-689), which starts from nothing and ends for every matrix with positive principal minors.

    Args:
        M: (n, n) matrix with positive principal minors, as that of a convex problem.
        q: (n,).
        start: (n,) a guess of the result.

    Returns:
        (n,) whether λ is positive. With friction M may lack the property; where both methods fail,
        the result with the fewest wrong signs.

    Raises:
        numpy.linalg.LinAlgError: M is singular on a set of λ.

    >>> M, q = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-4.0, 1.0])
    >>> complementarity(M, q, np.array([True, True]))  # λ = (2, 0), s = (0, 3)
    array([ True, False])
    """
    scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diagonal(M)), 1e-300))
    M, q = M * scale[:, None] * scale, q * scale
    positive, best, fewest, left = start.copy(), start, len(q) + 1, BLOCKS
    while left:
        wrong = _wrong(M, q, positive)
        if not len(wrong):
            return positive
        left -= 1
        if len(wrong) < fewest:
            best, fewest, left = positive.copy(), len(wrong), BLOCKS
        positive[wrong] ^= True
    symmetric = np.abs(M - M.T).max() <= TRANSPOSED * np.abs(M).max()
    found = _descent(M, q, best) if symmetric else _lemke(M, q)
    if found is not None and len(_wrong(M, q, found)) < fewest:
        return found
    return best


def _wrong(M: Array, q: Array, positive: Array) -> Array:
    """Where λ or s is negative beyond rounding, for a choice of the positive λ."""
    x = np.linalg.solve(M[np.ix_(positive, positive)], -q[positive])
    rows = M[np.ix_(~positive, positive)]
    value, noise = np.empty(len(q)), np.empty(len(q))
    value[positive], value[~positive] = x, rows @ x + q[~positive]
    noise[positive] = np.abs(x).max(initial=0.0)
    noise[~positive] = np.abs(rows) @ np.abs(x) + np.abs(q[~positive])
    return np.flatnonzero(value < -1e-13 * noise)


def _descent(M: Array, q: Array, positive: Array) -> Array:
    """Least λᵀMλ / 2 + qᵀλ over λ >= 0, M positive definite: the set where λ > 0.

    The active set method of Lawson and Hanson: λ stays feasible and the energy falls, so that no
    set comes back. Rows that pull join several at a time as long as that moves λ.
    """
    x, on = np.zeros(len(q)), np.flatnonzero(positive)
    x[on] = np.maximum(np.linalg.solve(M[np.ix_(on, on)], -q[on]), 0.0)
    positive = x > 0.0
    for _ in range(50 + 3 * len(q)):
        before = x
        x, positive = _descend(M, q, x, positive)
        wrong = _wrong(M, q, positive)
        if not len(wrong):
            break
        slope = M[wrong] @ x + q[wrong]
        moved = np.abs(x - before).max() > 1e-14 * np.abs(x).max()
        positive = positive.copy()
        positive[wrong[slope <= (0.1 if moved else 1.0) * slope.min()]] = True
    return positive


def _descend(M: Array, q: Array, x: Array, positive: Array) -> tuple[Array, Array]:
    """From x to the least energy over the positive λ, or as far as they stay positive: those that
    do not are left out."""
    x, positive = x.copy(), positive.copy()
    while positive.any():
        on = np.flatnonzero(positive)
        target = np.linalg.solve(M[np.ix_(on, on)], -q[on])
        down = target <= 0.0
        if not down.any():
            x[on] = target
            break
        ratio = np.full(len(on), np.inf)
        ratio[down] = 0.0  # of what is 0 already, also where it is to stay 0
        np.divide(x[on], x[on] - target, out=ratio, where=down & (x[on] > 0.0))
        leaves = ratio <= ratio.min() * (1.0 + 1e-12)
        x[on] = np.where(leaves, 0.0, x[on] + ratio.min() * (target - x[on]))
        positive[on[leaves]] = False
    return x, positive


def _lemke(M: Array, q: Array) -> Array | None:
    """Lemke's complementary pivoting; None where it ends on a ray."""
    n = len(q)
    if (q >= 0.0).all():
        return np.zeros(n, dtype=bool)
    # Columns: s (0 .. n-1), λ (n .. 2n-1), the artificial variable (2n), right-hand side.
    T = np.hstack([np.eye(n), -M, -np.ones((n, 1)), q[:, None]])
    basis = np.arange(n)
    row, entering = int(q.argmin()), 2 * n
    for _ in range(50 * (n + 1)):
        T[row] /= T[row, entering]
        others = np.arange(n) != row
        T[others] -= np.outer(T[others, entering], T[row])
        leaving, basis[row] = basis[row], entering
        if leaving == 2 * n:
            positive = np.zeros(n, dtype=bool)
            positive[basis[basis >= n] - n] = True
            return positive
        entering = (leaving + n) % (2 * n)
        column = T[:, entering]
        rising = column > 1e-12 * np.abs(column).max()
        if not rising.any():
            return None
        ratio = np.where(rising, T[:, -1] / np.where(rising, column, 1.0), np.inf)
        ties = np.flatnonzero(ratio <= ratio.min() + 1e-14 * abs(ratio.min()))
        artificial = ties[basis[ties] == 2 * n]
        row = int(artificial[0] if len(artificial) else ties[0])
    return None
