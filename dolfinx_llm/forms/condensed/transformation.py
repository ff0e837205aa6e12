"""T of the condensed form: u = T q + u_0, v = Z q_v + v_0.

q holds, on each rank, a place for each dof of its bodies, idle at surface nodes, and then
what the surfaces have left to solve for (``Tail``).
"""

from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.sparse import csr_matrix, diags

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import below, of_rows, pushed, renumbered
from dolfinx_llm.forms.condensed.elimination import (
    EliminatedRows,
    FrameElimination,
    eliminate_at_nodes,
)
from dolfinx_llm.forms.condensed.splitting import SplitStiffness
from dolfinx_llm.operators.petsc import create_aij, times


class Transformation:
    """What the eliminated rows make of u and v, with the numbers of the unknowns q. K is parted at
    the dofs of all eliminated nodes or more; ``proximal`` (m,) is a stiffness of the frames'
    unknowns, ``soft`` (rows,) a compliance times their unit of stiffness; ``whole``: all dofs of
    surfaces and all unknowns of frames have places, whatever is eliminated."""

    def __init__(
        self,
        split: SplitStiffness,
        rows: EliminatedRows,
        fixed: Array,
        proximal: Array | None,
        soft: Array | None = None,
        whole: bool = False,
    ) -> None:
        self.comm, self.split, self.rows, self.fixed = split.comm, split, rows, fixed
        self.gdim, self.proximal = rows.dofs.shape[1], proximal
        dofs, self.vectors = rows.local  # (R, gdim) base vectors of this rank's rows
        self.dofs = dofs - split.first  # (R, gdim) local
        on, at = fixed[split.surface], np.searchsorted(split.surface, self.dofs)
        node = eliminate_at_nodes(at, self.vectors, on)
        self.A, self.W = node.A, node.W  # (S, R) and (k, R)
        self.L = of_rows(rows.L, rows.multipliers.mine)  # of this rank
        self.frame = FrameElimination(self.comm, *self._frame_rows(soft))
        self._N_S = node.N
        # (R, m) what these rows see of the frames
        self.moved = self.L @ self.frame.Z if len(self.frame.dependent) else self.L
        held = None if proximal is None else abs(self.frame.Z).T @ proximal > 0.0
        if held is not None and soft is not None:
            held[self.frame.dependent] = True  # the places of forces
        motion = self.A @ self.moved
        self.tail = Tail(self.comm, self.gdim, rows, self._N_S, motion, held, whole)
        self.T = self.columns_of(motion)

    def _frame_rows(self, soft: Array | None) -> tuple[csr_matrix, csr_matrix | None]:
        """D, the rows of all ranks that bind the frame alone, and how they give way, the same on
        every rank."""
        own = renumbered(self.W, self.rows.multipliers.mine, self.rows.L.shape[0])
        every = self.comm.allgather(own) if self.comm.allreduce(own.shape[0]) else [own]
        first = sum(W.shape[0] for W in every[: self.comm.rank])
        self._mine_D, self._W_all = slice(first, first + own.shape[0]), below(every)
        give = None if soft is None else self._W_all @ diags(soft) @ self._W_all.T
        return (self._W_all @ self.rows.L).tocsr(), give

    @property
    def nodes(self) -> csr_matrix:
        """(S, S) motion of this rank's surface dofs by what is left of them."""
        return self._N_S

    def bound_parts(self, multiplier: Array) -> Array:
        """(k,) forces of multipliers (rows,) that bind the frame alone."""
        return self._W_all @ multiplier

    def bound(self, multiplier: Array) -> Array:
        """(rows,) part of multipliers (rows,) that binds the frame alone."""
        return self._W_all.T @ self.bound_parts(multiplier)

    def contradicting(self, g: Array, c: float) -> Array:
        """(rows,) forces that gaps g (rows,) of rows which follow from others, and contradict them,
        call for by their compliance: these are no unknowns, as they leave the frame at rest."""
        return self._W_all.T @ self.frame.contradicting(self._W_all @ g, c)

    def columns_of(self, motion: csr_matrix) -> Any:
        """T_S of eliminated dofs that move as (S, m) with the frames: A L of rows that see these
        move as L."""
        tail = self.tail
        local = renumbered(motion, tail.columns, tail.sizes[1])
        if self._N_S.nnz:
            local = local + renumbered(self._N_S, tail.left + tail.first, tail.sizes[1])
        return create_aij(self.comm, self.split.K_SS.getSizes()[0], tail.sizes, local)

    def corner(self, D: csr_matrix, idle: float, test: Any = None) -> Any:
        """Tᵀ K T of the tail, plus D (m, m) at the frames' unknowns, and ``idle`` on the diagonal
        where it has a place without an unknown; with ``test`` the T_S of its rows."""
        tail = self.tail
        if not self.comm.allreduce(bool(D.nnz or tail.idle.any()), op=MPI.LOR):
            return self.split.corner(self.T, None, test)
        D, diagonal = D[tail.mine_used].tocoo(), np.arange(tail.sizes[0])
        value = np.concatenate([D.data, idle * tail.idle])
        row = np.concatenate([tail.seats[D.row], diagonal])
        col = np.concatenate([tail.columns[D.col], diagonal + tail.first])
        local = csr_matrix((value, (row, col)), shape=tail.sizes)
        added = create_aij(self.comm, tail.sizes, tail.sizes, local)
        corner = self.split.corner(self.T, added, test)
        added.destroy()
        return corner

    def reduce(self, D: csr_matrix, idle: float) -> tuple[Any, Any]:
        """The matrix with this ``corner``, as of ``SplitStiffness.scaled``, and its scaling."""
        blocks = *self.split.beside(self.T), self.corner(D, idle)
        matrix, S = self.split.scaled(blocks)
        matrix.setBlockSize(self.gdim)
        return matrix, S

    def penalty(self) -> csr_matrix:
        """(m, m) Zᵀ diag(d) Z of the proximal term."""
        Z = self.frame.Z
        if self.proximal is None:
            return csr_matrix(Z.shape)
        return (Z.T @ Z.multiply(self.proximal[:, None])).tocsr()

    def motion(self, q: Array) -> Array:
        """(n_local,) T q."""
        n = len(self.fixed)
        u = q[:n].copy()
        u[self.split.surface] = times(self.T, q[n:])
        return u

    def load(self, f: Array, u_0: Array, test: Any = None) -> Array:
        """Tᵀ (f - K u_0) for u_0 of ``offsets``; with ``test`` in the place of T_S."""
        S = self.split.surface
        left = f - self.split.columns(u_0[S])
        inside = np.where(self.fixed, 0.0, left)  # u_0 has the values prescribed there
        inside[S] = 0.0
        tail = times(self.T if test is None else test, left[S], transposed=True)
        return np.concatenate([inside, tail])

    def push(self, pull: Array | None, v_0: Array) -> Array:
        """(q_local,) Zᵀ (p - d v_0), the load on q of forces p (m,) on the frames' unknowns, None:
        zero, and of the proximal term."""
        n = len(self.fixed)
        load = np.zeros(n + self.tail.sizes[0])
        if pull is not None or self.proximal is not None:
            pull = self._pull(pull, v_0)
            load[n + self.tail.seats] = pushed(self.frame.Z, pull)[self.tail.mine_used]
        return load

    def _pull(self, pull: Array | None, v: Array) -> Array:
        """(m,) p - d v."""
        pull = np.zeros(len(v)) if pull is None else pull
        return pull if self.proximal is None else pull - self.proximal * v

    def offsets(self, f: Array, g: Array) -> tuple[Array, Array]:
        """This rank's u_0 and all of v_0 for gaps g and the prescribed values in f."""
        v_0 = self.frame.particular(np.concatenate(self.comm.allgather(self.W @ g)))
        u_0 = np.zeros(len(f))
        u_0[self.split.surface] = self.A @ (self.L @ v_0 - g)
        u_0[self.fixed] = f[self.fixed]
        return u_0, v_0

    def frame_motion(self, q: Array, v_0: Array) -> Array:
        """(m,) v on every rank."""
        return self.frame.Z @ self.tail.frame_unknowns(q[len(self.fixed) :]) + v_0

    def frame_law(self, E: csr_matrix, D: csr_matrix, c: float) -> csr_matrix:
        """(m, m) E λ + D v of the frames' unknowns, where they are forces: of rows that bind the
        frame alone; c is the unit of these forces [force / length]."""
        own = c * (E @ self._W_all.T @ csr_matrix(self.frame.Q)).tocoo()
        places = own.row, self.frame.dependent[own.col]
        return (D @ self.frame.Z + csr_matrix((own.data, places), shape=D.shape)).tocsr()

    def frame_multipliers(self, q: Array, c: float) -> Array:
        """(R,) λ of this rank that binds the frame alone, where it is unknown."""
        q_v = self.tail.frame_unknowns(q[len(self.fixed) :])
        force = c * self.frame.Q @ q_v[self.frame.dependent]
        return self.W.T @ force[self._mine_D]

    def forces_alone(self, q: Array) -> Array:
        """(q_local,) the part of q that is forces."""
        forces, places = 0.0 * q, len(self.fixed) + self.tail.seats
        places = places[np.isin(self.tail.mine_used, self.frame.dependent)]
        forces[places] = q[places]
        return forces

    def force_unknowns(self, multiplier: Array, c: float) -> Array:
        """(q_local,) q of multipliers (rows,) that bind the frame alone, where they are unknown."""
        values, at = np.zeros(len(self.tail.columns)), self.frame.dependent
        values[at] = self.frame.Q.T @ self.bound_parts(multiplier) / c
        q = np.zeros(len(self.fixed) + self.tail.sizes[0])
        q[len(self.fixed) + self.tail.seats] = values[self.tail.mine_used]
        return q

    def multipliers(self, force: Array, v: Array, pull: Array | None) -> Array:
        """λ of this rank from the reactions f - K u (S,), zero at fixed dofs. What a row does to
        the frame alone follows from the frame's equilibrium."""
        found = pushed(self.A, force)
        if len(self.frame.dependent):
            missing = self.frame_forces(found, v, pull)[self.frame.dependent]
            found = found - self.W.T @ self.frame.multipliers(missing)[self._mine_D]
        return found

    def frame_forces(self, multiplier: Array, v: Array, pull: Array | None) -> Array:
        """(m,) L_bᵀ λ + p - d v, which must vanish."""
        return self.comm.allreduce(self.L.T @ multiplier) + self._pull(pull, v)

    def unknowns(self, body: Array, frame: Array) -> Array:
        """(q_local, k) q of motions of this rank's dofs (n_local, k) and of the frames (m, k), as
        far as they have places in it: zero at prescribed dofs and idle places."""
        S, n = self.split.surface, len(self.fixed)
        values = np.zeros((n + self.tail.sizes[0], body.shape[1]))
        values[:n] = body
        values[:n][self.fixed] = 0.0
        there = self.tail.left >= 0
        values[n + self.tail.left[there]] = (self._N_S.T @ values[S])[there]
        values[n + self.tail.seats] = frame[self.tail.mine_used]
        values[S] = 0.0
        return values


class Tail:
    """Unknowns of surface nodes that are not eliminated entirely, then those of the frame nodes, in
    blocks of gdim.

    Args:
        N: (S, S) of this rank's surface dofs, what is left of them.
        motion: (R, m) motion of this rank's eliminated dofs by the frame unknowns.
        held: (m,) frame unknowns that a proximal term holds; None: none.
        whole: all have places.

    Attributes:
        left: (S,) places of this rank's surface dofs, -1 where there is none.
        columns: (m,) numbers of all frame unknowns, -1 where one is not used.
        mine_used: this rank's frame unknowns that have places; ``seats`` are these.
        idle: (n_tail,) places without an unknown.
        first: number of this rank's first place.
        sizes: local and global number of places.
        mine_v: this rank's frame unknowns.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        gdim: int,
        rows: EliminatedRows,
        N: csr_matrix,
        motion: csr_matrix,
        held: Array | None,
        whole: bool,
    ) -> None:
        self._comm, frames = comm, rows.frames
        left = np.bincount(N.indices, minlength=N.shape[1]).reshape(-1, gdim)
        kept = left.any(axis=1) | whole
        place = np.cumsum(kept) - 1
        self.left = np.where(kept[:, None], place[:, None] * gdim + np.arange(gdim), -1).ravel()
        used = comm.allreduce(np.bincount(motion.indices, minlength=motion.shape[1])) > 0
        if held is not None:
            used |= held
        used |= whole
        self._number(gdim * int(kept.sum()), gdim, rows, used)
        mine = (frames.owner == comm.rank) & used
        self.mine_used = np.flatnonzero(mine)
        self.seats = self.columns[mine] - self.first
        self.mine_v = frames.mine
        self.idle = np.ones(self.sizes[0], dtype=bool)
        self.idle[self.left[np.unique(N.indices)]] = False
        self.idle[self.seats] = False

    def _number(self, n: int, gdim: int, rows: EliminatedRows, used: Array) -> None:
        """Numbers of the frame unknowns behind n surface dofs of each rank."""
        comm, item = self._comm, rows.items
        count = np.bincount(item)
        first = np.cumsum(count) - count
        there = np.flatnonzero(np.bincount(item, used) > 0)
        there = there[np.argsort(rows.frames.owner[first[there]], kind="stable")]
        owner = rows.frames.owner[first[there]]
        places = -(-count[there] // gdim) * gdim  # whole blocks for each item
        of_rank = np.bincount(owner, places, minlength=comm.size).astype(np.int64)
        nodes = np.array(comm.allgather(n))
        start = np.concatenate([[0], np.cumsum(nodes + of_rank)])
        number = np.full(len(count), -1)
        within = np.cumsum(places) - places - (np.cumsum(of_rank) - of_rank)[owner]
        number[there] = start[owner] + nodes[owner] + within
        within = np.arange(len(item)) - first[item]
        self.columns = np.where(number[item] < 0, -1, number[item] + within)
        self.first = int(start[comm.rank])
        self.sizes = int(start[comm.rank + 1] - start[comm.rank]), int(start[-1])

    def frame_unknowns(self, q: Array) -> Array:
        """(m,) values of all frame unknowns, on every rank, from this rank's places (n_tail,)."""
        values = np.zeros(len(self.columns))
        for place, value in self._comm.allgather((self.mine_used, q[self.seats])):
            values[place] = value
        return values
