"""Motions that cost hardly any energy, which conjugate gradients alone leave too early."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.operators.petsc import times

GRAIN = 64.0 * np.finfo(float).eps  # of the largest value: what rounding can make of zero


class CoarseMotions:
    """Least energy over a few motions W: q + W (Wᵀ A W)⁻¹ Wᵀ r for what A leaves of a load, r; the
    matrix is S A S. W as ``weak`` of ``CondensedSystem``.

    Where springs hold a body weakly, a residual that is small against the load may still move it
    far. One without a part along its rigid motions moves it no farther than what is held firmly.
    """

    def __init__(self, form: Transformation, matrix: Any, S: Any, motions: Any) -> None:
        self._form, self._matrix, self._S = form, matrix, S
        self._motions = motions if motions is not None and motions[0].shape[1] else None
        self._inverse: Any = None  # X with X Xᵀ = (Wᵀ A W)⁻¹, once it is needed

    def left(self, load: np.ndarray, q: np.ndarray) -> np.ndarray:
        """What A leaves of a load (n_local,), after q has taken the best of W."""
        left = load - self._times(q)
        if self._motions is None:
            return left
        W, comm = self._form.unknowns(*self._motions), self._form.comm
        if self._inverse is None:
            product = np.column_stack([self._times(column) for column in W.T])
            scaled = W / self._S.array_r[:, None]
            size, energy = comm.allreduce(np.stack([scaled.T @ scaled, W.T @ product]))
            apart = _inverse_root(size)
            self._inverse = apart @ _inverse_root(apart.T @ energy @ apart)
        q += W @ (self._inverse @ (self._inverse.T @ comm.allreduce(W.T @ left)))
        return load - self._times(q)

    def _times(self, q: np.ndarray) -> np.ndarray:
        return times(self._matrix, q / self._S.array_r) / self._S.array_r


def _inverse_root(M: np.ndarray) -> np.ndarray:
    """X with Xᵀ M X = 1, without what M is zero on."""
    values, vectors = np.linalg.eigh(0.5 * (M + M.T))
    kept = values > GRAIN * values.max(initial=0.0)
    return vectors[:, kept] / np.sqrt(values[kept])
