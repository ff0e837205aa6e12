"""Rigid motions that supports alone do not hold, as the interfaces see them."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import csr_matrix, identity
from scipy.sparse.linalg import splu

from dolfinx_llm.base.parallel import gather_rows
from dolfinx_llm.operators.motions import RigidMotions
from dolfinx_llm.operators.numbering import Numbering
from dolfinx_llm.operators.petsc import times
from dolfinx_llm.operators.support import pins

SPRING = 1e-10  # stiffness of the springs that hold free bodies, of the surfaces'
WEAKER = 1e-5  # ... of that of springs which hold other bodies
LEAST = 1e-13  # ... of the surfaces', at least
DRIFTS = 1e-9  # rounding of K over the stiffness of springs, from which on it is looked at


class Floating:
    """Rigid motions that supports leave to the bodies, α, each held by a weak spring at one dof.
    The springs pull to where the bodies were. At a solution they carry nothing: what they carry
    else is the part of the load that neither supports nor contact take."""

    def __init__(self, rigid: RigidMotions, B: PETSc.Mat, rows: Numbering) -> None:
        self.comm: MPI.Comm = rigid.bodies.comm
        self.rigid = rigid
        self.count = self.rigid.free
        self.modes = self.rigid.modes[:, : self.count]
        self.pins = pins(self.comm, self.modes)
        self._at_pins = gather_rows(self.comm, self.modes[self.pins])  # (count, count)
        self.square = self._at_pins.T @ self._at_pins
        own = np.zeros((rows.sizes[0], self.rigid.modes.shape[1]))
        for k, mode in enumerate(self.rigid.modes.T):
            own[:, k] = times(B, mode, transposed=True)
        self.G = gather_rows(self.comm, own)[rows.number]  # (n, k) Bᵀ of all rigid motions

    def at_pins(self, amounts: np.ndarray) -> np.ndarray:
        """Motion of this rank's pins for (count,) α [length]."""
        return self.modes[self.pins] @ amounts

    def amounts(self, u: np.ndarray) -> np.ndarray:
        """(count,) α of this rank's displacement u (n_local,)."""
        return np.linalg.solve(self._at_pins, gather_rows(self.comm, u[self.pins]))

    def spring(self, scale: float) -> float:
        """Stiffness of the springs [force / length]: weak against ``scale``, and against springs
        of the bodies' own that they may act in line with, as far as digits allow."""
        weakest = np.diagonal(self.rigid.stiffness)[self.count :].min(initial=np.inf)
        return float(max(min(SPRING * scale, WEAKER * weakest), LEAST * scale))

    @property
    def grip(self) -> np.ndarray:
        """(n, count) by how much multipliers may push along the free motions."""
        return np.abs(self.G[:, : self.count])

    def drift(self, L: csr_matrix) -> float:
        """Relative error of motions that weak springs alone hold: the stiffness of the bodies, with
        its rounding, stands beside theirs. L (n, m) has the rows of L_b in contact, the others are
        zero."""
        rigid, weak = self.rigid, slice(self.count, None)
        own, noise = rigid.stiffness[weak, weak], np.diag(rigid.noise[weak])
        if not (np.diagonal(noise) > DRIFTS * np.diagonal(own)).any():
            return 0.0
        on = np.diff(L.indptr) > 0
        G = self.G[:, weak] * on[:, None]
        if L.shape[1]:
            fit = splu((L.T @ L + 1e-10 * identity(L.shape[1])).tocsc())
            G = G - L @ fit.solve(L.T @ G)
        values, vectors = np.linalg.eigh(G.T @ G)
        loose = vectors[:, values < 1e-8 * max(np.abs(self.G).max(initial=0.0), 1.0)]
        if not loose.shape[1]:
            return 0.0
        return float(scipy.linalg.eigh(loose.T @ noise @ loose, loose.T @ own @ loose)[0].max())

    def sizes(self, f: np.ndarray) -> np.ndarray:
        """(count,) this rank's loads f along the motions, summed up over all without sign."""
        return self.comm.allreduce(np.abs(self.modes).T @ np.abs(f))
