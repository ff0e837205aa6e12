"""Linear complementarity: λ >= 0, s = M λ + q >= 0, λ s = 0. Plain NumPy."""

from __future__ import annotations

import numpy as np

BLOCKS = 10  # exchanges of whole blocks without progress before single ones


def complementarity(M: np.ndarray, q: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Which λ are positive, by block principal pivoting.

    All wrong signs are exchanged at once. Where their number does not fall for a while and M is
    symmetric (no friction), descent takes over, which ends. Otherwise only the last wrong sign is
    exchanged (Murty), which ends for every matrix with positive principal minors, if late. Júdice
    and Pires, Computers & Operations Research 21 (1994) 587-596.

    Args:
        M: (n, n) matrix with positive principal minors, as that of a convex problem.
        q: (n,).
        start: (n,) a guess of the result.

    Returns:
        (n,) whether λ is in the basis; with friction M may lack the property, and the basis with
        the fewest wrong signs is given where none has been found without.

    Raises:
        numpy.linalg.LinAlgError: M is singular on a set of λ.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diagonal(M)), 1e-300))
    M, q = M * scale[:, None] * scale, q * scale
    basis, best_basis, best, left = start.copy(), start, len(q) + 1, BLOCKS
    tolerance = 1e-13 * np.abs(q).max(initial=0.0)
    for _ in range(50 + 3 * len(q)):
        value = np.zeros(len(q))
        on = np.flatnonzero(basis)
        x = np.linalg.solve(M[np.ix_(on, on)], -q[on])
        value[on] = x
        off = ~basis
        value[off] = M[np.ix_(off, basis)] @ x + q[off]
        wrong = np.flatnonzero(value < -tolerance)
        if not len(wrong):
            return basis
        if len(wrong) < best:
            best, left, best_basis = len(wrong), BLOCKS, basis.copy()
        elif left:
            left -= 1
        elif np.abs(M - M.T).max() <= 1e-12 * np.abs(M).max():
            return _descent(M, q, best_basis, tolerance)
        else:
            wrong = wrong[-1:]
        basis[wrong] ^= True
    return best_basis


def _descent(M: np.ndarray, q: np.ndarray, basis: np.ndarray, tolerance: float) -> np.ndarray:
    """Least λᵀMλ / 2 + qᵀλ over λ >= 0, M positive definite: the set where λ > 0.

    The active set method of Lawson and Hanson: λ stays feasible and the energy falls, so that no
    set comes back. Rows that pull join several at a time as long as that moves λ.
    """
    x, basis = np.zeros(len(q)), basis.copy()
    on = np.flatnonzero(basis)
    x[on] = np.maximum(np.linalg.solve(M[np.ix_(on, on)], -q[on]), 0.0)
    basis = x > 0.0
    for _ in range(50 + 3 * len(q)):
        before = x
        x, basis = _descend(M, q, x, basis)
        slope = np.where(basis, 0.0, M @ x + q)
        if not slope.min() < -tolerance:
            break
        moved = np.abs(x - before).max() > 1e-14 * np.abs(x).max()
        basis = basis | (slope <= (0.1 if moved else 1.0) * slope.min())
    return basis


def _descend(M, q, x, basis):
    """From x to the least energy over its basis, or as many faces of x >= 0 as are in the way."""
    x, basis = x.copy(), basis.copy()
    while basis.any():
        on = np.flatnonzero(basis)
        target = np.linalg.solve(M[np.ix_(on, on)], -q[on])
        down = target <= 0.0
        if not down.any():
            x[on] = target
            break
        ratio = np.full(len(on), np.inf)
        ratio[down] = x[on[down]] / (x[on[down]] - target[down])
        step = ratio.min()
        leaves = ratio <= step * (1.0 + 1e-12)
        x[on] = np.where(leaves, 0.0, x[on] + step * (target - x[on]))
        basis[on[leaves]] = False
    return x, basis
