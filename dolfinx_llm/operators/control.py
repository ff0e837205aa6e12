"""Second-order surfaces in control values of Bernstein form, in which bodies may part.

Nodal forces of a pressure may be zero or negative at second order, and nodal gaps say little of
what lies between. With control values u', u = E u', shape functions are Bernstein's, which are
never negative: forces E^T λ of a pressure are none either, wherever a facet is cut, and gaps
E^-1 gap that are not leave no point of a facet inside of the other body. K' = E^T K E then has a
row for each control value as K has for a node, so that laws and solvers see no difference.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.geometry.pairs import control_matrices
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.control import frame_control
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.operators.numbering import BodyDofs
from dolfinx_llm.operators.petsc import create_aij, times


class Control:
    """What makes control values of the dofs of surfaces; collective.

    Args:
        dofs: of all bodies.
        surfaces: (space, surface) of second order, each once.

    Raises:
        ContactInputError: a node in the middle of an edge is prescribed, and not its ends.
    """

    def __init__(self, dofs: BodyDofs, surfaces: Sequence[tuple[int, Surface]]) -> None:
        self.dofs = dofs
        numbers = [dofs.of(space, surface) for space, surface in surfaces]
        at = np.unique(np.concatenate([a.ravel() for a in numbers]))
        fixed = dofs.values(at, dofs.fixed.astype(float)) > 0.0
        both = [control_matrices(surface) for _, surface in surfaces]
        E, C = (
            [np.concatenate(a) for a in zip(*map(self._entries, numbers, side), strict=True)]
            for side in zip(*both, strict=True)
        )
        row, column, value = E
        held, known = dofs.fixed[row], fixed[np.searchsorted(at, column)]
        own = column == row + dofs.first
        self._check(held & ~known & ~own)
        # Prescribed values are put into the load: their columns are empty but for themselves.
        free = ~held & ~known
        stay = own & held
        kept = free | stay
        self.E, self.C = self._matrix(*E), self._matrix(*C)
        self.free = self._matrix(row[kept], column[kept], np.where(stay, 1.0, value)[kept])

    def _entries(self, numbers: Array, matrix: csr_matrix) -> tuple[Array, ...]:
        """This rank's rows, columns and values, of each direction, of a surface's matrix."""
        M = matrix.tocoo()
        row = numbers[M.row].ravel() - self.dofs.first
        mine = (row >= 0) & (row < len(self.dofs.fixed))
        value = np.repeat(M.data, self.dofs.components)
        return row[mine], numbers[M.col].ravel()[mine], value[mine]

    def _check(self, wrong: Array) -> None:
        count = self.dofs.comm.allreduce(int(wrong.sum()))
        if count:
            raise ContactInputError(
                f"{count} prescribed dof(s) of a second-order contact surface belong to nodes in "
                "the middle of edges or facets that are not prescribed as a whole: where bodies "
                "may part conditions must hold on whole edges (fem.locate_dofs_topological)"
            )

    def _matrix(self, row: Array, column: Array, value: Array) -> PETSc.Mat:
        """Given entries of this rank's rows, the others those of the identity."""
        n, sizes = len(self.dofs.fixed), self.dofs.sizes
        first = np.unique(row * sizes[1] + column, return_index=True)[1]  # an edge of two surfaces
        row, column, value = row[first], column[first], value[first]
        given = np.zeros(n, dtype=bool)
        given[row] = True
        rest = np.flatnonzero(~given)
        index = np.append(row, rest), np.append(column, self.dofs.first + rest)
        values = np.append(value, np.ones(len(rest)))
        return create_aij(self.dofs.comm, sizes, sizes, csr_matrix((values, index), (n, sizes[1])))

    def stiffness(self, K: PETSc.Mat) -> PETSc.Mat:
        """E^T K E, identity rows and columns at prescribed dofs; K is used up."""
        self.free.setBlockSizes(*K.getBlockSizes())
        out = K.ptap(self.free)
        K.destroy()
        return out

    def load(self, f: Array, stiffness: Callable[[], PETSc.Mat]) -> Array:
        """E^T f less what prescribed values do, and these as control values, of this rank's nodal
        load f (n_local,) with the values at prescribed dofs; the nodes' K is assembled where it is
        needed."""
        fixed = self.dofs.fixed
        known = np.where(fixed, times(self.C, np.where(fixed, f, 0.0)), 0.0)
        lift = np.where(fixed, 0.0, times(self.E, known))
        if self.dofs.comm.allreduce(int(lift.any())):
            K = stiffness()
            f = f - np.where(fixed, 0.0, times(K, lift))
            K.destroy()
        out = times(self.free, f, transposed=True)
        return np.where(fixed, known, out)

    def forces(self, f: Array) -> Array:
        """E^T f of this rank's nodal forces (n_local,)."""
        return times(self.E, f, transposed=True)

    def nodal(self, u: Array) -> Array:
        """E u' of this rank's control values (n_local,)."""
        return times(self.E, u)

    def values(self, u: Array) -> Array:
        """u' of this rank's nodal values (n_local,)."""
        return times(self.C, u)

    def nodal_forces(self, f: Array) -> Array:
        """Nodal forces whose E^T f (n_local,) is given."""
        return times(self.C, f, transposed=True)


def frame_places(geometry: InterfaceGeometry) -> Array:
    """(m, gdim) where the frame's unknowns are: its nodes, or their control points [length]."""
    frame, x = geometry.frame, geometry.places
    if frame is None or frame.element.order == 1 or geometry.interface.law.ties:
        return x
    return np.asarray(splu(frame_control(frame).tocsc()).solve(x))
