"""Motions that cost hardly any energy, which conjugate gradients alone leave too early."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx_llm.operators.petsc import times

NOISE = 64.0 * np.finfo(float).eps  # of the largest value: what rounding can make of zero


class CoarseMotions:
    """Least energy over a few motions W: q + W (Wᵀ A W)⁻¹ Wᵀ r for what A leaves of a load, r.

    Where springs hold a body weakly, a residual that is small against the load may still move it
    far. One without a part along its rigid motions moves it no farther than what is held firmly.

    Args:
        matrix: symmetric positive definite, S A S.
        S: its scaling, a PETSc Vec.
        modes: (n_local, k) motions, as q.
    """

    def __init__(self, matrix: Any, S: Any, modes: np.ndarray) -> None:
        self._comm, k = matrix.comm.tompi4py(), modes.shape[1]
        W = modes / S.array_r[:, None]
        product = np.empty_like(W)
        for i in range(k):
            product[:, i] = times(matrix, W[:, i])
        size, energy = self._comm.allreduce(np.stack([W.T @ W, W.T @ product]))
        apart = _inverse_root(size)
        self._inverse = apart @ _inverse_root(apart.T @ energy @ apart)  # (k, at most k)

    def of(self, modes: np.ndarray, left: np.ndarray) -> np.ndarray:
        """(n_local,) q of least energy under a load r (n_local,) on it."""
        amounts = self._inverse @ (self._inverse.T @ self._comm.allreduce(modes.T @ left))
        return modes @ amounts


def _inverse_root(M: np.ndarray) -> np.ndarray:
    """X with Xᵀ M X = 1, without what M is zero on."""
    values, vectors = np.linalg.eigh(0.5 * (M + M.T))
    kept = values > NOISE * values.max(initial=0.0)
    return vectors[:, kept] / np.sqrt(values[kept])
