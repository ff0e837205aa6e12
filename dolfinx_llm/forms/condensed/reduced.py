"""The reduced matrix of the condensed form, scaled to unit diagonal."""

from collections.abc import Callable
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import csc_matrix, hstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.forms.condensed.gmres import Product
from dolfinx_llm.forms.condensed.modes import ModesAsked
from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.operators.petsc import products, times

GRAIN = 64.0 * np.finfo(float).eps  # of the largest value: what rounding can make of zero


class ReducedMatrix:
    """A = Tᵀ K T with the proximal term, as PETSc AIJ ``matrix`` S A S; the PETSc Vec S is the
    inverse square root of A's diagonal, which is ``scale`` at idle places. T goes with the matrix,
    in which K's inside stands.

    ``weak`` gives motions W that cost hardly any energy, which conjugate gradients alone leave too
    early, unless all is ``firm``; as of ``CondensedSystem``.
    """

    def __init__(
        self, form: Transformation, scale: float, weak: ModesAsked | None, firm: bool
    ) -> None:
        self.form, self._comm = form, form.comm
        self._weak, self._firm = weak, firm
        self._inverse: Any = None  # X with X Xᵀ = (Wᵀ A W)⁻¹, once it is needed
        self.matrix, self.S = self.form.reduce(self.form.penalty(), scale)
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.matrix.setOption(PETSc.Mat.Option.SPD, True)

    def times(self, q: Array) -> Array:
        """A q."""
        return times(self.matrix, q / self.S.array_r) / self.S.array_r

    def best_share(self, q: Array, load: Array) -> float:
        """The part of q next to the solution: loads may have grown in proportion."""
        work, energy = self._comm.allreduce(np.array([q @ load, q @ self.times(q)]))
        return work / energy if energy > 0.0 else 0.0

    def take(self, load: Array, q: Array, left: Array) -> Array:
        """What A leaves of a load after q, which has ``left`` r, has taken the best of W, the least
        energy over these motions: q + W (Wᵀ A W)⁻¹ Wᵀ r.

        Where springs hold a body weakly, a residual that is small against the load may still move
        it far. One without a part along its rigid motions moves it no farther than what is held
        firmly.
        """
        if self._weak is None:
            return left
        W, comm, product = self.form.unknowns(*self._weak()), self._comm, None
        if not W.shape[1]:
            return left
        if self._inverse is None:
            scaled = W / self.S.array_r[:, None]
            product = products(self.matrix, scaled)
            size, energy = comm.allreduce(np.stack([scaled.T @ scaled, scaled.T @ product]))
            apart = _inverse_root(size)
            self._inverse = apart @ _inverse_root(apart.T @ energy @ apart)
        part = self._inverse @ (self._inverse.T @ comm.allreduce(W.T @ left))
        q += W @ part
        if product is not None and self._firm:
            return left - product @ part / self.S.array_r
        return load - self.times(q)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.form.split.leave(self.matrix)
        for item in (self.form.T, self.matrix, self.S):
            item.destroy()


class WeakMotions:
    """Motions W that supports do not hold, of a matrix that need not be symmetric.

    Args:
        comm: MPI communicator.
        W: (n, k) this rank's part.
        times: A x.
        norm: of a residual, in which GMRES makes it small.
    """

    def __init__(
        self, comm: MPI.Comm, W: Array, times: Product, norm: Callable[[Array], float]
    ) -> None:
        self._comm, self._W, self._norm = comm, W, norm
        self._product = hstack([_grainless(times(column)) for column in W.T], format="csr")
        self._energy = comm.allreduce((self._product.T @ W).T)

    def take(self, q: Array, left: Array) -> Array:
        """What is left, once q has taken of W what that leaves no force along, where that gains:
        under a residual that is small against the load such motions would still go far."""
        force = self._comm.allreduce(self._W.T @ left)
        part = np.linalg.lstsq(self._energy, force, rcond=float(GRAIN))[0]
        after = left - self._product @ part
        if not self._norm(after) <= self._norm(left):
            return left
        q += self._W @ part
        return after


def _grainless(product: Array) -> csc_matrix:
    """(n, 1) forces of a motion, without rounding: there are none inside bodies."""
    least = GRAIN * np.abs(product).max(initial=0.0)
    return csc_matrix(np.where(np.abs(product) > least, product, 0.0)[:, None])


def _inverse_root(M: Array) -> Array:
    """X with Xᵀ M X = 1, without what M is zero on."""
    values, vectors = np.linalg.eigh(0.5 * (M + M.T))
    kept = values > GRAIN * values.max(initial=0.0)
    return vectors[:, kept] / np.sqrt(values[kept])
