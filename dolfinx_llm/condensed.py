"""The condensed form of (31): the surfaces' displacements written in terms of the frame's.

With u = T q + u_0 (``slaving``) the unknowns q are the bodies' free displacements and the frame's,
and Tᵀ K T q = Tᵀ (f - K u_0) is symmetric positive definite. The multipliers are the reactions
f - K u of what was eliminated.
"""

from __future__ import annotations

import logging
import time

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm._parallel import ContactError
from dolfinx_llm.operators import create_aij
from dolfinx_llm.slaving import FrameElimination, SlavedRows, eliminate_at_nodes
from dolfinx_llm.system import is_symmetric, mumps_infog, set_up_ksp

log = logging.getLogger("dolfinx_llm")

# The unpreconditioned norm is that of the system scaled to unit diagonal.
ITERATIVE = {"ksp_type": "cg", "ksp_norm_type": "unpreconditioned", "ksp_rtol": 1e-13}
GAMG = {
    "pc_type": "gamg",
    "pc_gamg_agg_nsmooths": 1,
    "pc_gamg_threshold": 0.01,
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_pc_type": "jacobi",
    "mg_levels_ksp_max_it": 3,
}
DIRECT = {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"}
PATIENCE = 400  # iterations of the default options, then a factorisation takes over
PASSES = 4  # solves for what the residual of the unreduced system still holds


class CondensedSystem:
    """Tᵀ K T with a preconditioner or a factorisation, set up once for any number of loads.

    Args:
        K: stiffness of the bodies, AIJ, identity rows and columns at prescribed dofs.
        rows: what is slaved to the frames.
        fixed: (n_local,) whether a dof of this rank is prescribed; f holds its value.
        scale: mean diagonal of K on the surface dofs [force / length].
        modes: near-null space for GAMG, rigid modes at the bodies' dofs (n_local, k) and at the
            frames' unknowns (m, k); None: none.
        proximal: (m,) non-negative stiffness d of the frames' unknowns, which adds
            1/2 sum_J d_J (v_J - c_J)² to the energy [force / length]; None: none.
        prefix: of the PETSc options.
        options: PETSc options on top of ``ITERATIVE`` and ``GAMG``, or of ``DIRECT`` with
            {"ksp_type": "preonly", "pc_type": "cholesky"}.

    Raises:
        ContactError: K is not symmetric or the reduced matrix not positive definite.
    """

    def __init__(
        self,
        K,
        rows: SlavedRows,
        fixed: np.ndarray,
        scale: float,
        *,
        modes=None,
        proximal: np.ndarray | None = None,
        prefix: str = "llm_",
        options: dict | None = None,
    ):
        if not is_symmetric(K):
            raise ContactError(
                "the condensed form needs a symmetric stiffness, K has none: use solver='saddle'"
            )
        self.K, self.rows, self.fixed, self.scale = K, rows, fixed, scale
        self.comm, self.gdim = K.comm.tompi4py(), rows.dofs.shape[1]
        self.notes: list[str] = []
        self.iterations, self.residual = 0, np.nan
        self.start = K.getOwnershipRange()[0]
        self.proximal = proximal
        began = time.perf_counter()
        self._eliminate()
        self._number()
        self.T = self._transformation()
        self.matrix, self.penalty = self._reduce()
        self._scale_to_unit_diagonal(modes)
        reduced = time.perf_counter()
        self._prefix = prefix
        self.ksp = self._set_up(options or {})
        self.times = {"reduction": reduced - began, "set-up": time.perf_counter() - reduced}

    # Elimination

    def _eliminate(self):
        """u = A (L_b v - g) + N w at this rank's dofs, v = Z v + v_0 on every rank."""
        dofs, vectors = self.rows.local
        node = eliminate_at_nodes(dofs - self.start, vectors, self.fixed)
        self.A, self.N = node.A, node.N
        self.L = self.rows.L[self.rows.mine]  # rows of this rank
        W = node.W.tocoo()
        count = self.comm.allgather(W.shape[0])
        first = sum(count[: self.comm.rank])
        self.mine_W = slice(first, first + W.shape[0])
        parts = self.comm.allgather((W.data, W.row + first, self.rows.mine[W.col]))
        data, row, col = (np.concatenate(part) for part in zip(*parts, strict=True))
        W_all = csr_matrix((data, (row, col)), shape=(sum(count), self.rows.L.shape[0]))
        self.W = node.W
        # The same on every rank; but for the order of its rows for every number of ranks.
        self.frame = FrameElimination((W_all @ self.rows.L).tocsr())

    def _number(self):
        """Columns of T: on each rank its bodies' dofs, then whole blocks per frame item."""
        frames = self.rows.frames
        self.pad = -(-frames.bs // self.gdim) * self.gdim
        n = len(self.fixed)
        self.sizes = n + self.pad * len(frames.mine), None
        ends = np.cumsum(self.comm.allgather(n))
        before = np.concatenate(
            [[0], np.cumsum(np.bincount(frames.owner, minlength=self.comm.size))]
        )
        self.first = self.start + self.pad * before[self.comm.rank]
        number = ends[frames.owner] + self.pad * frames.number
        self.columns = (number[:, None] + np.arange(frames.bs)).ravel()  # of the frames' unknowns
        # Places of this rank's frame unknowns in its part of q.
        self.seats = (n + self.pad * np.arange(len(frames.mine))[:, None]) + np.arange(frames.bs)
        self.seats = self.seats.ravel()
        bs = frames.bs
        self.mine_v = (frames.mine[:, None] * bs + np.arange(bs)).ravel()
        total = int(ends[-1]) + self.pad * len(frames.owner)
        self.sizes = (n + self.pad * len(frames.mine), total)

    def _transformation(self):
        """T as PETSc AIJ: rows as of K, columns as ``_number`` says."""
        body = self.N.tocoo()
        frame = (self.A @ (self.L @ self.frame.Z)).tocoo()
        value = np.concatenate([body.data, frame.data])
        row = np.concatenate([body.row, frame.row])
        col = np.concatenate([body.col + self.first, self.columns[frame.col]])
        local = csr_matrix((value, (row, col)), shape=(len(self.fixed), self.sizes[1]))
        return create_aij(self.K.comm, self.K.getSizes()[0], self.sizes, local, self.gdim)

    def _frame_penalty(self):
        """Zᵀ diag(d) Z in the numbering of q, or None."""
        if self.proximal is None:
            return None
        Z = self.frame.Z
        P = (Z.T @ Z.multiply(self.proximal[:, None])).tocsr()[self.mine_v].tocoo()
        local = csr_matrix(
            (P.data, (self.seats[P.row], self.columns[P.col])), shape=(self.sizes[0], self.sizes[1])
        )
        return create_aij(self.K.comm, self.sizes, self.sizes, local, self.gdim)

    def _reduce(self):
        """Tᵀ K T with the proximal term, and ones where q has a place without an unknown."""
        matrix = self.K.PtAP(self.T)
        penalty = self._frame_penalty()
        if penalty is not None:
            matrix.axpy(1.0, penalty, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        diagonal = matrix.getDiagonal()
        n = len(self.fixed)
        idle = diagonal.array_r == 0.0
        idle[:n] &= np.asarray(abs(self.N).sum(axis=0)).ravel() == 0.0
        place = np.flatnonzero(idle)
        ones = csr_matrix(
            (np.ones(len(place)), (place, place + self.first)), shape=(len(idle), self.sizes[1])
        )
        ones = create_aij(self.K.comm, self.sizes, self.sizes, ones, self.gdim)
        matrix.axpy(1.0, ones, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        diagonal.destroy()
        ones.destroy()
        self.idle = idle
        return matrix, penalty

    def _scale_to_unit_diagonal(self, modes):
        """S Tᵀ K T S, S the inverse square root of the diagonal, and its near-null space."""
        diagonal = self.matrix.getDiagonal()
        least = self.comm.allreduce(diagonal.array_r.min(initial=np.inf), op=MPI.MIN)
        if not least > 0.0:
            raise ContactError(
                f"the condensed matrix has the diagonal entry {least:.3g}: it is not positive "
                "definite. Check the material data of the forms a"
            )
        diagonal.sqrtabs()
        diagonal.reciprocal()
        self.S = diagonal
        self.matrix.diagonalScale(diagonal, diagonal)
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.matrix.setOption(PETSc.Mat.Option.SPD, True)
        if modes is not None:
            space = PETSc.NullSpace().create(vectors=self._near_null(*modes), comm=self.K.comm)
            self.matrix.setNearNullSpace(space)

    def _near_null(self, body, frame):
        """Orthonormal rigid modes of the scaled unknowns, zero where there is none."""
        values = np.zeros((self.sizes[0], body.shape[1]))
        n = len(self.fixed)
        values[:n] = self.N.T @ body
        values[:n][self.fixed] = 0.0
        values[self.seats] = frame[self.mine_v]
        values[self.idle] = 0.0
        values /= self.S.array_r[:, None]
        gram = self.comm.allreduce(values.T @ values)
        size, vectors = np.linalg.eigh(gram)
        kept = size > 1e-12 * size[-1]
        values = values @ (vectors[:, kept] / np.sqrt(size[kept]))
        found = []
        for column in values.T:
            vector = self.S.duplicate()
            vector.array_w[:] = column
            found.append(vector)
        return found

    # Solver

    def _set_up(self, given: dict):
        """KSP of the options, those of PETSc's database first; says what it is in ``method``."""
        database = PETSc.Options(self._prefix)

        def chosen(key, default):
            return database.getString(key) if database.hasName(key) else given.get(key, default)

        pc, krylov = chosen("pc_type", "gamg"), chosen("ksp_type", "cg")
        options = dict(ITERATIVE) if krylov == "cg" else {}
        options |= GAMG if pc == "gamg" else {}
        factor = pc in ("cholesky", "lu")
        if factor:
            options["pc_factor_mat_solver_type"] = "mumps"
        self.own = krylov == "cg" and pc == "gamg" and "ksp_max_it" not in given
        if self.own:
            options["ksp_max_it"] = PATIENCE
        options |= given
        names = {"gamg": "GAMG", "cholesky": "Cholesky", "cg": "CG"}
        parts = [names.get(krylov, krylov)] * (krylov != "preonly") + [names.get(pc, pc)]
        self.method = " + ".join(parts)
        for spare in (50, 400, 2000):
            more = {"mat_mumps_icntl_14": spare} if factor else {}
            ksp = set_up_ksp(self.matrix, self._prefix, more | options)
            infog = mumps_infog(ksp) if factor else {}
            if infog.get(1, 0) not in (-8, -9):
                break
            ksp.destroy()
        if infog.get(1, 0) < 0:
            raise ContactError(
                f"MUMPS could not factorise the condensed matrix: INFOG(1) = {infog[1]}, INFOG(2) "
                f"= {infog[2]}. -10: it is singular, a body or the frame is not held; -13: out of "
                "memory, leave petsc_options to their defaults for CG + GAMG"
            )
        return ksp

    def solve(
        self, f: np.ndarray, g: np.ndarray, centre: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """This rank's parts of u, λ, v for loads f and gaps g.

        Args:
            f: (n_local,) loads, prescribed values at fixed dofs.
            g: (R,) gaps of this rank's multipliers [length].
            centre: (m,) c of the proximal term, on every rank; None: zero.

        Raises:
            ContactError: the solver did not reach a small residual of (31).
        """
        g_D = np.concatenate(self.comm.allgather(self.W @ g))
        v_0 = self.frame.particular(g_D)
        u_0 = self.A @ (self.L @ v_0 - g)
        u_0[self.fixed] = f[self.fixed]
        u, q = self._iterate(f, u_0, v_0, centre)
        q_v = np.zeros(len(v_0))
        q_v[:] = self._gather_frame(q[self.seats])
        v = self.frame.Z @ q_v + v_0
        multiplier = self._reactions(f, u, v, centre)
        self._check(f, g, u, multiplier, v, centre)
        return u, multiplier, v[self.mine_v]

    def _iterate(self, f, u_0, v_0, centre):
        """Solve for q; repeat for the residual of the unreduced system while that gains."""
        x, b = self.matrix.createVecs()
        full, reduced = self.K.createVecs()[0], x.duplicate()
        image = full.duplicate()
        q, u = np.zeros(self.sizes[0]), u_0.copy()
        push = np.zeros(len(v_0))
        if self.proximal is not None:
            push = self.frame.Z.T @ (self.proximal * ((0.0 if centre is None else centre) - v_0))
        rtol, atol, divtol, most = self.ksp.getTolerances()
        self.iterations, last, goal = 0, np.inf, None
        for _ in range(PASSES):
            full.array_w[:] = u
            self.K.mult(full, image)
            full.array_w[:] = f - image.array_r
            self.T.multTranspose(full, b)
            if self.proximal is not None:
                reduced.array_w[:] = q
                self.penalty.mult(reduced, x)
                b.axpy(-1.0, x)
                b.array_w[self.seats] += push[self.mine_v]
            b.pointwiseMult(b, self.S)
            size = b.norm()
            if goal is None:  # a factorisation refines while that gains
                goal = 0.0 if self.ksp.getType() == "preonly" else rtol * size
            if not size > goal or not size < 0.5 * last:
                break
            last = size
            self.ksp.setTolerances(rtol=max(0.5 * goal / size, 1e-15) if q.any() else rtol)
            self._solve_once(b, x)
            x.pointwiseMult(x, self.S)
            q += x.array_r
            self.T.mult(x, full)
            u = u + full.array_r
        self.ksp.setTolerances(rtol, atol, divtol, most)
        for vector in (x, b, full, reduced, image):
            vector.destroy()
        return u, q

    def _solve_once(self, b, x):
        """One solve; where the default options do not get there, a factorisation takes over."""
        self.ksp.solve(b, x)
        self.iterations += self.ksp.getIterationNumber()
        reason = self.ksp.getConvergedReason()
        if reason < 0 and self.own:
            self.notes.append(
                f"CG + GAMG ended without an answer after {self.ksp.getIterationNumber()} "
                f"iterations (PETSc's reason {reason}): Cholesky by MUMPS instead"
            )
            log.warning(self.notes[-1])
            self.ksp.destroy()
            self.ksp = self._set_up(DIRECT)
            self.ksp.solve(b, x)

    def _gather_frame(self, local: np.ndarray) -> np.ndarray:
        """(m,) frame unknowns of all ranks in the items' own order."""
        frames = self.rows.frames
        values = np.concatenate(self.comm.allgather(local.reshape(-1, frames.bs)))
        return values[frames.number].ravel()

    def _reactions(self, f, u, v, centre) -> np.ndarray:
        """λ of this rank: f - K u where a row moves dofs; the frame's equilibrium elsewhere."""
        full, image = self.K.createVecs()
        full.array_w[:] = u
        self.K.mult(full, image)
        force = np.where(self.fixed, 0.0, f - image.array_r)
        full.destroy()
        image.destroy()
        multiplier = self.A.T @ force
        if len(self.frame.Q):
            missing = self._frame_forces(multiplier, v, centre)[self.frame.dependent]
            multiplier = multiplier - self.W.T @ self.frame.multipliers(missing)[self.mine_W]
        return multiplier

    def _frame_forces(self, multiplier, v, centre) -> np.ndarray:
        """(m,) L_bᵀ λ less the proximal forces, which must vanish."""
        forces = self.comm.allreduce(self.L.T @ multiplier)
        if self.proximal is not None:
            forces -= self.proximal * (v - (0.0 if centre is None else centre))
        return forces

    def _check(self, f, g, u, multiplier, v, centre):
        """Require a small residual of (31), as ``system.SaddleSystem`` does."""
        dofs, vectors = self.rows.local
        at = dofs - self.start
        vectors = vectors * ~self.fixed[at]
        full, image = self.K.createVecs()
        full.array_w[:] = u
        self.K.mult(full, image)
        residual = image.array_r - f
        full.destroy()
        image.destroy()
        np.add.at(residual, at, vectors * multiplier[:, None])
        miss = np.einsum("ri,ri->r", vectors, u[at]) - self.L @ v + g
        frame = self._frame_forces(multiplier, v, centre)
        sizes = [
            np.abs(residual).max(initial=0.0),
            self.scale * np.abs(miss).max(initial=0.0),
            np.abs(frame).max(initial=0.0),
            max(np.abs(f).max(initial=0.0), self.scale * np.abs(g).max(initial=0.0)),
            self.scale * max(np.abs(u).max(initial=0.0), np.abs(v).max(initial=0.0)),
            np.abs(multiplier).max(initial=0.0),
        ]
        sizes = np.max(self.comm.allgather(sizes), axis=0)
        worst, load = sizes[:3].max(), sizes[3]
        self.residual = worst / max(sizes[3:].max(), 1e-300)
        against_load = worst / load if load > 0.0 else self.residual
        if not (self.residual < 1e-9 and against_load < 1e-6):
            raise ContactError(
                f"the condensed solve failed: residual {self.residual:.1e} of the unknowns' size "
                f"(allowed 1e-9), {against_load:.1e} of the load's (allowed 1e-6), after "
                f"{self.iterations} iterations of {self.method}, PETSc's reason "
                f"{self.ksp.getConvergedReason()}. Check supports, material data and the "
                "petsc_options given, or use solver='saddle'"
            )

    def destroy(self):
        for item in (self.ksp, self.matrix, self.penalty, self.T, self.S):
            if item is not None:
                item.destroy()
