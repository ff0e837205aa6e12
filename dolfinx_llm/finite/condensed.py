"""Newton's system by GMRES with GAMG on the bodies, onto which contact is condensed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from petsc4py import PETSc

from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.parallel import gather_rows
from dolfinx_llm.finite.coupling import Coupling
from dolfinx_llm.forms.condensed.gmres import solve_right
from dolfinx_llm.forms.condensed.krylov import GAMG, near_null_space
from dolfinx_llm.forms.direct import set_up_ksp
from dolfinx_llm.operators.numbering import BodyDofs, Numbering

FIRST = 1e-5  # relative residual that a linear solve is to reach, at most
NEXT = 1e-2  # the same over Newton's residual, so that it converges quadratically
NEEDLESS = 1e-14  # of Newton's residual, which no solve need fall below
SOLVES = 4  # of GMRES, where own equations hide what forces miss
LANDS = 1e-11  # the same where answers depend on what an iteration finds
REACHED = 1e-12  # relative residual that it can reach
GMRES = {"ksp_type": "gmres", "ksp_max_it": 150, "pc_factor_mat_solver_type": "mumps"}


def tolerance(error: float, exact: bool) -> tuple[float, float]:
    """Relative residuals that must and may be reached where Newton's is ``error``."""
    must = float(min(FIRST, max(NEXT * error, NEEDLESS / max(error, 1e-300))))
    return must, min(must, LANDS) if exact else must


@dataclass(eq=False)
class CondensedSystem:
    """The system for changes that leave prescribed dofs as they are.

    Vectors hold this rank's dofs of the bodies, then its own unknowns of the interfaces.
    """

    dofs: BodyDofs
    own: Numbering
    P: PETSc.Mat  # of the bodies and of the pairs' stiffness: the preconditioner's
    coupling: Coupling
    iterations: int = 0  # of the last solve
    ended: str = ""  # how the last solve ended, where it gave no answer

    def solve(
        self,
        r: np.ndarray,
        s: np.ndarray,
        modes: np.ndarray,
        tolerances: tuple[float, float],
        options: tuple[str, dict],
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Changes of this rank's u and of all q; None where GMRES does not get there; collective.

        Args:
            r: (n_local,) forces, zero at prescribed dofs.
            s: (q,) right-hand side of the own equations.
            modes: (n_local, k) motions that hardly any energy goes into.
            tolerances: see ``tolerance``; a user's takes the place of both.
            options: prefix, and PETSc options.

        Raises:
            ContactInputError: options that PETSc does not know, or refuses.
        """
        self.ended = self.coupling.wrong
        if self.ended:
            return None
        self._x, self._y = self.P.createVecs()
        self._x.set(1.0)
        near_null_space(self.P, self._x, modes)
        chosen = GMRES | GAMG | {"ksp_rtol": tolerances[1]}
        try:
            self._inner = set_up_ksp(self.P, options[0], chosen | options[1], options[1])
        except ContactInputError:
            raise
        except ContactError as error:
            self.ended = str(error)
            return None
        inner = self._inner
        found, reason = self._refined(r, s, tolerances[0])
        for item in (inner, self._x, self._y):
            item.destroy()
        if reason > 0:
            return self._split(found)
        self.ended = f"{self.iterations} iterations, PETSc's reason {reason}"
        return None

    def _refined(self, r: np.ndarray, s: np.ndarray, must: float) -> tuple[np.ndarray, int]:
        """The solution, and PETSc's reason of the end. Forces are asked for as part of those that
        both right-hand sides are; own equations that say next to nothing of their unknowns have a
        large one, which is solved at once and would be all that GMRES sees."""
        comm, inner = self.dofs.comm, self._inner
        rtol, *others = inner.getTolerances()
        size = _length(comm, r - self.coupling.forces(s)[1])
        goal, enough = rtol * size, max(rtol, must) * size
        left, found, self.iterations = self._joined(r, s), np.zeros(0), 0
        for _ in range(SOLVES):
            given = self.P.comm, self._times, self._precondition, left, inner.getType()
            more, taken, reason = solve_right(*given, (rtol, *others))
            found = more if not len(found) else found + more
            self.iterations += taken
            left = left - self._times(more)
            if reason <= 0 or _length(comm, left[: len(r)]) <= goal:
                break
            rtol = min(rtol, max(goal / _length(comm, left), REACHED))
        reached = _length(comm, left[: len(r)]) <= enough
        return found, max(reason, 1) if reached else reason

    def _split(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """This rank's u and all q of a vector."""
        n = len(self.dofs.fixed)
        return v[:n], gather_rows(self.dofs.comm, v[n:])[self.own.number]

    def _joined(self, u: np.ndarray, q: np.ndarray) -> np.ndarray:
        return np.concatenate([u, q[self.own.mine]])

    def _times(self, v: np.ndarray) -> np.ndarray:
        """The system times a vector."""
        u, q = self._split(v)
        self._x.array_w[:] = u
        self.P.mult(self._x, self._y)
        forces, equations = self.coupling.times(u, q)
        return self._joined(self._y.array_r + forces, equations)

    def _precondition(self, v: np.ndarray) -> np.ndarray:
        """The preconditioner times a vector."""
        r, s = self._split(v)
        self._y.array_w[:] = r - self.coupling.forces(s)[1]
        self._inner.getPC().apply(self._y, self._x)
        u = self._x.array_r.copy()
        return self._joined(u, self.coupling.after(s, u))


def _length(comm: Any, v: np.ndarray) -> float:
    """Of a vector of which each rank has a part."""
    return float(np.sqrt(comm.allreduce(float(v @ v))))
