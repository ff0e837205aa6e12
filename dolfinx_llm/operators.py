"""B, L_b and g of (31) as PETSc objects, preallocated and distributed.

Rows of B and columns of the multipliers live with the rank that owns the body's node; the frame's
unknowns with the owner of the surface node next to them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.linalg import qr
from scipy.sparse import csr_matrix, vstack
from scipy.spatial import cKDTree

if TYPE_CHECKING:
    from dolfinx_llm.pairs import ContactPairs


@dataclass(frozen=True)
class Numbering:
    """Global PETSc numbers of unknowns known to every rank: by owner, then in their own order."""

    owner: np.ndarray  # (n,) rank that owns each unknown
    rank: int

    @cached_property
    def number(self) -> np.ndarray:
        """(n,) global number of each unknown."""
        number = np.empty(len(self.owner), dtype=np.int64)
        number[np.argsort(self.owner, kind="stable")] = np.arange(len(self.owner))
        return number

    @cached_property
    def mine(self) -> np.ndarray:
        """This rank's unknowns, in the order of their numbers."""
        return np.flatnonzero(self.owner == self.rank)

    @property
    def sizes(self) -> tuple[int, int]:
        """Local and global number of unknowns."""
        return len(self.mine), len(self.owner)


@dataclass(frozen=True)
class Rows:
    """The multipliers of several sides, one after the other: pair by pair, base by base vector."""

    base: np.ndarray  # (n, gdim) base vector of each
    dofs: np.ndarray  # (n, gdim) numbers of its node's dofs in the vector of all bodies
    numbering: Numbering

    @classmethod
    def of(cls, comm: MPI.Comm, pairs: Sequence[ContactPairs], dofs: Sequence[np.ndarray]) -> Rows:
        """Rows of sides whose nodes' dofs are given, per side (n, gdim)."""
        counts = [p.base.shape[1] for p in pairs]
        owner = [np.repeat(p.owner, c) for p, c in zip(pairs, counts)]
        gdim = pairs[0].base.shape[2]
        return cls(
            np.concatenate([p.base.reshape(-1, gdim) for p in pairs]),
            np.concatenate([np.repeat(d, c, axis=0) for d, c in zip(dofs, counts)]),
            Numbering(np.concatenate(owner), comm.rank),
        )


def frame_numbering(models: Sequence[Any], comm: MPI.Comm) -> Numbering:
    """Numbers of the frame unknowns, d per node; they live with the nearest surface node."""
    owners = [np.empty(0, dtype=np.int64)]
    for model in models:
        if model.frame is not None:
            x = np.concatenate([side.x for side in model.pairs])
            owner = np.concatenate([side.owner for side in model.pairs])
            nearest = owner[cKDTree(x).query(model.frame.x)[1]]
            owners.append(np.repeat(nearest, model.directions.shape[1]))
    return Numbering(np.concatenate(owners), comm.rank)


def slip_numbering(models: Sequence[Any], frames: Numbering) -> Numbering:
    """Numbers of frame unknowns followed by slip unknowns κ, which live with their frame node (with
    their surface node against a rigid obstacle)."""
    owners, first = [frames.owner], 0
    for model in models:
        m, d, gdim = model.directions.shape
        at = frames.owner[first : first + m * d : max(d, 1)]
        first += m * d
        if model.interface.law.friction:
            at = model.pairs[0].owner if model.frame is None else at
            owners.append(np.repeat(at, gdim - 1))
    return Numbering(np.concatenate(owners), frames.rank)


def create_aij(
    comm: MPI.Comm, rows: tuple[int, int], cols: tuple[int, int], local: csr_matrix, bs: int = 1
) -> PETSc.Mat:
    """AIJ from this rank's rows; CSR fixes the preallocation exactly."""
    local.sort_indices()
    csr = (local.indptr.astype(PETSc.IntType), local.indices.astype(PETSc.IntType), local.data)
    matrix = PETSc.Mat().createAIJ(size=(rows, cols), bsize=bs, csr=csr, comm=comm)
    matrix.assemble()
    return matrix


def assemble_B(
    comm: MPI.Comm, rows: Rows, bodies: tuple[tuple[int, int], int], fixed: np.ndarray
) -> PETSc.Mat:
    """B of (31): one column per surface node and component, the base vector at the node's dofs.

    Args:
        comm: MPI communicator.
        rows: the multipliers.
        bodies: local and global number of the bodies' dofs, and this rank's first one.
        fixed: (n_local,) whether a Dirichlet condition prescribes a dof of this rank; its row of B
            stays empty, since K holds an identity row there.
    """
    (n_local, n_global), start = bodies
    mine, multipliers = rows.numbering.mine, rows.numbering
    value, at = rows.base[mine], rows.dofs[mine] - start
    cols = np.broadcast_to(multipliers.number[mine][:, None], value.shape)
    keep = (value != 0.0) & ~fixed[at]
    local = csr_matrix((value[keep], (at[keep], cols[keep])), (n_local, multipliers.sizes[1]))
    return create_aij(comm, (n_local, n_global), multipliers.sizes, local)


def interface_operator(pairs: Sequence[ContactPairs], directions: np.ndarray) -> csr_matrix:
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


def prescribed_rows(
    L: csr_matrix, prescribed: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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


def assemble_L_b(
    comm: MPI.Comm, L: csr_matrix, multipliers: Numbering, frames: Numbering
) -> PETSc.Mat:
    """L_b of (31) as PETSc AIJ.

    Args:
        comm: MPI communicator.
        L: the operator of all frames in the unknowns' own order (``interface_operator``).
        multipliers: numbers of the rows.
        frames: numbers of the columns.
    """
    local = L[multipliers.mine].tocoo()
    local = csr_matrix((local.data, (local.row, frames.number[local.col])), shape=local.shape)
    return create_aij(comm, multipliers.sizes, frames.sizes, local)


def assemble_gap(
    comm: MPI.Comm,
    pairs: Sequence[ContactPairs],
    multipliers: Numbering,
    gaps: Sequence[np.ndarray],
) -> PETSc.Vec:
    """g of (31): a_i · (X_p - sum_J N_J Y_J) per multiplier, from the given (n, gdim) gaps."""
    value = [np.einsum("nci,ni->nc", p.base, g).ravel() for p, g in zip(pairs, gaps)]
    g = PETSc.Vec().createMPI(multipliers.sizes, comm=comm)
    g.array_w[:] = np.concatenate(value)[multipliers.mine]
    return g
