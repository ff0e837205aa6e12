"""Motions that contact alone holds, and the weak springs for as long as it is sought."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from petsc4py import PETSc
from scipy.sparse import bmat, csr_matrix, identity, vstack
from scipy.sparse.linalg import splu

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import gather_rows
from dolfinx_llm.base.sparse import NO_ROWS, diagonal, symmetric_factors
from dolfinx_llm.operators.motions import RigidMotions
from dolfinx_llm.operators.numbering import Numbering
from dolfinx_llm.operators.petsc import local_csr

SPRING = 1e-10  # stiffness of the springs that hold free bodies, of the surfaces'
WEAKER = 1e-5  # ... of that of springs which hold other bodies
LEAST = 1e-13  # ... of the surfaces', at least
DRIFTS = 1e-9  # rounding of K over the stiffness of springs, from which on it is looked at


@dataclass(frozen=True, eq=False)
class Loose:
    """Combinations c of the free motions that no contact resists in either sense: held c = 0."""

    held: csr_matrix  # (r, free) rows that are independent

    @property
    def count(self) -> int:
        """How many they are."""
        return int(self.held.shape[1] - self.held.shape[0])

    def nearest(self, square: csr_matrix, along: Array) -> Array:
        """(free, ...) the c with the least cᵀ square c / 2 - cᵀ along."""
        system = splu(bmat([[square, self.held.T], [self.held, None]], format="csc"))
        none = np.zeros((self.held.shape[0], *along.shape[1:]))
        return np.asarray(system.solve(np.concatenate([along, none]))[: len(along)])

    def some(self, count: int) -> Array:
        """(free, at most ``count``) of them, by chance."""
        free = self.held.shape[1]
        chance = np.random.default_rng(2001).normal(size=(free, min(count, self.count)))
        return self.nearest(identity(free, format="csr"), chance)


class Floating:
    """Rigid motions that supports leave to the bodies, α, each held by a weak spring at one dof.
    The springs pull to where the bodies were. At a solution they carry nothing: what they carry
    else is the part of the load that neither supports nor contact take. ``loose`` are those
    combinations that carry no force at all, in whichever state of contact."""

    def __init__(self, rigid: RigidMotions, B: PETSc.Mat, rows: Numbering, loose: Loose) -> None:
        self.comm = rigid.bodies.comm
        self.rigid = rigid
        self.count, self.loose = self.rigid.free, loose
        self.pins = rigid.pins(self.count)
        self.square, self._at_pins = NO_ROWS, None
        if self.count:
            at_pins = vstack(self.comm.allgather(self._pinned), format="csc")
            self.square, self._at_pins = (at_pins.T @ at_pins).tocsr(), splu(at_pins)
        self.G = csr_matrix((rows.sizes[1], 0))  # (n, k) Bᵀ of all rigid motions
        if len(rigid.body):
            own = (local_csr(B).T @ self.rigid.modes).tocsr()
            self.G = self.comm.allreduce(own)[rows.number]

    @cached_property
    def modes(self) -> csr_matrix:
        """(n_local, count) these motions of this rank's dofs."""
        return self.rigid.modes[:, : self.count]

    @cached_property
    def _pinned(self) -> csr_matrix:
        """(pins, count) of the pins alone."""
        return self.modes[self.pins]

    def at_pins(self, amounts: Array) -> Array:
        """Motion of this rank's pins for (count,) α [length]."""
        return np.asarray(self._pinned @ amounts)

    def amounts(self, u: Array) -> Array:
        """(count,) α of this rank's displacement u (n_local,)."""
        moved = gather_rows(self.comm, u[self.pins])
        return moved if self._at_pins is None else self._at_pins.solve(moved)

    def strayed(self, u: Array) -> Array:
        """(count,) the part of this rank's displacement u (n_local,) along the loose motions: what
        is left without it has the least sum of squares."""
        if not self.loose.count:
            return np.zeros(self.count)
        square, along = self.modes.T @ self.modes, self.modes.T @ u
        return self.loose.nearest(self.comm.allreduce(square), self.comm.allreduce(along))

    def spring(self, scale: float) -> float:
        """Stiffness of the springs [force / length]: weak against ``scale``, and against springs
        of the bodies' own that they may act in line with, as far as digits allow."""
        weakest = self.rigid.stiffness.diagonal()[self.count :].min(initial=np.inf)
        return float(max(min(SPRING * scale, WEAKER * weakest), LEAST * scale))

    @cached_property
    def grip(self) -> csr_matrix:
        """(n, count) by how much multipliers may push along the free motions."""
        return abs(self.G[:, : self.count])

    def drift(self, L: csr_matrix, frames: int, active: Array) -> float:
        """Relative error of motions that weak springs alone hold: the stiffness of the bodies, with
        its rounding, stands beside theirs. The first columns of L (n, m), so many, are L_b; (n,)
        rows are in contact."""
        rigid, weak = self.rigid, slice(self.count, None)
        noise = rigid.noise[weak]
        if not (noise > DRIFTS * rigid.stiffness.diagonal()[weak]).any():
            return 0.0
        own = rigid.stiffness[weak, weak].toarray()
        L = diagonal(active) @ L[:, :frames]
        on = np.diff(L.indptr) > 0
        G = self.G[:, weak].toarray() * on[:, None]
        if L.shape[1]:
            fit = symmetric_factors(L.T @ L + 1e-10 * identity(L.shape[1]))
            G = G - L @ fit.solve(L.T @ G)
        values, vectors = np.linalg.eigh(G.T @ G)
        loose = vectors[:, values < 1e-8 * max(abs(self.G).max() if self.G.nnz else 0.0, 1.0)]
        if not loose.shape[1]:
            return 0.0
        noisy = loose.T @ (noise[:, None] * loose)
        return float(scipy.linalg.eigh(noisy, loose.T @ own @ loose)[0].max())

    def loads(self, f: Array) -> Array:
        """(count,) this rank's loads f along the motions, summed up over all: Gᵀ λ in balance."""
        return self.comm.allreduce(self.modes.T @ f)

    def sizes(self, f: Array) -> Array:
        """(count,) this rank's loads f along the motions, summed up over all without sign."""
        if not self.count:
            return np.zeros(0)
        return self.comm.allreduce(abs(self.modes).T @ np.abs(f))
