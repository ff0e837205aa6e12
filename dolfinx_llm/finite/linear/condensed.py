"""Newton's system by GMRES with GAMG on the bodies, onto which contact is condensed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import gather_rows
from dolfinx_llm.finite.linear.coupling import Coupling
from dolfinx_llm.finite.linear.multigrid import OURS, Multigrid
from dolfinx_llm.forms.condensed.gmres import solve_right
from dolfinx_llm.operators.numbering import BodyDofs, Numbering

FIRST = 1e-5  # relative residual that a linear solve is to reach, at most
NEXT = 1e-2  # the same over Newton's residual, so that it converges quadratically
NEEDLESS = 1e-14  # of Newton's residual, which no solve need fall below
SOLVES = 4  # of GMRES, where own equations hide what forces miss
LANDS = 1e-11  # the same where answers depend on what an iteration finds
REACHED = 1e-12  # relative residual that it can reach


def tolerance(error: float, exact: bool) -> tuple[float, float]:
    """Relative residuals that must and may be reached where Newton's is ``error``."""
    must = float(min(FIRST, max(NEXT * error, NEEDLESS / max(error, 1e-300))))
    return must, min(must, LANDS) if exact else must


@dataclass(eq=False)
class CondensedSystem:
    """The system for changes that leave prescribed dofs as they are.

    Vectors hold this rank's dofs of the bodies, then its own unknowns of the interfaces; right-hand
    sides of these are weighted.
    """

    dofs: BodyDofs
    own: Numbering
    multigrid: Multigrid  # of the bodies and of the pairs' stiffness
    coupling: Coupling
    iterations: int = 0  # of the last solve
    ended: str = ""  # how the last solve ended, where it gave no answer

    def solve(
        self, r: Array, s: Array, tolerances: tuple[float, float]
    ) -> tuple[Array, Array] | None:
        """Changes of this rank's u and of all q; None where GMRES does not get there; collective.

        Args:
            r: (n_local,) forces, zero at prescribed dofs.
            s: (q,) right-hand side of the own equations.
            tolerances: see ``tolerance``; a user's takes the place of both.
        """
        self._x, self._y = self.multigrid.matrix.createVecs()
        rtol = self.multigrid.ksp.getTolerances()[0]
        must, may = tolerances if rtol == OURS else (rtol, rtol)
        found, reason = self._refined(r, s, must, may)
        self.multigrid.count(self.iterations, may)
        self._x.destroy()
        self._y.destroy()
        if reason > 0:
            return self._split(found)
        self.ended = f"{self.iterations} iterations, PETSc's reason {reason}"
        return None

    def _refined(self, r: Array, s: Array, must: float, rtol: float) -> tuple[Array, int]:
        """The solution, and PETSc's reason of the end. Forces are asked for as part of those that
        both right-hand sides are; own equations that say next to nothing of their unknowns have a
        large one, which is solved at once and would be all that GMRES sees: it is made as large as
        these."""
        comm, inner = self.dofs.comm, self.multigrid.ksp
        size, own = _length(comm, r - self.coupling.forces(s)[1]), float(np.linalg.norm(s))
        self._weight = size / own if 0.0 < size < own else 1.0
        goal, enough, others = rtol * size, max(rtol, must) * size, inner.getTolerances()[1:]
        left, found, self.iterations = self._joined(r, self._weight * s), np.zeros(0), 0
        rtol = min(rtol, max(goal / max(_length(comm, left), 1e-300), REACHED))
        for _ in range(SOLVES):
            given = inner.comm, self._times, self._precondition, left, inner.getType()
            more, taken, reason = solve_right(*given, (rtol, *others))
            found = more if not len(found) else found + more
            self.iterations += taken
            left = left - self._times(more)
            if reason <= 0 or _length(comm, left[: len(r)]) <= goal:
                break
            rtol = max(goal / _length(comm, left), REACHED)
        reached = _length(comm, left[: len(r)]) <= enough
        return found, max(reason, 1) if reached else reason

    def _split(self, v: Array) -> tuple[Array, Array]:
        """This rank's u and all q of a vector."""
        n = len(self.dofs.fixed)
        return v[:n], gather_rows(self.dofs.comm, v[n:])[self.own.number]

    def _joined(self, u: Array, q: Array) -> Array:
        return np.concatenate([u, q[self.own.mine]])

    def _times(self, v: Array) -> Array:
        """The system times a vector."""
        u, q = self._split(v)
        self._x.array_w[:] = u
        self.multigrid.matrix.mult(self._x, self._y)
        forces, equations = self.coupling.times(u, q)
        return self._joined(self._y.array_r + forces, self._weight * equations)

    def _precondition(self, v: Array) -> Array:
        """The preconditioner times a vector."""
        r, s = self._split(v)
        s = s / self._weight
        self._y.array_w[:] = r - self.coupling.forces(s)[1]
        self.multigrid.ksp.getPC().apply(self._y, self._x)
        u = self._x.array_r.copy()
        return self._joined(u, self.coupling.after(s, u))


def _length(comm: Any, v: Array) -> float:
    """Of a vector of which each rank has a part."""
    return float(np.sqrt(comm.allreduce(float(v @ v))))
