"""Products, nests, springs and sizes of PETSc matrices."""

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array

SYMMETRY = "dolfinx_llm_symmetric"  # attribute of a matrix: its state, and whether it was so then
OVERSIZE = 1e4  # largest row over its diagonal entry, about, up to which that tells how large it is
PROBES = 8  # products that tell how large a row is, to a factor of 10 for all of 10^7 rows


def create_aij(
    comm: MPI.Comm, rows: tuple[int, int], cols: tuple[int, int], local: csr_matrix
) -> PETSc.Mat:
    """AIJ from this rank's rows; CSR fixes the preallocation exactly."""
    local.sort_indices()
    csr = (local.indptr.astype(PETSc.IntType), local.indices.astype(PETSc.IntType), local.data)
    matrix = PETSc.Mat().createAIJ(size=(rows, cols), csr=csr, comm=comm)
    matrix.assemble()
    return matrix


def with_springs(K: PETSc.Mat, at: Sequence[int], stiffness: Array) -> PETSc.Mat:
    """Copy of K with springs at local dofs: stiffness[i] is added to their diagonal entries."""
    held, start = K.copy(), K.getOwnershipRange()[0]
    for i in at:
        held.setValue(start + i, start + i, stiffness[i], addv=True)
    held.assemble()
    return held


def times(M: PETSc.Mat, x: Array, transposed: bool = False) -> Array:
    """This rank's part of M x or Mᵀ x."""
    right, left = M.createVecs()
    source, target = (left, right) if transposed else (right, left)
    source.array_w[:] = x
    (M.multTranspose if transposed else M.mult)(source, target)
    values = target.array_r.copy()
    right.destroy()
    left.destroy()
    return values


def products(M: PETSc.Mat, X: Array) -> Array:
    """(n_local, k) this rank's part of M X, for that of X (m_local, k): of all columns at once, for
    which M is read once."""
    if not X.shape[1]:
        return np.zeros((M.getLocalSize()[0], 0))
    sizes = (M.getSizes()[1], (PETSc.DECIDE, X.shape[1]))
    dense = PETSc.Mat().createDense(sizes, array=np.asfortranarray(X), comm=M.comm)
    dense.assemble()
    product = M.matMult(dense)
    found: Array = product.getDenseArray().copy()
    for item in (dense, product):
        item.destroy()
    return found


def local_csr(M: PETSc.Mat) -> csr_matrix:
    """This rank's rows of a matrix, all columns."""
    indptr, indices, data = M.getValuesCSR()
    return csr_matrix((data, indices, indptr), (len(indptr) - 1, M.getSize()[1]))


def diagonal_of(K: PETSc.Mat) -> Array:
    """This rank's diagonal entries of K."""
    diagonal = K.getDiagonal()
    values = diagonal.array_r.copy()
    diagonal.destroy()
    return values


def join_blocks(blocks: Sequence[Sequence[PETSc.Mat | None]]) -> tuple[PETSc.Mat, list[Array]]:
    """AIJ from a nest of blocks, and this rank's rows of each block row: the nest interleaves the
    blocks by rank."""
    comm = next(M.comm for M in blocks[0] if M is not None)
    nest = PETSc.Mat().createNest(blocks, comm=comm)
    matrix = nest.convert("aij", PETSc.Mat())
    start = matrix.getOwnershipRange()[0]
    rows = [block.getIndices() - start for block in nest.getNestISs()[0]]
    nest.destroy()
    return matrix, rows


def block_diagonal(blocks: Sequence[PETSc.Mat]) -> PETSc.Mat:
    """AIJ of blocks, which are used up; a single one is handed on."""
    if len(blocks) == 1:
        return blocks[0]
    n = len(blocks)
    rows = [[blocks[i] if i == j else None for j in range(n)] for i in range(n)]
    matrix, _ = join_blocks(rows)
    for M in blocks:
        M.destroy()
    return matrix


def same_entries(K: PETSc.Mat, M: PETSc.Mat) -> bool:
    """Whether two AIJ matrices of the same sizes store the same entries; collective."""
    alike = all(map(np.array_equal, K.getValuesCSR()[:2], M.getValuesCSR()[:2]))
    return bool(K.comm.tompi4py().allreduce(alike, op=MPI.LAND))


def is_symmetric(K: PETSc.Mat, diagonal: Array | None = None) -> bool:
    """Whether xᵀKy = yᵀKx for two random vectors, where rows are as large as each other: those of
    other units would hide the rest. How large they are the diagonal (n_local,) tells, or else
    products with random signs, so that no entry is copied. K keeps the answer as long as its
    entries stay."""
    comm, n = K.comm.tompi4py(), K.getLocalSize()[0]
    state, known = K.stateGet(), K.getAttr(SYMMETRY)
    if comm.allreduce(known is not None and known[0] == state, op=MPI.LAND):
        return bool(known[1])
    rng = np.random.default_rng(2001 + comm.rank)
    v, w = rng.standard_normal((2, n))

    def scaled(size: Array) -> tuple[Array, Array]:
        """K v and K w with rows and columns divided by the roots of their sizes."""
        scale = 1.0 / np.sqrt(np.where(size > 0.0, size, 1.0))
        return scale * times(K, scale * v), scale * times(K, scale * w)

    size = diagonal_of(K) if diagonal is None else diagonal
    told = comm.allreduce(bool((size > 0.0).all()), op=MPI.LAND)
    if told:  # of a positive definite matrix no row is much larger than its diagonal entry then
        Kv, Kw = scaled(size)
        largest = max(np.abs(Kv).max(initial=0.0), np.abs(Kw).max(initial=0.0))
        told = comm.allreduce(bool(largest < OVERSIZE), op=MPI.LAND)
    if not told:
        size = np.sqrt(sum(times(K, rng.choice((-1.0, 1.0), n)) ** 2 for _ in range(PROBES)))
        Kv, Kw = scaled(size)
    mine = np.array([v @ Kw, w @ Kv, Kv @ Kv, w @ w])
    across, back, of_product, of_vector = comm.allreduce(mine)
    symmetric = bool(abs(across - back) <= 1e-10 * np.sqrt(of_product * of_vector))
    K.setAttr(SYMMETRY, (state, symmetric))
    return symmetric
