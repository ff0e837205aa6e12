"""The dofs of a form's function space, as the method numbers them.

Of a mixed space, as Taylor and Hood's (u, p), one block is the displacement. Its dofs come first,
node by node; the others follow, in units in which their rows of the stiffness are forces and what
they couple with displacements is of the stiffness' size. The method sees them as dofs that no
interface touches.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.spaces import check_space, displacement_block, is_mixed
from dolfinx_llm.operators.petsc import diagonal_of


class Blocks:
    """Function space W of a form and its displacement's V, which is W where that is not mixed.

    Collective.

    Args:
        W: of the form.
        scalar: whether V may be that of a temperature.

    Attributes:
        W, V: the spaces.
        mixed: whether W has other blocks.
        scale: (n_local,) unit of each dof of this rank; powers of 2, 1 for displacements.

    Raises:
        ContactInputError: W is no space that bodies may have.
    """

    def __init__(self, W: Any, scalar: bool = True) -> None:
        self.W, self.V, self.mixed = W, W, bool(is_mixed(W))
        n = W.dofmap.index_map.size_local * W.dofmap.index_map_bs
        self._order = np.arange(n)  # of W's dofs
        self._known = False
        if self.mixed:
            self.V, dofs = displacement_block(W)
            own = dofs[: self.V.dofmap.index_map.size_local * self.V.dofmap.index_map_bs]
            self._order = np.append(own, np.setdiff1d(self._order, own))
        check_space(self.V, highest=2, scalar=scalar)
        nodes = self.V.dofmap.index_map.size_local * self.V.dofmap.index_map_bs
        self.others = n - nodes  # dofs of this rank that are no displacements
        self.scale = np.ones(n)

    def ours(self, values: Array) -> Array:
        """(n_local,) of dofs in W's order, in that of the method."""
        return values[self._order]

    def matrix(self, K: PETSc.Mat, fixed: Array) -> PETSc.Mat:
        """K of W, which is used up, in the method's order and units; (n_local,) of its dofs are
        fixed, with identity rows and columns."""
        if not self.mixed:
            return K
        start = K.getOwnershipRange()[0]
        index = PETSc.IS().createGeneral((start + self._order).astype(PETSc.IntType), comm=K.comm)
        out = K.createSubMatrix(index, index)
        K.destroy()
        if not self._known:
            self.scale, self._known = self._units(out), True
        d = out.createVecLeft()
        d.array_w[:] = np.where(fixed, 1.0, self.scale)
        out.diagonalScale(d, d)
        for item in (index, d):
            item.destroy()
        return out

    def _units(self, K: PETSc.Mat) -> Array:
        """Units by which the largest entry that couples a dof with displacements is of the size of
        these' mean stiffness; 1 where nothing couples."""
        (start, end), comm = K.getOwnershipRange(), K.comm
        nodes = end - start - self.others
        parts = [
            PETSc.IS().createStride(count, first, 1, comm=comm)
            for count, first in ((self.others, start + nodes), (nodes, start))
        ]
        G = K.createSubMatrix(*parts)
        largest = np.zeros(self.others)
        indptr, _, entries = G.getValuesCSR()
        filled = np.flatnonzero(np.diff(indptr))
        if len(filled):
            largest[filled] = np.maximum.reduceat(np.abs(entries), indptr[filled])
        own = np.abs(diagonal_of(K)[:nodes])
        total = comm.tompi4py().allreduce(np.array([own.sum(), float(nodes)]))
        unit = np.ones(end - start)
        coupled = nodes + np.flatnonzero(largest)
        unit[coupled] = total[0] / total[1] / largest[coupled - nodes]
        for item in (G, *parts):
            item.destroy()
        return np.exp2(np.round(np.log2(unit)))

    def load(self, f: Array, fixed: Array) -> Array:
        """The load in W's order, with values at fixed dofs, in the method's order and units."""
        f = self.ours(f)
        return np.where(fixed, f / self.scale, f * self.scale)

    def nodal(self, load: fem.Function) -> Array:
        """(n_local,) nodal forces in W's order, of a Function of W or of V."""
        n = len(self._order)
        if not self.mixed or load.function_space.dofmap.index_map_bs == 1:
            return load.x.array[:n]
        out = np.zeros(n)
        own = self._order[: n - self.others]
        out[own] = load.x.array[: len(own)]
        return out

    def values(self, function: fem.Function) -> Array:
        """(n_local,) of a Function of W, as ``fill`` takes them."""
        return self.ours(function.x.array[: len(self._order)]) / self.scale

    def displacement(self, function: fem.Function) -> fem.Function:
        """Of a Function of W; collective."""
        if not self.mixed:
            return function
        out, n = fem.Function(self.V), len(self._order) - self.others
        out.x.array[:n] = function.x.array[self._order[:n]]
        out.x.scatter_forward()
        return out

    def fill(self, function: fem.Function, values: Array) -> None:
        """Write values (n_local,) of the method's dofs into a Function of W; collective."""
        function.x.array[self._order] = values * self.scale
        function.x.scatter_forward()
