"""T of the condensed form as a PETSc matrix: u = T q + u_0, v = Z q_v + v_0.

q holds, on each rank, the unknowns of its bodies' nodes and then those of its frame nodes, in
blocks of gdim. Blocks in which nothing is left to solve for, as of tied nodes, are not there.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.operators import create_aij
from dolfinx_llm.slaving import FrameElimination, SlavedRows, eliminate_at_nodes


class Transformation:
    """What the slaved rows make of u and v, with the numbers of the unknowns q.

    Args:
        K: stiffness of the bodies, for its distribution.
        rows: what is slaved to the frames.
        fixed: (n_local,) whether a dof of this rank is prescribed.
        proximal: (m,) stiffness of the frames' unknowns, or None.
    """

    def __init__(self, K, rows: SlavedRows, fixed: np.ndarray, proximal: np.ndarray | None):
        self.comm, self.rows, self.fixed = K.comm.tompi4py(), rows, fixed
        self.gdim, self.proximal = rows.dofs.shape[1], proximal
        dofs, self.vectors = rows.local  # (R, gdim) base vectors of this rank's rows
        self.dofs = dofs - K.getOwnershipRange()[0]  # (R, gdim) local
        node = eliminate_at_nodes(self.dofs, self.vectors, fixed)
        self.A, self.N, self.W = node.A, node.N, node.W
        self.L = rows.L[rows.multipliers.mine]  # rows of this rank
        self.frame = FrameElimination(self._frame_rows())
        self._frame_part = (self.A @ (self.L @ self.frame.Z)).tocsr()  # of u
        self._number()
        self.T = self._assemble(K)

    def _frame_rows(self) -> csr_matrix:
        """D, the rows of all ranks that bind the frame alone, the same on every rank."""
        W = self.W.tocoo()
        count = self.comm.allgather(W.shape[0])
        first = sum(count[: self.comm.rank])
        self._mine_D = slice(first, first + W.shape[0])
        parts = self.comm.allgather((W.data, W.row + first, self.rows.multipliers.mine[W.col]))
        data, row, col = (np.concatenate(part) for part in zip(*parts, strict=True))
        shape = sum(count), self.rows.L.shape[0]
        return (csr_matrix((data, (row, col)), shape=shape) @ self.rows.L).tocsr()

    def _number(self):
        """Places of the unknowns in q: ``body`` (n_local,), -1 where there is none, and of this
        rank's frame unknowns; ``columns`` (m,) are the numbers of all frame unknowns."""
        frames, gdim, comm = self.rows.frames, self.gdim, self.comm
        kept = (np.diff(self.N.tocsc().indptr) > 0).reshape(-1, gdim).any(axis=1)
        place = np.cumsum(kept) - 1
        self.body = np.where(kept[:, None], place[:, None] * gdim + np.arange(gdim), -1).ravel()
        n = gdim * int(kept.sum())

        used = comm.allreduce((np.diff(self._frame_part.tocsc().indptr) > 0).astype(np.int64)) > 0
        self._bodies_hold = used.copy()
        if self.proximal is not None:
            used |= self.frame.Z.T @ self.proximal > 0.0
        bs = self.rows.block
        item_owner = frames.owner[::bs]
        items = np.flatnonzero(used.reshape(-1, bs).any(axis=1))
        items = items[np.argsort(item_owner[items], kind="stable")]
        owner = item_owner[items]
        pad = -(-bs // gdim) * gdim  # whole blocks for each item
        count = np.bincount(owner, minlength=comm.size)
        bodies = np.array(comm.allgather(n))
        start = np.concatenate([[0], np.cumsum(bodies + pad * count)])
        within = np.arange(len(items)) - (np.cumsum(count) - count)[owner]
        number = np.full(len(item_owner), -1)
        number[items] = start[owner] + bodies[owner] + pad * within
        columns = np.where(number[:, None] < 0, -1, number[:, None] + np.arange(bs))
        self.columns = columns.ravel()
        self.first = int(start[comm.rank])
        self.sizes = int(start[comm.rank + 1] - start[comm.rank]), int(start[-1])
        mine = (frames.owner == comm.rank) & used
        self.mine_used = np.flatnonzero(mine)  # this rank's frame unknowns that are in q
        self.seats = self.columns[mine] - self.first
        self.mine_v = frames.mine

    def _assemble(self, K):
        """T: rows as of K, columns as of q.

        Places in q without an unknown hold a stored zero, so that Tᵀ K T has a place for ones on
        its diagonal.
        """
        body, frame, n = self.N.tocoo(), self._frame_part.tocoo(), len(self.fixed)
        self.idle = np.ones(self.sizes[0], dtype=bool)
        self.idle[self.body[body.col]] = False
        self.idle[self.seats] = False
        zero = self.idle.copy()
        zero[self.seats] = ~self._bodies_hold[self.mine_used]  # only a proximal term stands there
        zero = np.flatnonzero(zero)
        host = np.full(self.sizes[0], -1)  # a row to hold it: the dof's own, or one nearby
        host[self.body[self.body >= 0]] = np.flatnonzero(self.body >= 0)
        surface = np.unique(self.dofs) if len(self.dofs) else np.arange(n)
        host = np.where(host[zero] < 0, np.resize(surface, len(zero)), host[zero])
        value = np.concatenate([body.data, frame.data, np.zeros(len(zero))])
        row = np.concatenate([body.row, frame.row, host])
        col = [self.body[body.col] + self.first, self.columns[frame.col], zero + self.first]
        local = csr_matrix((value, (row, np.concatenate(col))), shape=(n, self.sizes[1]))
        return create_aij(K.comm, K.getSizes()[0], self.sizes, local, self.gdim)

    def penalty(self, comm):
        """Zᵀ diag(d) Z of the proximal term, in the numbering of q; None without one."""
        if self.proximal is None:
            return None
        Z = self.frame.Z
        P = (Z.T @ Z.multiply(self.proximal[:, None])).tocsr()[self.mine_used].tocoo()
        local = (P.data, (self.seats[P.row], self.columns[P.col]))
        return create_aij(comm, self.sizes, self.sizes, csr_matrix(local, shape=self.sizes), 1)

    def push(self, centre, v_0: np.ndarray) -> np.ndarray:
        """Zᵀ d (c - v_0), the load of the proximal term on q."""
        load = np.zeros(self.sizes[0])
        if self.proximal is not None:
            pull = self.proximal * ((0.0 if centre is None else centre) - v_0)
            load[self.seats] = (self.frame.Z.T @ pull)[self.mine_used]
        return load

    def offsets(self, f: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """This rank's u_0 and all of v_0 for gaps g and the prescribed values in f."""
        v_0 = self.frame.particular(np.concatenate(self.comm.allgather(self.W @ g)))
        u_0 = self.A @ (self.L @ v_0 - g)
        u_0[self.fixed] = f[self.fixed]
        return u_0, v_0

    def frame_motion(self, q: np.ndarray, v_0: np.ndarray) -> np.ndarray:
        """(m,) v on every rank."""
        parts = self.comm.allgather((self.mine_used, q[self.seats]))
        q_v = np.zeros(len(v_0))
        for place, value in parts:
            q_v[place] = value
        return self.frame.Z @ q_v + v_0

    def multipliers(self, force: np.ndarray, v: np.ndarray, centre) -> np.ndarray:
        """λ of this rank from the reactions f - K u, zero at fixed dofs.

        What a row does to the frame alone follows from the frame's equilibrium.
        """
        found = self.A.T @ force
        if len(self.frame.dependent):
            missing = self.frame_forces(found, v, centre)[self.frame.dependent]
            found = found - self.W.T @ self.frame.multipliers(missing)[self._mine_D]
        return found

    def frame_forces(self, multiplier: np.ndarray, v: np.ndarray, centre) -> np.ndarray:
        """(m,) L_bᵀ λ less the proximal forces d (v - c), which must vanish."""
        forces = self.comm.allreduce(self.L.T @ multiplier)
        if self.proximal is not None:
            forces -= self.proximal * (v - (0.0 if centre is None else centre))
        return forces

    def modes(self, body: np.ndarray, frame: np.ndarray) -> np.ndarray:
        """Rigid modes of q, zero where there is none: at prescribed dofs and idle places."""
        values = np.zeros((self.sizes[0], body.shape[1]))
        there = self.body >= 0
        values[self.body[there]] = (self.N.T @ np.where(self.fixed[:, None], 0.0, body))[there]
        values[self.seats] = frame[self.mine_used]
        return values

    def residual(self, u, multiplier, v, g, force):
        """What (31) leaves of -f + K u + B λ at this rank's dofs, and of Bᵀ u - L_b v + g.

        Args:
            force: (n_local,) f - K u.
        """
        vectors = self.vectors * ~self.fixed[self.dofs]
        left = -force
        np.add.at(left, self.dofs, vectors * multiplier[:, None])
        return left, np.einsum("ri,ri->r", vectors, u[self.dofs]) - self.L @ v + g
