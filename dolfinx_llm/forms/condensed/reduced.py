"""The reduced matrix of the condensed form, scaled to unit diagonal."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.operators.petsc import times


class ReducedMatrix:
    """S Tᵀ K T S with the proximal term as PETSc AIJ ``matrix``; the PETSc Vec S is the inverse
    square root of its diagonal, ``scale`` at idle places. T is destroyed with the matrix."""

    def __init__(self, form: Transformation, scale: float) -> None:
        self.form, self._comm = form, form.comm
        self.matrix = self.form.reduce(self.form.penalty(), scale)
        diagonal = self.matrix.getDiagonal()
        least = self._comm.allreduce(diagonal.array_r.min(initial=np.inf), op=MPI.MIN)
        if not least > 0.0:
            raise ContactError(
                f"the condensed matrix has the diagonal entry {least:.3g}: it is not positive "
                "definite. Check the material data of the forms a"
            )
        diagonal.sqrtabs()
        diagonal.reciprocal()
        self.S = diagonal
        self.matrix.diagonalScale(diagonal, diagonal)
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.matrix.setOption(PETSc.Mat.Option.SPD, True)

    def best_share(self, q: np.ndarray, load: np.ndarray) -> float:
        """The part of q next to the solution: loads may have grown in proportion."""
        product = times(self.matrix, q / self.S.array_r) / self.S.array_r
        work, energy = self._comm.allreduce(np.array([q @ load, q @ product]))
        return work / energy if energy > 0.0 else 0.0

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        for item in (self.form.T, self.matrix, self.S):
            item.destroy()
