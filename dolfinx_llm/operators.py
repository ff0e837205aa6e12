"""B, L_b and g of (31) as PETSc objects, preallocated and distributed.

Rows of B and columns of the multipliers live with the rank that owns the body's node; the frame's
unknowns with the owner of the surface node next to them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from petsc4py import PETSc
from scipy.linalg import qr
from scipy.sparse import csr_matrix, vstack
from scipy.spatial import cKDTree


@dataclass(frozen=True)
class Numbering:
    """Global PETSc numbers of items known to every rank: by owner, then in their own order."""

    owner: np.ndarray  # (n,) rank that owns each item
    rank: int
    bs: int  # unknowns per item

    @cached_property
    def number(self) -> np.ndarray:
        """(n,) global number of each item."""
        number = np.empty(len(self.owner), dtype=np.int64)
        number[np.argsort(self.owner, kind="stable")] = np.arange(len(self.owner))
        return number

    @cached_property
    def mine(self) -> np.ndarray:
        """Items of this rank, in the order of their numbers."""
        return np.flatnonzero(self.owner == self.rank)

    @property
    def sizes(self) -> tuple[int, int]:
        """Local and global number of unknowns."""
        return len(self.mine) * self.bs, len(self.owner) * self.bs

    def unknowns(self, items: np.ndarray) -> np.ndarray:
        """(k, bs) global numbers of the unknowns of items."""
        return self.number[items][:, None] * self.bs + np.arange(self.bs)


def multiplier_numbering(pairs, comm) -> Numbering:
    """Numbers of the multipliers of several sides, one after the other."""
    return Numbering(np.concatenate([p.owner for p in pairs]), comm.rank, pairs[0].base.shape[1])


def frame_numbering(frames, pairs, comm, bs: int) -> Numbering:
    """Numbers of the frame unknowns; ``pairs`` holds two sides per frame."""
    owners = []
    for frame, sides in zip(frames, zip(pairs[::2], pairs[1::2])):
        x = np.concatenate([side.x for side in sides])
        owner = np.concatenate([side.owner for side in sides])
        owners.append(owner[cKDTree(x).query(frame.x)[1]])
    return Numbering(np.concatenate(owners), comm.rank, bs)


def create_aij(
    comm, rows: tuple[int, int], cols: tuple[int, int], local: csr_matrix, bs: int = 1
) -> PETSc.Mat:
    """AIJ from this rank's rows; CSR fixes the preallocation exactly."""
    local.sort_indices()
    csr = (local.indptr.astype(PETSc.IntType), local.indices.astype(PETSc.IntType), local.data)
    matrix = PETSc.Mat().createAIJ(size=(rows, cols), bsize=bs, csr=csr, comm=comm)
    matrix.assemble()
    return matrix


def assemble_B(comm, pairs, dofs, multipliers: Numbering, bodies, fixed: np.ndarray) -> PETSc.Mat:
    """B of (31): one column per surface node and component, the base vector at the node's dofs.

    Args:
        comm: MPI communicator.
        pairs: sides, in the order of ``multipliers``.
        dofs: per side (n, gdim) numbers of the nodes' dofs in the vector of all bodies.
        multipliers: numbers of the multipliers.
        bodies: local and global number of the bodies' dofs, and this rank's first one.
        fixed: (n_local,) whether a Dirichlet condition prescribes a dof of this rank; its row of B
            stays empty, since K holds an identity row there.
    """
    (n_local, n_global), start = bodies
    row = np.concatenate(dofs)  # (n, gdim)
    base = np.concatenate([p.base for p in pairs])  # (n, c, gdim)
    mine = multipliers.mine
    columns = multipliers.unknowns(mine)
    value = base[mine]
    rows = np.broadcast_to((row[mine] - start)[:, None, :], value.shape)
    cols = np.broadcast_to(columns[:, :, None], value.shape)
    keep = (value != 0.0) & ~fixed[rows]
    local = csr_matrix(
        (value[keep], (rows[keep], cols[keep])), shape=(n_local, multipliers.sizes[1])
    )
    return create_aij(comm, (n_local, n_global), multipliers.sizes, local)


def interface_operator(pairs, directions) -> csr_matrix:
    """L_b of one frame, on every rank: row (p, i), column (J, k) holds N_J(xi_p) a_i · d_Jk.

    Args:
        pairs: the sides, c base vectors per pair; their rows come one side after the other.
        directions: (m, d, gdim) directions in which the frame's nodes move.
    """
    blocks = []
    for side in pairs:
        N = side.N.tocoo()
        c, d = side.base.shape[1], directions.shape[1]
        value = np.einsum("nci,ndi->ncd", side.base[N.row], directions[N.col])
        value *= N.data[:, None, None]
        row = np.broadcast_to((N.row[:, None] * c + np.arange(c))[:, :, None], value.shape)
        col = np.broadcast_to((N.col[:, None] * d + np.arange(d))[:, None, :], value.shape)
        keep = value != 0.0
        shape = (N.shape[0] * c, N.shape[1] * d)
        blocks.append(csr_matrix((value[keep], (row[keep], col[keep])), shape=shape))
    return vstack(blocks, format="csr")


def prescribed_rows(L: csr_matrix, prescribed: np.ndarray):
    """Which rows of L_b hold prescribed dofs, and which of them say nothing new.

    Where both bodies have prescribed dofs on the contact surface (a symmetry plane through it),
    these rows bind the frame alone, and more of them than the frame has nodes there. Those that
    follow from the others must go, or (31) is singular in λ.

    Args:
        L: L_b of one frame.
        prescribed: (n_rows,) whether the body's dof of a row is prescribed.

    Returns:
        rows (k,) of prescribed dofs; basis (k, r) of their column space, with which the multipliers
        of least size are basis basisᵀ λ; redundant rows (k - r,).
    """
    rows = np.flatnonzero(prescribed)
    D = L[rows]
    D = D[:, np.unique(D.indices)].toarray()
    if not D.size:
        return rows, np.zeros((len(rows), 0)), rows
    basis, size, _ = np.linalg.svd(D, full_matrices=False)
    basis = basis[:, size > 1e-8 * size[0]]
    pivots = qr(basis.T, mode="r", pivoting=True)[1]
    return rows, basis, rows[np.sort(pivots[basis.shape[1] :])]


def assemble_L_b(comm, L: csr_matrix, multipliers: Numbering, frames: Numbering) -> PETSc.Mat:
    """L_b of (31) as PETSc AIJ.

    Args:
        comm: MPI communicator.
        L: the operator of all frames in the items' own order (``interface_operator``).
        multipliers: numbers of the rows.
        frames: numbers of the columns.
    """
    rows = (multipliers.mine[:, None] * multipliers.bs + np.arange(multipliers.bs)).ravel()
    local = L[rows].tocoo()
    number = frames.unknowns(np.arange(len(frames.owner))).ravel()
    local = csr_matrix((local.data, (local.row, number[local.col])), shape=local.shape)
    return create_aij(comm, multipliers.sizes, frames.sizes, local)


def assemble_gap(comm, pairs, multipliers: Numbering, gaps) -> PETSc.Vec:
    """g of (31): a_i · (X_p - sum_J N_J Y_J) per multiplier, from the given (n, gdim) gaps."""
    value = np.concatenate([np.einsum("nci,ni->nc", p.base, g) for p, g in zip(pairs, gaps)])
    g = PETSc.Vec().createMPI(multipliers.sizes, comm=comm)
    g.array_w[:] = value[multipliers.mine].ravel()
    return g
