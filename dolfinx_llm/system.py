"""The frame-augmented system (31) or the classical one (6), solved with PETSc's MUMPS."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from dolfinx_llm._parallel import ContactError

# Richardson on top of the factorisation is iterative refinement on any number of ranks: MUMPS's
# own works on one rank only. ICNTL(24): null pivots.
SADDLE_OPTIONS = {
    "ksp_type": "richardson",
    "ksp_max_it": 2,
    "ksp_norm_type": "none",
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_24": 1,
    "mat_mumps_icntl_12": 2,  # ordering of symmetric indefinite matrices by pairs of unknowns
}


class DirectSolver:
    """A matrix factorised by MUMPS; solves are refined.

    Args:
        matrix: PETSc AIJ.
        prefix: of the PETSc options.
        options: PETSc options on top of ``SADDLE_OPTIONS``.
        own: destroy the matrix with the solver.

    Raises:
        ContactError: MUMPS could not factorise.
    """

    def __init__(self, matrix, prefix: str, options: dict | None = None, own: bool = False):
        self.matrix, self._own = matrix, own
        self.symmetric = is_symmetric(matrix)
        self.solution, self.rhs = matrix.createVecs()
        self.ksp = self._factorise(prefix, options or {})

    def _factorise(self, prefix: str, options: dict):
        """Set up and factorise, with more spare memory where delayed pivots outgrow it."""
        if self.symmetric:
            self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        for spare in (80, 400, 2000):
            chosen = {
                **SADDLE_OPTIONS,
                "mat_mumps_icntl_14": spare,
                "pc_type": "cholesky" if self.symmetric else "lu",
                **options,
            }
            ksp = set_up_ksp(self.matrix, prefix, chosen)
            self.infog = mumps_infog(ksp)
            if self.infog.get(1, 0) not in (-8, -9):
                break
            ksp.destroy()
        if self.infog.get(1, 0) < 0:
            raise ContactError(
                f"MUMPS could not factorise the system: INFOG(1) = {self.infog[1]}, INFOG(2) = "
                f"{self.infog[2]}. -9: raise petsc_options mat_mumps_icntl_14; -10: the matrix is "
                "singular, a body or the frame is not held; -13: out of memory"
            )
        return ksp

    def solve(self, b: np.ndarray) -> np.ndarray:
        """This rank's part of the solution for its part of a load."""
        self.rhs.array_w[:] = b
        self.ksp.solve(self.rhs, self.solution)
        return self.solution.array_r.copy()

    def solve_many(self, b: np.ndarray) -> np.ndarray:
        """The same for several loads, the columns of b (n_local, k), without refinement."""
        comm, k = self.matrix.comm, b.shape[1]
        sizes = (self.matrix.getSizes()[0], (PETSc.DECIDE, k))
        loads = PETSc.Mat().createDense(sizes, array=np.asfortranarray(b), comm=comm)
        loads.assemble()
        found = loads.duplicate()
        found.assemble()
        self.ksp.getPC().getFactorMatrix().matSolve(loads, found)
        x = found.getDenseArray().copy()
        loads.destroy()
        found.destroy()
        return x

    def destroy(self):
        for item in (self.ksp, self.solution, self.rhs, *([self.matrix] * self._own)):
            item.destroy()


def set_up_ksp(matrix, prefix: str, chosen: dict):
    """A KSP with these options, which do not stay in PETSc's global database."""
    ksp = PETSc.KSP().create(matrix.comm)
    ksp.setOperators(matrix)
    ksp.setOptionsPrefix(prefix)
    database = PETSc.Options()
    added = [prefix + key for key in chosen if not database.hasName(prefix + key)]
    for key in added:
        database[key] = chosen[key[len(prefix) :]]
    try:
        ksp.setFromOptions()
        ksp.setUp()
    finally:
        for key in added:
            database.delValue(key)
    return ksp


class SaddleSystem:
    """Factorised block matrix of (31) with λ scaled by a stiffness, so that units vanish.

    Args:
        K: stiffness of the bodies with Dirichlet conditions applied.
        B: (31).
        L_b: (31), or None without frame unknowns: (6), with B = Qᵀ.
        scale: mean diagonal of K on the surface dofs [force / length].
        prefix: of the PETSc options.
        options: PETSc options on top of ``SADDLE_OPTIONS``.
    """

    def __init__(self, K, B, L_b, scale: float, prefix: str, options: dict | None = None):
        self.scale = scale
        self.K = K
        B_t = B.copy()
        B_t.transpose()
        sB, sB_t = self._scaled(B, scale), self._scaled(B_t, scale)
        # PETSc hands MUMPS the upper triangle from each row's stored diagonal on: on several ranks
        # rows without one lose entries.
        zero_l = _stored_zero_diagonal(B.getSizes()[1], K.comm)
        blocks, parts = [[K, sB], [sB_t, zero_l]], [B_t, sB, sB_t, zero_l]
        if L_b is not None:
            L_t = L_b.copy()
            L_t.transpose()
            sL, sL_t = self._scaled(L_b, -scale), self._scaled(L_t, -scale)
            zero_v = _stored_zero_diagonal(L_b.getSizes()[1], K.comm)
            blocks = [[K, sB, None], [sB_t, zero_l, sL], [None, sL_t, zero_v]]
            parts += [L_t, sL, sL_t, zero_v]
        self.matrix, self.rows = join_blocks(blocks)
        for M in parts:
            M.destroy()
        self._solver = DirectSolver(self.matrix, prefix, options, own=True)

    @staticmethod
    def _scaled(M, factor):
        M = M.copy()
        M.scale(factor)
        return M

    def solve(self, f: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """This rank's parts of u, λ, v for loads f and gaps g; v is empty without L_b.

        Raises:
            ContactError: the factorisation failed or the residual is not small.
        """
        rows_u, rows_l = self.rows[:2]
        rhs = np.zeros(self.matrix.getLocalSize()[0])
        rhs[rows_u], rhs[rows_l] = f, -self.scale * g
        solution = self._solver.solve(rhs)
        self._check_solution()
        u, multiplier, *v = (solution[rows] for rows in self.rows)
        diagonal = self.K.getDiagonal()
        forces = self.scale * multiplier
        comm = self.K.comm.tompi4py()
        self.rounding = rounding_error(comm, diagonal.array_r, u, f, forces)
        diagonal.destroy()
        return u, self.scale * multiplier, v[0] if v else np.empty(0)

    def _check_solution(self):
        """Require a small residual, against the sizes of the unknowns and against the load.

        The second holds off runaway multipliers of a singular system, which the first would let
        pass.
        """
        infinity = PETSc.NormType.NORM_INFINITY
        rhs, solution = self._solver.rhs, self._solver.solution
        residual = rhs.duplicate()
        self.matrix.mult(solution, residual)
        size = max(residual.norm(infinity), self.scale * solution.norm(infinity))
        residual.aypx(-1.0, rhs)
        miss, load = residual.norm(infinity), rhs.norm(infinity)
        residual.destroy()
        self.residual = miss / max(size, load, 1e-300)
        against_load = miss / load if load > 0.0 else self.residual
        reason = self._solver.ksp.getConvergedReason()
        if reason < 0 or not (self.residual < 1e-9 and against_load < 1e-6):
            raise ContactError(
                f"the solve failed: residual {self.residual:.1e} of the unknowns' size (allowed "
                f"1e-9), {against_load:.1e} of the load's (allowed 1e-6), PETSc's reason {reason}, "
                f"MUMPS {self._solver.infog}. Check supports, material data and the petsc_options "
                "given"
            )

    def destroy(self):
        self._solver.destroy()


def with_springs(K, at, stiffness):
    """Copy of K with springs at local dofs: stiffness[i] is added to their diagonal entries."""
    held, start = K.copy(), K.getOwnershipRange()[0]
    for i in at:
        held.setValue(start + i, start + i, stiffness[i], addv=True)
    held.assemble()
    return held


def times(M, x: np.ndarray, transposed: bool = False) -> np.ndarray:
    """This rank's part of M x or Mᵀ x."""
    right, left = M.createVecs()
    source, target = (left, right) if transposed else (right, left)
    source.array_w[:] = x
    (M.multTranspose if transposed else M.mult)(source, target)
    values = target.array_r.copy()
    right.destroy()
    left.destroy()
    return values


def join_blocks(blocks):
    """AIJ from a nest of blocks, and this rank's rows of each block row: the nest interleaves the
    blocks by rank."""
    nest = PETSc.Mat().createNest(blocks)
    matrix = nest.convert("aij", PETSc.Mat())
    start = matrix.getOwnershipRange()[0]
    rows = [block.getIndices() - start for block in nest.getNestISs()[0]]
    nest.destroy()
    return matrix, rows


def mumps_infog(ksp) -> dict[int, int]:
    """MUMPS's INFOG(1), (2): error; (12): negative pivots; (28): null pivots."""
    if ksp.getPC().getFactorSolverType() != "mumps":
        return {}
    factor = ksp.getPC().getFactorMatrix()
    return {i: factor.getMumpsInfog(i) for i in (1, 2, 12, 28)}


def _stored_zero_diagonal(sizes, comm):
    n, start = sizes[0], comm.tompi4py().exscan(sizes[0]) or 0
    csr = (np.arange(n + 1, dtype=PETSc.IntType), np.arange(start, start + n, dtype=PETSc.IntType))
    matrix = PETSc.Mat().createAIJ(size=(sizes, sizes), csr=(*csr, np.zeros(n)), comm=comm)
    matrix.assemble()
    return matrix


def is_symmetric(K) -> bool:
    """Whether xᵀKy = yᵀKx for two random vectors."""
    x, y = K.createVecs()
    Kx, Ky = x.duplicate(), x.duplicate()
    rng = np.random.default_rng(2001 + K.comm.rank)
    for vector in (x, y):
        vector.array_w[:] = rng.standard_normal(vector.local_size)
    K.mult(x, Kx)
    K.mult(y, Ky)
    gap, size = abs(x.dot(Ky) - y.dot(Kx)), Kx.norm() * y.norm()
    for vector in (x, y, Kx, Ky):
        vector.destroy()
    return gap <= 1e-10 * size


def rounding_error(comm, diagonal, u: np.ndarray, f: np.ndarray, multiplier: np.ndarray) -> float:
    """Relative error of the forces that rounding alone may cause, whatever the solver.

    A stiff body that hangs on a soft one moves far: the forces in it are differences of terms of
    the size K_ii u_i, and their rounding is not small against the loads.

    Args:
        comm: MPI communicator.
        diagonal: this rank's diagonal of K.
        u, f, multiplier: this rank's displacements, loads and multipliers.
    """
    free = (diagonal != 1.0) | (np.abs(u - f) > 1e-12 * np.abs(u))  # not an identity row
    largest = [
        np.abs(diagonal * u)[free].max(initial=0.0),
        max(np.abs(f)[free].max(initial=0.0), np.abs(multiplier).max(initial=0.0)),
    ]
    terms, forces = np.max(comm.allgather(largest), axis=0)
    return float(np.finfo(float).eps * terms / forces) if forces > 0.0 else 0.0


def mean_diagonal(K, rows: np.ndarray, geometric: bool = False) -> float:
    """Mean diagonal entry of K over some of this rank's local rows [force / length]."""
    diagonal = K.getDiagonal()
    values = np.abs(diagonal.array_r[rows])
    diagonal.destroy()
    values = np.log(np.maximum(values, 1e-300)) if geometric else values
    total = K.comm.tompi4py().allreduce(np.array([values.sum(), float(len(values))]))
    mean = total[0] / total[1] if total[1] else float(not geometric)
    return float(np.exp(mean) if geometric else mean)
