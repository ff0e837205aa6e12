"""The reduced matrix of the condensed form, scaled to unit diagonal."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import csc_matrix, hstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.forms.condensed.gmres import Product, Shell
from dolfinx_llm.forms.condensed.modes import ModesAsked
from dolfinx_llm.forms.condensed.splitting import to_unit_diagonal
from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.operators.petsc import diagonal_of, products, times

SEEN_FAINTLY = 0.1  # entries of rows below which they hold a frame unknown too softly for multigrid
GRAIN = 64.0 * np.finfo(float).eps  # of the largest value: what rounding can make of zero


class ReducedMatrix:
    """A = Tᵀ K T with the proximal term, as PETSc ``matrix`` S A S; the PETSc Vec S is the inverse
    square root of A's diagonal, which is ``scale`` at idle places. T goes with the matrix.

    It is AIJ, in which K's inside stands, or, ``beside`` another, that a preconditioner needs and
    that goes over to this one, known by its products alone: what both share is stored once.

    ``weak`` gives motions W that cost hardly any energy, which conjugate gradients alone leave too
    early, unless all is ``firm``; as of ``CondensedSystem``.

    Attributes:
        hardly_held: (k,) places of this rank's frame unknowns among its own, where small entries
            of rows alone see one that a proximal term holds; elsewhere None, on all ranks.
    """

    def __init__(
        self,
        form: Transformation,
        scale: float,
        weak: ModesAsked | None,
        firm: bool,
        beside: ReducedMatrix | None = None,
    ) -> None:
        self.form, self._comm, self._scale = form, form.comm, scale
        self._weak, self._firm = weak, firm
        self._inverse: Any = None  # X with X Xᵀ = (Wᵀ A W)⁻¹, once it is needed
        self.hardly_held = _hardly_held(form)
        self._corner: Any = None  # the last block of A, where it is known by products
        self._stored: Any = None  # what K's inside stands in, unless it has gone over
        if beside is None:
            self._store()
        else:
            self._know(beside)

    def _store(self) -> None:
        self.matrix, self.S = self.form.reduce(self.form.penalty(), self._scale)
        self._stored = self.matrix
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.matrix.setOption(PETSc.Mat.Option.SPD, True)

    def _know(self, beside: ReducedMatrix) -> None:
        form = self.form
        self._corner = form.corner(form.penalty(), self._scale)
        diagonal = beside.S.duplicate()
        inside, tail = form.split.inside_diagonal, diagonal_of(self._corner)
        diagonal.array_w[:] = np.concatenate([inside, tail])
        self.S = to_unit_diagonal(diagonal)
        size = self.S.array_r.copy()
        self._stored = beside.hand_over()
        self.matrix = PETSc.Mat().createPython(
            self._stored.getSizes(),
            Shell(lambda x: size * product(form, self._corner, size * x)),
            comm=self._stored.comm,
        )
        self.matrix.setUp()

    def store(self) -> None:
        """Be stored, if it is not; no preconditioner needs another matrix any more. Collective."""
        if self._corner is not None:
            self._free()
            self._store()

    def block(self, places: Any) -> Any:
        """(k, k) the matrix at this rank's places of the tail, AIJ."""
        matrix, before = self.matrix, 0
        if self._corner is not None:
            matrix, before = self._corner, len(self.form.fixed)
        numbers = matrix.getOwnershipRange()[0] + places - before
        rows = PETSc.IS().createGeneral(numbers.astype(PETSc.IntType), comm=matrix.comm)
        block = matrix.createSubMatrix(rows, rows)
        rows.destroy()
        if self._corner is not None:
            scaling = block.createVecRight()
            scaling.array_w[:] = self.S.array_r[places]
            block.diagonalScale(scaling, scaling)
            scaling.destroy()
        return block

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
            product = self._products(scaled)
            size, energy = comm.allreduce(np.stack([scaled.T @ scaled, scaled.T @ product]))
            apart = _inverse_root(size)
            self._inverse = apart @ _inverse_root(apart.T @ energy @ apart)
        part = self._inverse @ (self._inverse.T @ comm.allreduce(W.T @ left))
        q += W @ part
        if product is not None and self._firm:
            return left - product @ part / self.S.array_r
        return load - self.times(q)

    def _products(self, X: Array) -> Array:
        """(q_local, k) S A S X."""
        if self._corner is None:
            return products(self.matrix, X)
        return np.stack([times(self.matrix, x) for x in X.T], axis=1)

    def hand_over(self) -> Any:
        """What K's inside stands in, which goes with another from now on."""
        stored, self._stored = self._stored, None
        return stored

    def _free(self) -> None:
        if self._corner is not None:
            self.matrix.destroy()
            self._corner.destroy()
        if self._stored is not None:
            self.form.split.leave(self._stored)
            self._stored.destroy()
        self.S.destroy()
        self._corner = self._stored = None

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self._free()
        self.form.T.destroy()


def _hardly_held(form: Transformation) -> Array | None:
    if form.proximal is None:
        return None
    seen = np.zeros(form.moved.shape[1])
    np.maximum.at(seen, form.moved.indices, abs(form.moved.data))
    form.comm.Allreduce(MPI.IN_PLACE, seen, op=MPI.MAX)
    some = ((seen > 0.0) & (seen < SEEN_FAINTLY)).any()
    return len(form.fixed) + form.tail.seats if some else None


def product(form: Transformation, corner: Any, q: Array, test: Any = None) -> Array:
    """(q_local,) Tᵀ K T q of the matrix with this ``corner``; with ``test`` the T_S of its rows."""
    split, (body, tail) = form.split, np.split(q, [len(form.fixed)])
    above = times(split.K_SI, times(form.T, tail), transposed=True)
    left = times(form.T if test is None else test, times(split.K_SI, body), transposed=True)
    return np.concatenate([split.inside_times(body) + above, left + times(corner, tail)])


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
