"""Newton's system: bodies, follower loads, and interfaces with unknowns of their own."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.log import log
from dolfinx_llm.base.parallel import gather_rows, told
from dolfinx_llm.finite.linear.condensed import CondensedSystem, tolerance
from dolfinx_llm.finite.linear.coupling import Coupling
from dolfinx_llm.finite.linear.multigrid import Multigrid
from dolfinx_llm.finite.linear.parts import Part, Parts
from dolfinx_llm.finite.pairs.terms import ContactTerms
from dolfinx_llm.forms.direct import DirectSolver
from dolfinx_llm.operators.petsc import (
    diagonal_of,
    is_symmetric,
    join_blocks,
    same_entries,
    times,
)

IN_VAIN = 3  # failures of GMRES in a row, after which it is not tried any more


@dataclass(eq=False)
class NewtonSystem(Parts):
    """Newton's system for changes of u and of the interfaces' own unknowns q.

        [K + sum of K_i   top] [du]   [-r   ]
        [left             own] [dq] = [-rest]

    Contact that may part makes it unsymmetric: averaged normals and designed rows have forces that
    are no gradient. Blocks of ties are symmetric. Entries that contact has once had stay stored, as
    zeros: while nodes slide within their facets the factorisation's analysis serves again.

    It is factorised, or solved by GMRES (see ``condensed``); where that fails, factorised as well.
    """

    options: tuple[str, dict[str, Any]] = ("", {})  # prefix, and PETSc options
    sides: Sequence[Any] = ()  # surfaces of each interface
    made: Sequence[csr_matrix | None] = ()  # what makes the coordinates of each: see ``Placed``
    iterates: bool = False  # whether GMRES is to solve it
    iterations: int = 0  # of GMRES, since they were asked for
    failures: int = 0  # of GMRES in a row
    solver: DirectSolver | None = None  # of the last iteration

    @cached_property
    def _grids(self) -> Multigrid:
        return Multigrid(self.dofs, self.options)

    def solve(
        self,
        K: PETSc.Mat,
        terms: Sequence[ContactTerms],
        followers: Sequence[Part],
        r: Array,
        u: Array,
        error: float,
        exact: bool,
    ) -> tuple[Array, Array]:
        """Changes of this rank's u and of all q; collective.

        Args:
            K: of the bodies, without conditions.
            terms: of the interfaces.
            followers: minus the derivatives of follower loads.
            r: (n_local,) residual; at prescribed dofs minus their change.
            u: (n_local,) where they are made.
            error: Newton's residual there, relative.
            exact: whether GMRES is to go as far as it can.

        Raises:
            ContactInputError: options that PETSc does not know, or refuses.
            ContactError: MUMPS could not factorise.
        """
        if self.iterates:
            tolerances = told(self.dofs.comm, tolerance(error, exact))  # all end together
            found = self._iterate(K, terms, followers, r, u, tolerances)
            if found is not None:
                return found
        K = K.copy()
        terms = [t.by_whole(made) for t, made in zip(terms, self.made, strict=True)]
        bodies = [Part(t.K, at, at) for t, at in zip(terms, self.numbers, strict=True)]
        self.add(K, [*bodies, *followers])
        fixed = np.flatnonzero(self.dofs.fixed)
        diagonal = mean_diagonal(K)  # for the rows of prescribed dofs
        K.zeroRows((self.dofs.first + fixed).astype(PETSc.IntType), diag=diagonal)
        b = -r
        b[fixed] *= diagonal
        return self._factorised(K, terms, b, [t.rest for t in terms])

    def _iterate(
        self,
        K: PETSc.Mat,
        terms: Sequence[ContactTerms],
        followers: Sequence[Part],
        r: Array,
        u: Array,
        tolerances: tuple[float, float],
    ) -> tuple[Array, Array] | None:
        """The same by GMRES; None where it does not get there."""
        dofs, d, grids = self.dofs, mean_diagonal(K), self._grids
        places = [*self.numbers, *(f.rows for f in followers)]
        loads, of = [f.matrix for f in followers], (terms, self.sides, places, self.made)
        coupling = Coupling(dofs, *of, loads, d, grids.fitted)
        pairs = [Part(C, n, n) for C, n in zip(coupling.stiffness, self.numbers, strict=True)]
        moved = np.where(dofs.fixed, -r, 0.0)
        pushed, left = coupling.prescribed(moved)
        forces = np.where(dofs.fixed, 0.0, -r - times(K, moved) - pushed)
        rest = np.concatenate([np.zeros(0), *(t.rest for t in terms)])
        s = -coupling.scaling @ rest - left
        system, found = CondensedSystem(dofs, self.own, grids, coupling, ended=coupling.wrong), None
        while found is None and not system.ended:
            try:
                grids.meet(K, pairs, d, u)
            except ContactInputError:
                raise
            except ContactError as error:
                system.ended = str(error)
                break
            found = system.solve(forces, s, tolerances)
            self.iterations += system.iterations
            if found is None and not grids.fresh:  # another tangent's may have misled it
                grids.discard()
                system.ended = ""
        self.failures = self.failures + 1 if found is None else 0
        if found is not None:
            return found[0] + moved, found[1]
        grids.discard()
        self.iterates = self.failures < IN_VAIN
        log.log(
            logging.WARNING if dofs.comm.rank == 0 else logging.DEBUG,
            f"GMRES + GAMG gave no answer ({system.ended}): Newton's system is factorised by "
            "MUMPS instead" + ("" if self.iterates else ", from now on"),
        )
        return None

    def _factorised(
        self, K: PETSc.Mat, terms: Sequence[ContactTerms], b: Array, rest: Sequence[Array]
    ) -> tuple[Array, Array]:
        """The solution by MUMPS for forces b (n_local,) and what the own equations leave."""
        if not terms:
            return self._solved([[K]], [b])[0], np.zeros(0)
        c = mean_diagonal(K, np.concatenate(self.numbers))  # or MUMPS takes pivots for none
        top, left, own = self.blocks(terms)
        top.scale(c)
        left.scale(c)
        own.scale(c * c)
        rests = c * np.concatenate(rest)[self.own.mine]
        du, dq = self._solved([[K, top], [left, own]], [b, -rests])
        return du, gather_rows(self.dofs.comm, c * dq)[self.own.number]

    def _solved(self, blocks: Sequence[Sequence[PETSc.Mat]], b: Sequence[Array]) -> list[Array]:
        matrix, places = join_blocks(blocks)
        for M in (M for row in blocks for M in row):
            M.destroy()
        rhs = np.zeros(matrix.getLocalSize()[0])
        for place, part in zip(places, b, strict=True):
            rhs[place] = part
        self._factorise(matrix)
        assert self.solver is not None
        x = self.solver.solve(rhs)
        return [x[place] for place in places]

    def _factorise(self, matrix: PETSc.Mat) -> None:
        """Factorise; the analysis of the last factorisation serves where it can."""
        old, self.solver = self.solver, None
        if old is not None:
            alike = is_symmetric(matrix) == old.symmetric and same_entries(matrix, old.matrix)
            if alike:
                matrix.copy(old.matrix, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
                matrix.destroy()
                try:
                    old.refactorise()
                except ContactError:
                    old.destroy()
                    raise
                self.solver = old
                return
            old.destroy()
        chosen = {} if self.failures else self.options[1]  # they were GMRES's
        # Newton's next iteration is the refinement.
        self.solver = DirectSolver(matrix, self.options[0], chosen, own=True, once=True)

    def taken(self) -> int:
        """Iterations of GMRES since this was asked last."""
        taken, self.iterations = self.iterations, 0
        return taken

    def destroy(self) -> None:
        """Free the factorisation, or multigrid; collective. The next solve makes it anew."""
        self._grids.discard()
        old, self.solver = self.solver, None
        if old is not None:
            old.destroy()


def mean_diagonal(K: PETSc.Mat, at: Array | None = None) -> float:
    """Mean size of K's diagonal entries, or of those of some rows (k,), the same on every rank
    [force / length]; collective."""
    return float(mean_diagonals(K, [np.arange(*K.getOwnershipRange()) if at is None else at])[0])


def mean_diagonals(K: PETSc.Mat, every: Sequence[Array]) -> Array:
    """(n,) the same of n sets of rows; collective."""
    own, (first, end) = np.abs(diagonal_of(K)), K.getOwnershipRange()
    parts = [own[at[(at >= first) & (at < end)] - first] for at in every]
    sums = np.array([(part.sum(), len(part)) for part in parts])
    total, count = K.comm.tompi4py().allreduce(sums).T
    return np.asarray(total / count)
