"""The frame form with v eliminated, (32)-(36): the classical form that is equivalent to (31)."""

from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy.linalg import solve_triangular
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import agree, chosen, collective, gather_rows
from dolfinx_llm.interface.obstacles import MeanDisplacement
from dolfinx_llm.operators.petsc import create_aij, times
from dolfinx_llm.operators.reactions import with_reactions
from dolfinx_llm.problem.arguments import check_petsc_options
from dolfinx_llm.problem.classical.form import ClassicalForm, checked_problem
from dolfinx_llm.problem.problem import ContactProblem

MAX_ROWS = 5000  # multipliers up to which v is eliminated: Q is dense


class Elimination(ClassicalForm):
    """The frame-augmented system (31) in the classical form (6): v eliminated, (32)-(36).

    λ = P Φ λ̂ fulfils the frame's equilibrium for any λ̂: P (32) projects on the complement of the
    range of L_b, and the columns of Φ (35) are an orthonormal basis of that complement, from a
    complete QR of L_b. What is left is (6) with Qᵀ = B P Φ. Where surface dofs are prescribed, what
    would act on those alone is left out of Φ, and λ there is as of ``with_reactions``. Collective;
    P, Φ and what is made of them lie on every rank.

    Args:
        problem: ``ContactProblem``.
        petsc_options: on top of those of (31), without prefix.

    Attributes:
        P: (n, n) projector of (32); its rows are the multipliers of side 0, then side 1, of one
            interface after the other, c per node.
        Phi: (n, k) basis of (35); k = n - m for m frame unknowns, without prescribed surface dofs.
        Q: PETSc AIJ (k, dofs of the bodies), (B P Φ)ᵀ. Dimensionless.
        multiplier: after ``solve``, (n_nodes, c) λ of (32) [force], c = n / n_nodes.
        force: after ``solve``, (n_nodes, gdim) forces that the bodies exert on the frame [force].
        v: after ``solve``, (nodes of the frames, gdim) frame displacement (33) [length].
        stats: ``ConstraintStats`` of Q.
        residual: of (6) after ``solve``, relative.

    Raises:
        ContactInputError: more than ``MAX_ROWS`` multipliers, a law other than ``Tied``, or a
            prescribed mean.
    """

    def __init__(
        self, problem: ContactProblem, *, petsc_options: dict[str, Any] | None = None
    ) -> None:
        with collective(checked_problem(problem).comm):
            check_petsc_options(petsc_options)
        agree(problem.comm, "PETSc options", petsc_options)
        laws = [geometry.interface.law for geometry in problem.geometries]
        if not all(law.ties for law in laws):
            raise ContactInputError(f"laws {laws}: the classical form is there for Tied() only")
        of = [g.interface for g in problem.geometries]
        means = [i.name for i in of if isinstance(i.obstacle, MeanDisplacement)]
        if means:
            raise ContactInputError(
                f"interfaces {means}: a prescribed mean has no frame to eliminate: solve (31), "
                "problem.solve()"
            )
        n, m = problem.L_b.getSize()
        if n > MAX_ROWS:
            raise ContactInputError(
                f"{n} multipliers: Q of (36) is dense, with {(n - m) / 1e3:.3g}e3 rows, and is "
                f"made for up to {MAX_ROWS}. Solve (31), problem.solve(), or take coarser meshes"
            )
        self._base = np.concatenate([p.base for p in problem.operators.pairs])
        nodal = problem.operators.at_free_dofs(np.arange(n))

        def factors() -> tuple[Array, Array, Array]:
            basis, R = np.linalg.qr(problem.operators.L.toarray(), mode="complete")
            return basis[:, :m], R[:m], _acting(basis[:, m:], nodal)

        self._range, self._R, self.Phi = chosen(problem.comm, factors)
        self.P = np.eye(n) - self._range @ self._range.T
        self._basis = self.P @ self.Phi
        super().__init__(problem, self._operator(problem), petsc_options)

    def _operator(self, problem: ContactProblem) -> PETSc.Mat:
        """Q = (B P Φ)ᵀ of (36)."""
        rows, comm = problem.operators.rows.numbering, problem.comm
        n_hat = self.Phi.shape[1]
        columns = n_hat // comm.size + (comm.rank < n_hat % comm.size), n_hat
        local = csr_matrix(self._basis[rows.mine])
        basis = create_aij(comm, rows.sizes, columns, local)
        Q = problem.B.matMult(basis)
        Q.transpose()
        basis.destroy()
        return Q

    def solve(self) -> Any:
        """Assemble the load and solve (36).

        Returns:
            The displacement: a dolfinx Function, or a list of them for several meshes.

        Raises:
            ContactError: the system cannot be solved, or Q is of another geometry.
        """
        problem, operators = self.problem, self.problem.operators
        rows = operators.rows.numbering
        f = self._load()
        g = operators.gap(f, operators.obstacle_motions())
        first, last = self.Q.getOwnershipRange()
        gap = operators.gather(rows, g)
        u, reduced = self._solve(f, (self._basis.T @ gap)[first:last])
        multiplier = self._basis @ gather_rows(problem.comm, reduced)
        motion = gap + operators.gather(rows, times(operators.B, u, transposed=True))  # g + Bᵀu
        v = solve_triangular(self._R, self._range.T @ motion)  # (33)
        if operators.held.any() or (operators.interfaces_at > 1).any():
            force = problem.bulk.force(u)
            multiplier = with_reactions(operators, multiplier, v, u, force)
        self.multiplier = multiplier.reshape(self._base.shape[:2])
        self.force = np.einsum("nc,nci->ni", self.multiplier, self._base)
        directions = np.concatenate([geometry.directions for geometry in problem.geometries])
        self.v = np.einsum("md,mdi->mi", v.reshape(directions.shape[:2]), directions)
        return self._functions(u)


def _acting(Phi: Array, nodal: csr_matrix) -> Array:
    """Orthonormal basis of the part of Φ (n c, k) that acts on free dofs, forces there (n c, dofs):
    with it Q has full row rank."""
    if nodal.shape[0] == nodal.shape[1]:  # none is prescribed, or in several interfaces
        return Phi
    _, size, V = np.linalg.svd(nodal.T @ Phi)
    return Phi @ V[: int((size > 1e-10).sum())].T
