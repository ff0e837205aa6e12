"""The matrix of a step with friction in the condensed form, what its unknowns are and mean."""

from __future__ import annotations

from typing import Any

import numpy as np
from mpi4py import MPI

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import gather_rows
from dolfinx_llm.forms.condensed.elimination import EliminatedRows
from dolfinx_llm.forms.condensed.friction_system import FrictionSystem
from dolfinx_llm.forms.condensed.reduced import product
from dolfinx_llm.forms.condensed.transformation import Transformation
from dolfinx_llm.forms.step import LinearStep


class FrictionMatrix:
    """A q = b of one step, reduced where it may be.

    Args:
        of: what is kept.
        eliminated: rows in contact.
        on: (r,) their places among all.
        step: the step.
    """

    def __init__(
        self, of: FrictionSystem, eliminated: EliminatedRows, on: Array, step: LinearStep
    ) -> None:
        self._of, self._split, self._step, self._on = of, of.split, step, on
        self._fixed, self._scale = of.operators.dofs.fixed, of.operators.scale
        self._rows, self._reduced = of.reduced(step, eliminated, on)
        self._assemble()

    def _assemble(self) -> None:
        """What the matrix is made of, of the step as it is or reduced."""
        law = self._step if self._reduced is None else self._reduced
        soft = self._scale * self._step.compliance[self._on]
        self._gives = self._step.compliance[self._on][self._rows.multipliers.mine]
        self._form = Transformation(
            self._split, self._rows, self._fixed, np.ones(self._step.L.shape[1]), soft, whole=True
        )
        self._E, self._D = law.E[:, self._on], law.D
        seen = self._E.T.tocsr()[self._rows.multipliers.mine]
        self._test = self._form.columns_of(self._form.A @ seen)
        laws = self._form.frame_law(self._E, self._D, self._scale)
        self._corner: Any = self._form.corner(-laws, self._scale, self._test)

    def _begun(self, f: Array, g: Array, rhs: Array, about: Array | None) -> tuple[Any, ...]:
        """Loads of this rank's rows, of a reduced step where there is one; forces that stay (R,),
        those about which this rank's rows give way besides, and what is added to w."""
        form, numbering = self._form, self._rows.multipliers
        kept = np.zeros(len(self._on)) if about is None else form.bound(about[self._on])
        own = None if about is None else (about[self._on] - kept)[numbering.mine]
        w_0: Any = 0.0
        if self._reduced is not None:
            g, rhs, w_0 = self._reduced.loads(g, rhs)
        kept = kept + form.contradicting(g[self._on], self._scale)
        return (f, g[self._on][numbering.mine], rhs - self._E @ kept), kept, own, w_0

    def _answer(self, q: Array, f: Array, kept: Array, w_0: Any, about: tuple[Array, ...]) -> Any:
        """This rank's u, and all of λ and w, of q: the motions ``about`` which it was solved, and
        its offsets, are added."""
        form, numbering, (u, z, u_0, v_0) = self._form, self._rows.multipliers, about
        u = u + (form.motion(q) + u_0)
        found = of_bodies(form, f, u) + form.frame_multipliers(q, self._scale)
        multiplier = np.zeros(len(self._step.active))
        multiplier[self._on] = gather_rows(self._split.comm, found)[numbering.number] + kept
        w = z + form.frame_motion(q, v_0)
        return u, multiplier, w if self._reduced is None else self._reduced.C @ w + w_0

    def _loads_about(
        self, u: Array, z: Array, f: Array, g: Array, rhs: Array
    ) -> tuple[Array, Array, Array]:
        """b of A q = b for what is added to u and z, and the offsets u_0 and v_0: about the last
        solution sums of large motions, as those of both sides of a slip, cost no digits."""
        form, split, fixed = self._form, self._split, self._fixed
        if self._split.comm.allreduce(bool(u.any() or z.any()), op=MPI.LOR):
            of_rows = form.vectors * np.where(fixed[form.dofs], 0.0, u[form.dofs])
            g = g - form.L @ z + of_rows.sum(axis=1)
            f = np.where(fixed, f - u, f - split.times(u))
        u_0, v_0 = form.offsets(f, g)
        b = form.load(f, u_0, self._test)
        b[len(f) + form.tail.seats] -= (rhs - self._D @ (z + v_0))[form.tail.mine_used]
        return b, u_0, v_0

    def _times(self, q: Array) -> Array:
        return product(self._form, self._corner, q, self._test)


def of_bodies(form: Transformation, f: Array, u: Array) -> Array:
    """(R,) forces of this rank's rows on free dofs, by f - K u."""
    S = form.split.surface
    left = np.where(form.fixed[S], 0.0, f[S] - form.split.rows(u))
    return np.asarray(form.A.T @ left)
