"""K in two parts: what elimination at the surface leaves as it is, and the rows that it changes.

Tᵀ K T is K but for the rows and columns of the eliminated nodes, so that only these are multiplied.
With S their dofs, I the others and u_S = T_S q_S,

    Tᵀ K T = [ K_II       K_IS T_S     ]
             [ T_Sᵀ K_SI  T_Sᵀ K_SS T_S ].

K_II is most of K, and of any such matrix: what is solved with keeps it for both.
"""

from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.operators.petsc import create_aij, is_symmetric, join_blocks, times


class SplitStiffness:
    """K, parted at the dofs of surface nodes, numbers of whole nodes. It is taken over: its storage
    becomes ``inside``.

    Args:
        K: stiffness.
        dofs: numbers of those of surface nodes, of all ranks.
        diagonal: (n_local,) of K.

    Attributes:
        surface: this rank's of these dofs, local numbers.
        diagonal: (n_local,) of K.
        K_SS, K_SI: rows S of K, the latter with the columns of all dofs, and none in those of S.

    Raises:
        ContactError: K is not symmetric.
    """

    def __init__(self, K: Any, dofs: Array, diagonal: Array) -> None:
        if not is_symmetric(K, diagonal):
            raise ContactError(
                "the condensed form needs a symmetric stiffness, K has none: use solver='saddle'"
            )
        self.comm, self.sizes = K.comm.tompi4py(), K.getSizes()[0]
        self._inside: Any = K  # unless it stands in ``_home``
        self._home: Any = None  # matrix of ``scaled``, and (n_local,) its scaling
        self.first, end = K.getOwnershipRange()
        dofs = np.unique(dofs)
        mine = dofs[(dofs >= self.first) & (dofs < end)].astype(PETSc.IntType)
        self.surface = mine - self.first
        self.diagonal = diagonal
        self._held = np.zeros(0, dtype=np.int64), np.zeros(0)  # dofs inside, diagonal with springs
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
        starts = np.append(0, np.cumsum(kept))[indptr]
        shape = len(self.surface), self.sizes[1]
        local = csr_matrix((values[kept], columns[kept], starts), shape=shape)
        return create_aij(rows.comm, rows.getSizes()[0], self.sizes, local)

    def corner(self, T: Any, D: Any, test: Any = None) -> Any:
        """The last block of Tᵀ K T, with D, which has a stored diagonal, added to it, None:
        nothing; with ``test`` the T_S of its rows."""
        test_t, K_T = _transposed(T if test is None else test), self.K_SS.matMult(T)
        corner = test_t.matMult(K_T)
        if D is not None:
            corner.axpy(1.0, D, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        for M in (test_t, K_T):
            M.destroy()
        return corner

    def beside(self, T: Any, test: Any = None) -> tuple[Any, Any]:
        """The blocks of Tᵀ K T above the last one and on its left; with ``test`` the T_S of its
        rows."""
        test_t = _transposed(T if test is None else test)
        left = test_t.matMult(self.K_SI)
        test_t.destroy()
        if test is None:
            return _transposed(left), left
        # Turning what has all columns of the bodies, each time, is dear on several ranks.
        if self._K_IS is None:
            self._K_IS = _transposed(self.K_SI)
        return self._K_IS.matMult(T), left

    @property
    def inside_diagonal(self) -> Array:
        """(n_local,) of ``inside``."""
        values, (held, of) = self.diagonal.copy(), self._held
        values[self.surface] = 1.0
        values[held] = of
        return values

    @property
    def inside(self) -> Any:
        """K with zeros in the rows and columns of S, and ones on their diagonal; taken back from
        where it stands."""
        if self._home is not None:
            self._inside, self._home = self.inside_rows(), None
        return self._inside

    def inside_rows(self, at: Array | None = None) -> Any:
        """Some of this rank's rows of ``inside``, local numbers, or all; a copy."""
        home, scaling = self._home or (self._inside, None)
        first, n = home.getOwnershipRange()[0], self.sizes[0]
        columns = PETSc.IS().createStride(n, first, 1, home.comm)
        rows = columns
        if at is not None:
            rows = PETSc.IS().createGeneral((at + first).astype(PETSc.IntType), home.comm)
        found = home.createSubMatrix(rows, columns)
        if scaling is not None:
            right, left = found.createVecs()
            left.array_w[:] = 1.0 / (scaling if at is None else scaling[at])
            right.array_w[:] = 1.0 / scaling
            found.diagonalScale(left, right)
            left.destroy()
            right.destroy()
        rows.destroy()
        columns.destroy()
        return found

    def joined(self, blocks: tuple[Any, Any, Any]) -> Any:
        """The matrix of these blocks, those of ``beside`` and the corner, which are used up."""
        above, left, corner = blocks
        matrix, _ = join_blocks([[self.inside, above], [left, corner]])
        for M in blocks:
            M.destroy()
        return matrix

    def scaled(self, blocks: tuple[Any, Any, Any]) -> tuple[Any, Any]:
        """The same as S A S of unit diagonal, and S. ``inside`` stands there from now on, until
        ``leave``; whatever is taken out of it has the rounding of that.

        Raises:
            ContactError: the diagonal is not positive.
        """
        matrix = self.joined(blocks)
        S = to_unit_diagonal(matrix.getDiagonal())
        matrix.diagonalScale(S, S)
        self._inside.destroy()
        self._home = matrix, S.array_r[: self.sizes[0]].copy()
        return matrix, S

    def leave(self, matrix: Any) -> None:
        """Let ``inside`` no longer stand in a matrix, which is about to go."""
        if self._home is not None and self._home[0] is matrix:
            _ = self.inside

    def columns(self, u_S: Array) -> Array:
        """(n_local,) K u for a u that is zero but on S."""
        product = times(self.K_SI, u_S, transposed=True)
        product[self.surface] = times(self.K_SS, u_S)
        return product

    def rows(self, u: Array) -> Array:
        """(S,) rows S of K u."""
        return times(self.K_SI, u) + times(self.K_SS, u[self.surface])

    def inside_times(self, u: Array) -> Array:
        """(n_local,) ``inside`` times u, wherever it stands."""
        if self._home is None:
            return times(self._inside, u)
        matrix, scaling = self._home
        x = np.zeros(matrix.getLocalSize()[0])
        x[: len(u)] = u / scaling
        return times(matrix, x)[: len(u)] / scaling

    def times(self, u: Array) -> Array:
        """(n_local,) K u."""
        product = self.inside_times(u)
        product[self.surface] = times(self.K_SI, u)
        return product + self.columns(u[self.surface])

    def hold(self, at: list[int], stiffness: float) -> None:
        """Springs at this rank's dofs, local numbers, instead of those there were."""
        if not self.comm.allreduce(len(at) + len(self._held[0])):
            return
        held = np.array(at, dtype=np.int64)
        of, on_surface = self.diagonal[held] + stiffness, np.isin(held, self.surface)
        start = self.K_SS.getOwnershipRange()[0]
        for i, value in zip(held[on_surface], of[on_surface], strict=True):
            row = start + np.searchsorted(self.surface, i)
            self.K_SS.setValue(row, row, value)
        self.K_SS.assemble()
        held, of = held[~on_surface], of[~on_surface]
        changed = bool((self.inside_diagonal[held] != of).any())
        if not self.comm.allreduce(changed, op=MPI.LOR):
            return  # where it stands others may have been made of it
        self._held, inside = (held, of), self.inside
        for i, value in zip(held, of, strict=True):
            inside.setValue(self.first + i, self.first + i, value)
        inside.assemble()

    def destroy(self) -> None:
        self._home = None
        for M in (self._inside, self.K_SS, self.K_SI, self._K_IS):
            if M is not None:
                M.destroy()


def to_unit_diagonal(diagonal: Any) -> Any:
    """What scales a matrix of this diagonal, a PETSc Vec that is used up, on both sides.

    Raises:
        ContactError: the diagonal is not positive.
    """
    least = diagonal.min()[1]
    if not least > 0.0:
        raise ContactError(
            f"the condensed matrix has the diagonal entry {least:.3g}: it is not positive "
            "definite. Check the material data of the forms a"
        )
    diagonal.sqrtabs()
    diagonal.reciprocal()
    return diagonal


def _transposed(M: Any) -> Any:
    turned = M.copy()
    turned.transpose()
    return turned
