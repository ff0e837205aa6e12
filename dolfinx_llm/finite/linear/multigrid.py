"""A preconditioner of bodies and of what pairs add to them, kept from iteration to iteration.

GAMG finds its aggregates and interpolations of the bodies alone, between which it sees nothing
then: each aggregate lies in one body, so that rigid motions are all that it is to represent, also
where bodies slide on each other. The same interpolations serve the bodies with their pairs, and
later tangents, of which nothing but products on known entries is left to be made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.finite.linear.coupling import Condensed
from dolfinx_llm.finite.linear.parts import Part, entries
from dolfinx_llm.forms.condensed.krylov import GAMG, WORN, near_null_space
from dolfinx_llm.forms.direct import set_up_ksp
from dolfinx_llm.geometry.cells import rigid_modes
from dolfinx_llm.operators.numbering import BodyDofs
from dolfinx_llm.operators.petsc import create_aij

OLDER = 3  # times as many entries of before as there are, up to which they stay
LEFT_OUT = 0.02  # part of the pairs' stiffness for which no entries are made anew
OURS = 0.0  # relative tolerance where the user gives none
GMRES = {
    "ksp_type": "gmres",
    "ksp_max_it": 150,
    "ksp_rtol": OURS,
    "pc_factor_mat_solver_type": "mumps",
    "pc_gamg_reuse_interpolation": True,
    # Errors of a V-cycle add up from level to level; coarse ones cost little.
    "pc_mg_cycle_type": "w",
    # Pairs make the largest eigenvalues, which smoothers are to know: not those of the bodies.
    "pc_gamg_use_sa_esteig": False,
}


@dataclass(eq=False)
class Multigrid:
    """GAMG, or what else the user's options ask for.

    Attributes:
        matrix: what it preconditions, at prescribed dofs a diagonal.
        ksp: PETSc's solver; None before ``meet``, and where it has been given up.
        fresh: whether it was made for the last matrix.
    """

    dofs: BodyDofs
    options: tuple[str, dict[str, Any]]  # prefix, and the user's
    matrix: Any = None
    ksp: Any = None
    fresh: bool = True
    usual: float = np.inf  # iterations per digit
    _entries: list[csr_matrix] = field(default_factory=list)  # of the pairs of each interface

    def fitted(self, pairs: Sequence[Condensed]) -> list[csr_matrix]:
        """Of each interface's stiffness what there are entries for; where that is too little, all,
        and entries are made anew: all that pairs may have where they are, stick or slip."""
        stiffness = [pair.C for pair in pairs]
        if self.ksp is not None:
            stored = zip(stiffness, self._entries, strict=True)
            parts = [C.multiply(there).tocsr() for C, there in stored]
            every, kept = (sum(abs(C).sum() for C in of) for of in (stiffness, parts))
            if every - kept <= LEFT_OUT * every:
                return parts
            self.discard()
        slides = bool(self._entries)
        older = self._entries or [csr_matrix(C.shape) for C in stiffness]
        self._entries = [
            (now + (before.nnz <= OLDER * now.nnz) * before).sign().tocsr()
            for now, before in zip([p.entries(slides) for p in pairs], older, strict=True)
        ]
        return stiffness

    def meet(self, K: PETSc.Mat, pairs: Sequence[Part], d: float, u: Array) -> None:
        """Take over another tangent.

        Args:
            K: of the bodies, without conditions.
            pairs: stiffness of each interface's pairs, as of ``fitted``.
            d: for the rows of prescribed dofs [force / length].
            u: (n_local,) where the bodies are.

        Raises:
            ContactInputError: options that PETSc does not know, or refuses.
            ContactError: PETSc cannot set it up.
        """
        self.fresh = self.ksp is None
        if self.ksp is None:
            stored = [replace(p, matrix=0.0 * e) for p, e in zip(pairs, self._entries, strict=True)]
            self.matrix = K.copy()
            self._add(stored, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
            self._hold(d)
            self.matrix.setBlockSize(self.dofs.gdim)
            self._know(u)
            prefix, given = self.options
            self.ksp = set_up_ksp(self.matrix, prefix, GMRES | GAMG | given, given)
        self.matrix.zeroEntries()
        K.copy(self.matrix, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        self._add(pairs, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        self._hold(d)
        self.ksp.setOperators(self.matrix)
        self.ksp.setUp()

    def _add(self, parts: Sequence[Part], structure: Any) -> None:
        dofs, sizes = self.dofs, self.dofs.sizes
        row, col, value = entries(parts, dofs.first, sizes[0])
        local = csr_matrix((value, (row, col)), sizes)
        added = create_aij(dofs.comm, sizes, sizes, local)
        self.matrix.axpy(1.0, added, structure=structure)
        added.destroy()

    def _hold(self, d: float) -> None:
        fixed = self.dofs.first + np.flatnonzero(self.dofs.fixed)
        self.matrix.zeroRowsColumns(fixed.astype(PETSc.IntType), diag=d)

    def _know(self, u: Array) -> None:
        """Tell it the rigid motions about where bodies are."""
        comm, x = self.dofs.comm, self.dofs.points + u.reshape(-1, self.dofs.gdim)
        low = np.min(comm.allgather(x.min(axis=0, initial=np.inf)), axis=0)
        high = np.max(comm.allgather(x.max(axis=0, initial=-np.inf)), axis=0)
        modes = rigid_modes((x - 0.5 * (low + high)) / np.linalg.norm(high - low))
        one = self.matrix.createVecLeft()
        one.set(1.0)
        free = np.where(self.dofs.fixed[:, None], 0.0, modes.reshape(len(u), modes.shape[2]))
        near_null_space(self.matrix, one, free)
        one.destroy()

    def count(self, took: int, rtol: float) -> None:
        """Take down iterations of a solve to a relative residual; one that is worn is given up."""
        rate = took / -np.log10(rtol)
        if self.fresh:
            self.usual = rate if took else np.inf
        elif rate > WORN * self.usual:
            self.discard()

    def discard(self) -> None:
        """Give it up; collective."""
        for item in (self.ksp, self.matrix):
            if item is not None:
                item.destroy()
        self.ksp = self.matrix = None
