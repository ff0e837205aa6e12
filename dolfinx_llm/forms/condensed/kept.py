"""A multigrid preconditioner of one step with friction that serves others as well.

It is GAMG of the symmetric part of the step it was made for. Where another step differs (nodes
that have come to stick, slip, open or close since) a factorisation of that step's own matrix on
these places alone corrects what it leaves there.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix, diags

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.forms.condensed.correction import Correction
from dolfinx_llm.forms.condensed.elimination import EliminatedRows
from dolfinx_llm.forms.condensed.krylov import GAMG, near_null_space
from dolfinx_llm.forms.condensed.modes import Modes, ModesAsked
from dolfinx_llm.forms.condensed.parting import parted, side_motions
from dolfinx_llm.forms.condensed.splitting import SplitStiffness
from dolfinx_llm.forms.condensed.symmetric import Reduced
from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.forms.direct import set_up_ksp
from dolfinx_llm.operators.petsc import create_aij, times

MOST = 0.5  # of all jumps between bodies
STIFFER = 0.5  # of what bodies set against a jump: by so much a law's stiffness has not changed

COARSEST = 300  # unknowns of a hierarchy's end that dense algebra may solve for


class KeptMultigrid:
    """GAMG of the symmetric part of a step's matrix, for vectors of the places that ``whole`` of
    ``Transformation`` gives.

    Args:
        split: stiffness of the bodies.
        rows: what is in contact; their L is replaced.
        reduced: the step.
        fixed: (n_local,) prescribed dofs.
        scale: stiffness of the surfaces [force / length].
        modes: gives the near-null space at this rank's dofs (n_local, k) and the unknowns w (m, k).
        options: prefix and PETSc options.
        before: a multigrid whose aggregates are to be parted, and the sides of its places.

    Attributes:
        ksp: PETSc's solver of ``matrix``, which ``scaling`` brings to unit diagonal.
        frame: (m, m) unknowns w of the frames by those in its places.
        changed: places on all ranks where the step that it serves differs.
    """

    def __init__(
        self,
        split: SplitStiffness,
        rows: EliminatedRows,
        reduced: Reduced,
        fixed: Array,
        scale: float,
        modes: ModesAsked,
        options: tuple[str, dict[str, Any]],
        before: tuple[KeptMultigrid, Modes] | None = None,
    ) -> None:
        self._split, self._reduced, self._active = split, reduced, _states(rows)
        self._own = before is None  # its aggregates
        on = reduced.L_parted[reduced.on]
        everywhere = np.ones(on.shape[1])
        form = Transformation(split, replace(rows, L=on), fixed, everywhere, whole=True)
        self._dependent = form.frame.dependent
        Z, parts = form.frame.Z, reduced.parts
        idle = np.zeros(on.shape[1])
        idle[self._dependent] = scale
        D = Z.T @ (parts.T @ reduced.stiff @ parts) @ Z + diags(idle)
        between = [] if before is None else before[0].stripped()
        self.matrix, self.scaling = form.reduce(D.tocsr(), scale)
        for option in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.SPD):
            self.matrix.setOption(option, True)
        chosen = {"ksp_type": "gmres"} | GAMG | options[1]
        if before is None:
            self._tell_modes(form, modes)
            self.ksp = set_up_ksp(self.matrix, options[0], chosen, options[1])
            self.matrix.setNearNullSpace(PETSc.NullSpace())  # it has served
        else:
            other, sides = before
            told = diags((~reduced.told).astype(float))
            frame = diags((idle == 0.0).astype(float)) @ reduced.parted @ told @ other.frame
            motions = side_motions(form, frame.tocsr(), sides)
            scaled = (self.matrix, self.scaling), (between, other.scaling)
            self.ksp = parted(*scaled, motions, options[0], chosen)
        self._x, self._y = self.matrix.createVecs()
        indptr, columns, values = form.T.getValuesCSR()
        self._T = csr_matrix((values, columns, indptr), (len(indptr) - 1, form.tail.sizes[1]))
        self.frame: csr_matrix = (reduced.C @ parts @ Z).tocsr()
        form.T.destroy()
        self._P: Any = None
        self._correction: Any = None  # where the step that it serves differs
        self._form: Any = None

    def _tell_modes(self, form: Transformation, modes: ModesAsked) -> None:
        """Give the matrix its near-null space."""
        body, frame = modes()
        w = self._reduced.parted @ np.where(self._reduced.told[:, None], 0.0, frame)
        near_null_space(self.matrix, self.scaling, form.unknowns(body, w))

    def knows(self, reduced: Reduced) -> bool:
        """Whether it was made for this step, with aggregates of its own."""
        return self._own and self._reduced is reduced

    def parts(self, reduced: Reduced) -> bool:
        """Whether its aggregates may be parted for another step: all that comes free there slips
        between two sides, and the aggregates are GAMG's, and whole."""
        free, pc = self._reduced.told & ~reduced.told, self.ksp.getPC()
        if (free & ~reduced.slips).any() or pc.getType() != "gamg" or pc.getMGLevels() < 2:
            return False
        return bool(pc.getMGCoarseSolve().getOperators()[0].getSize()[0] <= COARSEST)

    def stripped(self) -> list[Any]:
        """Interpolations of GAMG, from the coarsest: what parting needs, all other memory of it is
        freed; collective."""
        pc = self.ksp.getPC()
        between = [pc.getMGInterpolation(level) for level in range(1, pc.getMGLevels())]
        del pc  # holds all of it
        self._free_matrix()
        return between

    def sticks(self, rows: EliminatedRows, reduced: Reduced) -> bool:
        """Whether it was made for a surface that sticks, and most of it slips in a step: of pairs
        that have opened multigrid knows little, and a side beside a far stiffer one moves as if it
        stuck."""
        begun = reduced.slips & ~self._reduced.slips & reduced.alike
        most = begun.sum() > MOST * reduced.jumps.sum()
        return bool(most and np.array_equal(_states(rows), self._active))

    def serves(self, form: Transformation) -> bool:
        """Whether a step's matrix is known already."""
        return self._form is form

    def meet(self, form: Transformation, rows: EliminatedRows, reduced: Reduced) -> None:
        """Take over another step, but for its matrix."""
        self.release()
        tail, self._n, self._form = form.tail, len(form.fixed), form
        w, dofs = self._changes(form, rows, reduced)
        at = self._split.surface + self._split.first
        places = tail.left[np.isin(at, dofs)]
        mine = np.concatenate([places, tail.seats[w[tail.mine_used]]])
        self._at = np.unique(mine)
        self.changed = form.comm.allreduce(len(self._at))

    def fit(self, form: Transformation, reduced: Reduced, test: Any, corner: Any) -> None:
        """Take over the matrix of the step that was met, of the T_S of its rows and its last block,
        and factorise it where it differs."""
        tail, kept = form.tail, (~reduced.told).astype(float)
        kept[form.frame.dependent] = 0.0
        surface = (form.nodes.T @ self._T).tocoo()
        frame = (diags(kept) @ self.frame)[tail.mine_used].tocoo()
        row = np.concatenate([tail.left[surface.row], tail.seats[frame.row]])
        col = np.concatenate([surface.col, tail.columns[frame.col]])
        value = np.concatenate([surface.data, frame.data])
        local = csr_matrix((value, (row, col)), shape=tail.sizes)
        self._P = create_aij(form.comm, tail.sizes, tail.sizes, local)
        if self.changed:
            self._correction = Correction(form, self._at, test, corner)

    def _changes(
        self, form: Transformation, rows: EliminatedRows, reduced: Reduced
    ) -> tuple[Array, Array]:
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

    def apply(self, body: Array, tail: Array) -> tuple[Array, Array]:
        """The preconditioner times this rank's residual of the bodies and of the other places."""
        scale = self.scaling.array_r
        self._x.array_w[:] = scale * np.concatenate([body, times(self._P, tail, transposed=True)])
        self.ksp.getPC().apply(self._x, self._y)
        found = scale * self._y.array_r
        inside, outside = found[: self._n], times(self._P, found[self._n :])
        if self._correction is not None:
            self._correction.add((body, tail), (inside, outside))
        return inside, outside

    def release(self) -> None:
        """Free what is another step's; collective."""
        for item in (self._P, self._correction):
            if item is not None:
                item.destroy()
        self._P = self._correction = self._form = None

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.release()
        self._free_matrix()
        for item in (self.scaling, self._x, self._y):
            item.destroy()

    def _free_matrix(self) -> None:
        self.ksp.destroy()  # first: K's inside is copied where it was
        self._split.leave(self.matrix)
        self.matrix.destroy()


def _states(rows: EliminatedRows) -> Array:
    """(k, 2) first dof of each node in contact, and how many rows hold it."""
    return np.column_stack(np.unique(rows.dofs[:, 0], return_counts=True))
