"""Places of what the surfaces have left to solve for, behind the dofs of the bodies."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from scipy.sparse import csr_matrix

from dolfinx_llm.forms.condensed.elimination import EliminatedRows


class Tail:
    """Unknowns of surface nodes that are not eliminated entirely, then those of the frame nodes, in
    blocks of gdim.

    Args:
        N: (S, S) of this rank's surface dofs, what is left of them.
        motion: (R, m) motion of this rank's eliminated dofs by the frame unknowns.
        held: (m,) frame unknowns that a proximal term holds; None: none.

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
        held: np.ndarray | None,
    ) -> None:
        self._comm, frames = comm, rows.frames
        kept = (np.diff(N.tocsc().indptr) > 0).reshape(-1, gdim).any(axis=1)
        place = np.cumsum(kept) - 1
        self.left = np.where(kept[:, None], place[:, None] * gdim + np.arange(gdim), -1).ravel()
        used = comm.allreduce((np.diff(motion.tocsc().indptr) > 0).astype(np.int64)) > 0
        if held is not None:
            used |= held
        self._number(gdim * int(kept.sum()), gdim, rows, used)
        mine = (frames.owner == comm.rank) & used
        self.mine_used = np.flatnonzero(mine)
        self.seats = self.columns[mine] - self.first
        self.mine_v = frames.mine
        self.idle = np.ones(self.sizes[0], dtype=bool)
        self.idle[self.left[np.unique(N.indices)]] = False
        self.idle[self.seats] = False

    def _number(self, n: int, gdim: int, rows: EliminatedRows, used: np.ndarray) -> None:
        """Numbers of the frame unknowns behind n surface dofs of each rank."""
        comm, bs = self._comm, rows.block
        item_owner = rows.frames.owner[::bs]
        items = np.flatnonzero(used.reshape(-1, bs).any(axis=1))
        items = items[np.argsort(item_owner[items], kind="stable")]
        owner = item_owner[items]
        pad = -(-bs // gdim) * gdim  # whole blocks for each item
        count = np.bincount(owner, minlength=comm.size)
        nodes = np.array(comm.allgather(n))
        start = np.concatenate([[0], np.cumsum(nodes + pad * count)])
        within = np.arange(len(items)) - (np.cumsum(count) - count)[owner]
        number = np.full(len(item_owner), -1)
        number[items] = start[owner] + nodes[owner] + pad * within
        columns = np.where(number[:, None] < 0, -1, number[:, None] + np.arange(bs))
        self.columns = columns.ravel()
        self.first = int(start[comm.rank])
        self.sizes = int(start[comm.rank + 1] - start[comm.rank]), int(start[-1])

    def frame_unknowns(self, q: np.ndarray) -> np.ndarray:
        """(m,) values of all frame unknowns, on every rank, from this rank's places (n_tail,)."""
        values = np.zeros(len(self.columns))
        for place, value in self._comm.allgather((self.mine_used, q[self.seats])):
            values[place] = value
        return values
