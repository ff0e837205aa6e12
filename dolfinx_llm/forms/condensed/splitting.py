"""K in two parts: what elimination at the surface leaves as it is, and the rows that it changes.

Tᵀ K T is K but for the rows and columns of the eliminated nodes, so that only these are multiplied.
With S their dofs, I the others and u_S = T_S q_S,

    Tᵀ K T = [ K_II       K_IS T_S     ]
             [ T_Sᵀ K_SI  T_Sᵀ K_SS T_S ].
"""

from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.operators.petsc import create_aij, diagonal_of, is_symmetric, join_blocks, times


class SplitStiffness:
    """K, parted at the dofs of surface nodes, numbers of whole nodes. It is taken over: its storage
    becomes ``inside``.

    Attributes:
        surface: this rank's of these dofs, local numbers.
        diagonal: (n_local,) of K.
        inside: K with zeros in the rows and columns of S, and ones on their diagonal.
        K_SS, K_SI: rows S of K, the latter with the columns of all dofs, and none in those of S.

    Raises:
        ContactError: K is not symmetric.
    """

    def __init__(self, K: Any, dofs: Array) -> None:
        if not is_symmetric(K):
            raise ContactError(
                "the condensed form needs a symmetric stiffness, K has none: use solver='saddle'"
            )
        self.comm, self.inside, self.sizes = K.comm.tompi4py(), K, K.getSizes()[0]
        self.first, end = K.getOwnershipRange()
        dofs = np.unique(dofs)
        mine = dofs[(dofs >= self.first) & (dofs < end)].astype(PETSc.IntType)
        self.surface = mine - self.first
        self.diagonal = diagonal_of(K)
        S = PETSc.IS().createGeneral(mine, K.comm)
        all_dofs = PETSc.IS().createStride(end - self.first, self.first, 1, K.comm)
        self.K_SS, rows = K.createSubMatrix(S, S), K.createSubMatrix(S, all_dofs)
        self.K_SI = self._without_columns(rows, dofs)
        for item in (S, all_dofs, rows):
            item.destroy()
        K.zeroRowsColumns(mine, 1.0)
        self._K_IS: Any = None  # K_SI turned, once it is needed

    def _without_columns(self, rows: Any, dofs: Array) -> Any:
        indptr, columns, values = rows.getValuesCSR()
        kept = ~np.isin(columns, dofs)
        row = np.repeat(np.arange(len(self.surface)), np.diff(indptr))[kept]
        shape = len(self.surface), self.sizes[1]
        local = csr_matrix((values[kept], (row, columns[kept])), shape=shape)
        return create_aij(rows.comm, rows.getSizes()[0], self.sizes, local)

    def blocks(self, T: Any, D: Any, test: Any = None) -> tuple[Any, Any, Any]:
        """Of Tᵀ K T with D, which has a stored diagonal, added to its last block, all but
        ``inside``: above on the right, below, and the last; with ``test`` the T_S of its rows."""
        test_t = _transposed(T if test is None else test)
        K_T = self.K_SS.matMult(T)
        corner = test_t.matMult(K_T)
        corner.axpy(1.0, D, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        below = test_t.matMult(self.K_SI)
        if test is None:
            right = _transposed(below)
        else:  # turning what has all columns of the bodies, each time, is dear on several ranks
            if self._K_IS is None:
                self._K_IS = _transposed(self.K_SI)
            right = self._K_IS.matMult(T)
        for M in (test_t, K_T):
            M.destroy()
        return right, below, corner

    def joined(self, blocks: tuple[Any, Any, Any]) -> Any:
        """The matrix of these blocks, which are used up."""
        right, below, corner = blocks
        matrix, _ = join_blocks([[self.inside, right], [below, corner]])
        for M in blocks:
            M.destroy()
        return matrix

    def columns(self, u_S: Array) -> Array:
        """(n_local,) K u for a u that is zero but on S."""
        product = times(self.K_SI, u_S, transposed=True)
        product[self.surface] = times(self.K_SS, u_S)
        return product

    def rows(self, u: Array) -> Array:
        """(S,) rows S of K u."""
        return times(self.K_SI, u) + times(self.K_SS, u[self.surface])

    def times(self, u: Array) -> Array:
        """(n_local,) K u."""
        product = times(self.inside, u)
        product[self.surface] = times(self.K_SI, u)
        return product + self.columns(u[self.surface])

    def hold(self, at: list[int], stiffness: float) -> None:
        """Springs at this rank's dofs, local numbers, instead of those there were."""
        start = self.K_SS.getOwnershipRange()[0]
        for i in at:
            place = np.searchsorted(self.surface, i)
            on_surface = place < len(self.surface) and self.surface[place] == i
            M, row = (self.K_SS, start + place) if on_surface else (self.inside, self.first + i)
            M.setValue(row, row, self.diagonal[i] + stiffness)
        self.K_SS.assemble()
        self.inside.assemble()

    def release(self) -> None:
        """Free the volume's part: no more ``reduce`` and ``times``."""
        self.inside.destroy()

    def destroy(self) -> None:
        for M in (self.inside, self.K_SS, self.K_SI, self._K_IS):
            if M is not None:
                M.destroy()


def _transposed(M: Any) -> Any:
    turned = M.copy()
    turned.transpose()
    return turned
