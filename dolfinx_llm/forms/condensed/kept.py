"""A multigrid preconditioner of one step with friction that serves others as well.

It is GAMG of the symmetric part of the step it was made for. Where another step differs (nodes
that have come to stick, slip, open or close since) a factorisation of that step's own matrix on
these places alone corrects it, before and after.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix, diags

from dolfinx_llm.forms.condensed.elimination import EliminatedRows
from dolfinx_llm.forms.condensed.krylov import GAMG, near_null_space
from dolfinx_llm.forms.condensed.splitting import SplitStiffness
from dolfinx_llm.forms.condensed.symmetric import Reduced
from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.forms.direct import set_up_ksp
from dolfinx_llm.operators.petsc import create_aij, join_blocks, times

STIFFER = 0.5  # of what bodies set against a jump: by so much a law's stiffness has not changed


class KeptMultigrid:
    """GAMG of the symmetric part of a step's matrix, for vectors of the places that ``whole`` of
    ``Transformation`` gives.

    Args:
        split: stiffness of the bodies.
        rows: what is in contact; their L is replaced.
        reduced: the step.
        fixed: (n_local,) prescribed dofs.
        scale: stiffness of the surfaces [force / length].
        modes: near-null space at this rank's dofs (n_local, k) and the unknowns w (m, k).
        options: prefix and PETSc options.
    """

    def __init__(
        self,
        split: SplitStiffness,
        rows: EliminatedRows,
        reduced: Reduced,
        fixed: np.ndarray,
        scale: float,
        modes: tuple[np.ndarray, np.ndarray],
        options: tuple[str, dict],
    ) -> None:
        self._split, self._reduced, self._active = split, reduced, _states(rows)
        on = reduced.L_parted[reduced.on]
        everywhere = np.ones(on.shape[1])
        form = Transformation(split, replace(rows, L=on), fixed, everywhere, whole=True)
        self._dependent = form.frame.dependent
        Z, parts = form.frame.Z, reduced.parts
        idle = np.zeros(on.shape[1])
        idle[self._dependent] = scale
        D = Z.T @ (parts.T @ reduced.stiff @ parts) @ Z + diags(idle)
        self.matrix = form.reduce(D.tocsr(), scale)
        self._S = self.matrix.getDiagonal()
        self._S.sqrtabs()
        self._S.reciprocal()
        self.matrix.diagonalScale(self._S, self._S)
        for option in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.SPD):
            self.matrix.setOption(option, True)
        w = np.where(reduced.told[:, None], 0.0, modes[1])
        near_null_space(self.matrix, self._S, form.unknowns(modes[0], reduced.parted @ w))
        chosen = {"ksp_type": "gmres"} | GAMG | options[1]
        self.ksp = set_up_ksp(self.matrix, options[0], chosen, options[1])
        self._x, self._y = self.matrix.createVecs()
        indptr, columns, values = form.T.getValuesCSR()
        self._T = csr_matrix((values, columns, indptr), (len(indptr) - 1, form.tail.sizes[1]))
        self._w = (reduced.C @ parts @ Z).tocsr()
        form.T.destroy()
        self._P: Any = None
        self._factor: Any = None

    def meet(self, form: Transformation, rows: EliminatedRows, reduced: Reduced) -> None:
        """Take over another step, but for its matrix."""
        self.release()
        tail, self._n = form.tail, len(form.fixed)
        w, dofs = self._changes(form, rows, reduced)
        at = self._split.surface + self._split.first
        places = tail.left[np.isin(at, dofs)]
        mine = np.concatenate([places, tail.seats[w[tail.mine_used]]])
        self._at = np.unique(mine)
        self.changed = form.comm.allreduce(len(self._at))

    def fit(self, form: Transformation, reduced: Reduced, A: Any) -> None:
        """Take over the matrix of the step that was met, of blocks A of ``Transformation.blocks``,
        and factorise it where it differs."""
        self._A, tail = A, form.tail
        kept = ~reduced.told
        kept[form.frame.dependent] = False
        surface = (form.nodes.T @ self._T).tocoo()
        frame = (diags(kept.astype(float)) @ self._w)[tail.mine_used].tocoo()
        row = np.concatenate([tail.left[surface.row], tail.seats[frame.row]])
        col = np.concatenate([surface.col, tail.columns[frame.col]])
        value = np.concatenate([surface.data, frame.data])
        local = csr_matrix((value, (row, col)), shape=tail.sizes)
        self._P = create_aij(form.comm, tail.sizes, tail.sizes, local)
        if self.changed:
            matrix = self._around(form, A)
            options = {"ksp_type": "preonly", "pc_type": "lu", "mat_mumps_icntl_24": 1,
                       "pc_factor_mat_solver_type": "mumps"}  # fmt: skip
            self._factor = set_up_ksp(matrix, "llm_changed_", options)
            self._b, self._c = matrix.createVecs()
            matrix.destroy()

    def _around(self, form: Transformation, A: Any) -> Any:
        """The matrix on the chosen places and the bodies' dofs next to them: what law and bodies
        say of these at once, neither the multigrid nor the places alone tell."""
        right, below, corner = A
        comm, first, start = corner.comm, form.tail.first, self._split.first
        indptr, columns, _ = right.getValuesCSR()
        every = np.concatenate(form.comm.allgather(self._at + first))
        row = np.repeat(np.arange(self._n), np.diff(indptr))
        self._near = np.unique(row[np.isin(columns, every)])
        places = [
            PETSc.IS().createGeneral(at.astype(PETSc.IntType), comm)
            for at in (self._near + start, self._at + first)
        ]
        body, tail = places
        parts = [
            [self._split.inside.createSubMatrix(body, body), right.createSubMatrix(body, tail)],
            [below.createSubMatrix(tail, body), corner.createSubMatrix(tail, tail)],
        ]
        matrix, _ = join_blocks(parts)
        for item in (*places, *parts[0], *parts[1]):
            item.destroy()
        return matrix

    def _changes(
        self, form: Transformation, rows: EliminatedRows, reduced: Reduced
    ) -> tuple[np.ndarray, np.ndarray]:
        """(m,) unknowns of the frames that differ, and dofs of surface nodes."""
        before = self._reduced
        changed = (reduced.told != before.told) | reduced.rim
        apart, most = abs(reduced.stiff - before.stiff).tocoo(), np.zeros(len(changed))
        np.maximum.at(most, apart.row, apart.data)
        changed |= ~reduced.told & (most > STIFFER * reduced.stiffness)
        led = abs(reduced.C - before.C).tocoo()
        led_at = led.data > 1e-6
        changed[led.row[led_at]] = changed[led.col[led_at]] = True
        reduced.complete(changed)
        changed[form.frame.dependent] = changed[self._dependent] = True
        both = np.concatenate([_states(rows), self._active])
        node, count = np.unique(both, axis=0, return_counts=True)
        nodes = np.unique(node[count == 1, 0])
        dofs = (nodes[:, None] + np.arange(rows.dofs.shape[1])).ravel()
        return changed, dofs

    def apply(self, body: np.ndarray, tail: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The preconditioner times this rank's residual of the bodies and of the other places."""
        first = self._correction(body, tail)
        if first is not None:
            body, tail = self._left(body, tail, *first)
        scale = self._S.array_r
        self._x.array_w[:] = scale * np.concatenate([body, times(self._P, tail, transposed=True)])
        self.ksp.getPC().apply(self._x, self._y)
        found = scale * self._y.array_r
        inside, outside = found[: self._n], times(self._P, found[self._n :])
        again = self._correction(*self._left(body, tail, inside, outside)) if first else None
        for part in (first, again):
            if part is not None:
                inside, outside = inside + part[0], outside + part[1]
        return inside, outside

    def _left(
        self, body: np.ndarray, tail: np.ndarray, x: np.ndarray, y: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """What x of the bodies and y of the other places leave of a residual."""
        right, below, corner = self._A
        inside = body - times(self._split.inside, x) - times(right, y)
        return inside, tail - times(below, x) - times(corner, y)

    def _correction(
        self, body: np.ndarray, tail: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """What the factorised part makes of a residual; None where nothing has changed."""
        if self._factor is None:
            return None
        k = len(self._near)
        self._c.array_w[:] = np.concatenate([body[self._near], tail[self._at]])
        self._factor.solve(self._c, self._b)
        x, y = np.zeros(len(body)), np.zeros(len(tail))
        x[self._near], y[self._at] = self._b.array_r[:k], self._b.array_r[k:]
        return x, y

    def release(self) -> None:
        """Free what is another step's; collective."""
        for item in (self._P, *((self._factor, self._b, self._c) if self._factor else ())):
            if item is not None:
                item.destroy()
        self._P = self._factor = None

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.release()
        for item in (self.ksp, self.matrix, self._S, self._x, self._y):
            item.destroy()


def _states(rows: EliminatedRows) -> np.ndarray:
    """(k, 2) first dof of each node in contact, and how many rows hold it."""
    return np.column_stack(np.unique(rows.dofs[:, 0], return_counts=True))
