"""B and L_b of (31) as PETSc objects, preallocated and distributed, and what is in g.

Rows of B and columns of the multipliers live with the rank that owns the body's node; the frame's
unknowns with the owner of the surface node next to them.
"""

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import bsr_matrix, csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import placed, renumbered
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.interface.obstacle import Swings
from dolfinx_llm.operators.numbering import BodyDofs, Numbering, Rows
from dolfinx_llm.operators.petsc import create_aij


def assemble_B(rows: Rows, dofs: BodyDofs) -> PETSc.Mat:
    """B of (31): one column per surface node and component, the base vector at the node's dofs.
    Rows of prescribed dofs stay empty, since K holds an identity there."""
    mine, multipliers = rows.numbering.mine, rows.numbering
    at = rows.dofs[mine] - dofs.first
    value, cols = np.where(dofs.fixed[at], 0.0, rows.base[mine]), multipliers.number[mine]
    local = placed(value, at, cols[:, None], (dofs.sizes[0], multipliers.sizes[1]))
    return create_aij(dofs.comm, dofs.sizes, multipliers.sizes, local)


def interface_operator(
    pairs: Sequence[ContactPairs],
    directions: Array,
    normals: bool = False,
    swings: Swings | None = None,
) -> csr_matrix:
    """L_b of one frame, on every rank: row (p, i), column (J, k) holds N_J(xi_p) a_i · d_Jk. Rows
    come one side after the other; directions (m, d, gdim) are those in which the frame's nodes
    move.

    Where these are ``normals`` alone, a pair's normal is the mean of the nodes', and the column
    holds N_J / |sum_K N_K n_K|, out of side 1 with the other sign: then translations pass, and
    what balances in L_bᵀ λ has no resultant, however much the nodes' normals differ. Of a rigid
    end, a frame of one node, ``swings`` are added to the directions, pair by pair.
    """
    values, columns, counts = [], [], []
    for side in pairs:
        N, (c, d) = side.N, (side.base.shape[1], directions.shape[1])
        row, col = np.repeat(np.arange(N.shape[0]), np.diff(N.indptr)), N.indices
        if normals:
            own = np.einsum("ni,ni->n", side.base[:, 0], side.N @ directions[:, 0])
            value = 1.0 / own[row, None, None]
        else:
            ways = directions[col] if swings is None else directions[col] + swings.motions[row]
            value = np.einsum("nci,ndi->ncd", side.base[row], ways)  # the same on all ranks
        values.append(value * N.data[:, None, None])
        columns.append(col)
        counts.append(np.diff(N.indptr))
    starts = np.append(0, np.cumsum(np.concatenate(counts)))
    entries = np.concatenate(values), np.concatenate(columns), starts
    found = bsr_matrix(entries, ((len(starts) - 1) * c, N.shape[1] * d)).tocsr()
    found.eliminate_zeros()
    return found


def frame_operator(geometry: InterfaceGeometry) -> csr_matrix:
    """L_b of an interface's frame, or of an obstacle under force, on every rank."""
    g = geometry
    return interface_operator(g.pairs, g.directions, g.normals_alone, g.swings)


def assemble_L_b(
    comm: MPI.Comm, L: csr_matrix, multipliers: Numbering, frames: Numbering
) -> PETSc.Mat:
    """L_b of (31) as PETSc AIJ, from that of all frames in the unknowns' own order."""
    local = renumbered(L[multipliers.mine], frames.number, L.shape[1])
    return create_aij(comm, multipliers.sizes, frames.sizes, local)


def in_rows(pairs: Sequence[ContactPairs], vectors: Sequence[Array]) -> Array:
    """(n,) components of vectors (n, gdim) per side, along the rows' base."""
    sides = zip(pairs, vectors, strict=True)
    return np.concatenate([np.einsum("nci,ni->nc", p.base, g).ravel() for p, g in sides])


def given_gaps(geometries: Sequence[InterfaceGeometry]) -> list[Array]:
    """Per side (n, gdim) its share of the gap that a law asks for."""
    return [
        geometry.interface.law.given_gap / len(geometry.pairs) * side.normal
        for geometry in geometries
        for side in geometry.pairs
    ]
