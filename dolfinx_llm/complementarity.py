"""Linear complementarity: λ >= 0, s = M λ + q >= 0, λ s = 0. Plain NumPy."""

from __future__ import annotations

import numpy as np

BLOCKS = 10  # exchanges of whole blocks without progress before single ones


def complementarity(M: np.ndarray, q: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Which λ are positive, by block principal pivoting.

    All wrong signs are exchanged at once; where their number does not fall for a while, only the
    last one is (Murty), which ends for every matrix with positive principal minors. Júdice and
    Pires, Computers & Operations Research 21 (1994) 587-596.

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
        else:
            wrong = wrong[-1:]
        basis[wrong] ^= True
    return best_basis
