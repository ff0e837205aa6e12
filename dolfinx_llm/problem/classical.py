"""The classical discrete form of contact: displacements and multipliers, no frame, (6).

Two ways to its constraint operator Q, for comparison with the frame-augmented system (31):
node-to-segment contact (2)-(6), which prefers a side and fails the patch test, and the frame form
with v eliminated (32)-(36), which is equivalent to (31) and, with the orthonormal basis used here,
couples every constraint with every node. Only in this module sides are called master and slave.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from petsc4py import PETSc
from scipy.linalg import solve_triangular
from scipy.sparse import block_diag, csr_matrix

from dolfinx_llm.base import checks
from dolfinx_llm.base.destroyed import Destroyed
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.parallel import agree, collective, gather_rows
from dolfinx_llm.forms.saddle import SaddleSystem
from dolfinx_llm.geometry.cells import bases
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.interface.geometry import ContactModel
from dolfinx_llm.laws.tied import Tied
from dolfinx_llm.operators.numbering import Numbering
from dolfinx_llm.operators.petsc import create_aij, times
from dolfinx_llm.operators.reactions import with_reactions
from dolfinx_llm.operators.support import check_support
from dolfinx_llm.problem.arguments import check_petsc_options
from dolfinx_llm.problem.problem import ContactProblem

MAX_ROWS = 5000  # multipliers up to which v is eliminated: Q is dense
_ON_OUTLINE = 1e-8  # [cells] a slave node this far beyond the master's outline still touches it


@dataclass(frozen=True)
class ConstraintStats:
    """Size and fill of a constraint operator Q; the same on every rank.

    Only the dofs and nodes that take part, those with an entry in Q, are counted.
    """

    constraints: int  # rows
    dofs: int  # columns with entries
    entries: int  # above 1e-12 of the largest
    fill: float  # entries over constraints x dofs [per cent]
    node_fill: float  # coupled pairs (constraint, node) over all such pairs [per cent]


def constraint_stats(Q: PETSc.Mat, gdim: int) -> ConstraintStats:
    """Count the entries of Q above 1e-12 of the largest; collective.

    A constraint of a flat interface acts along one axis, so that ``fill`` of a tied one cannot
    exceed 100 / gdim; ``node_fill`` can reach 100.

    Args:
        Q: PETSc AIJ, one row per constraint, one column per dof of the bodies.
        gdim: dofs per node; the dofs of a node follow each other.

    Raises:
        ContactInputError: Q is no PETSc matrix, or has not gdim columns per node.
    """
    checks.instance("Q", Q, PETSc.Mat, "give a PETSc matrix")
    if not Q.handle:
        checks.refuse("Q", Q, "the matrix has been destroyed")
    checks.integer("gdim", gdim, "give 2 or 3")
    if gdim not in (2, 3) or Q.getSize()[1] % gdim:
        accepted = f"give 2 or 3, of which {Q.getSize()[1]}, the columns of Q, are a multiple"
        checks.refuse("gdim", gdim, accepted)
    comm = Q.comm.tompi4py()
    indptr, cols, values = Q.getValuesCSR()
    rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr)) + Q.getOwnershipRange()[0]
    values = np.abs(values)
    largest = max(comm.allgather(values.max(initial=0.0)))
    keep = values > 1e-12 * largest
    rows, cols = (gather_rows(comm, a[keep].astype(np.int64)) for a in (rows, cols))
    n, dofs, nodes = Q.getSize()[0], len(np.unique(cols)), len(np.unique(cols // gdim))
    pairs = len(np.unique(np.stack([rows, cols // gdim]), axis=1).T)
    return ConstraintStats(
        constraints=n,
        dofs=dofs,
        entries=len(rows),
        fill=100.0 * len(rows) / max(n * dofs, 1),
        node_fill=100.0 * pairs / max(n * nodes, 1),
    )


def _checked(problem: Any) -> ContactProblem:
    """The problem, if it is one."""
    accepted = "give a ContactProblem"
    return checks.instance("problem", problem, ContactProblem, accepted)


class _ClassicalForm:
    """Q of (6) and its factorised system."""

    def __init__(self, problem: ContactProblem, Q: PETSc.Mat, petsc_options: dict | None) -> None:
        self.problem, self.Q = problem, Q
        self.stats = constraint_stats(Q, problem.spaces[0].mesh.geometry.dim)
        self.residual: float | None = None  # of (6) after a solve, relative
        self._system: Any = None
        self._options = petsc_options
        self._operators, self._version = problem.operators, problem.bulk.version

    def _load(self) -> np.ndarray:
        """This rank's load, once what has changed in the problem is taken over."""
        problem = self.problem
        problem.update()
        if problem.operators is not self._operators:
            raise ContactError(
                "a mesh was moved, or other dofs are prescribed, since Q was made: make it anew"
            )
        if problem.bulk.version != self._version and self._system is not None:
            self._system.destroy()
            self._system = None
        self._version = problem.bulk.version
        return problem.bulk.load()

    def _solve(self, f: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """This rank's u and multipliers of (6)."""
        if self._system is None:
            p, Q_t = self.problem, self.Q.copy()
            Q_t.transpose()
            prefix = f"{p.method.setting.prefix}classical_"
            self._system = SaddleSystem(p.K, Q_t, None, p.scale, prefix, self._options)
            Q_t.destroy()
        u, multiplier, _ = self._system.solve(f, g)
        self.residual = self._system.residual
        return u, multiplier

    def _functions(self, u: np.ndarray) -> fem.Function | list[fem.Function]:
        functions = self.problem.bulk.functions(u)
        return functions if self.problem.bulk.several else functions[0]

    def destroy(self) -> None:
        """Free Q and the factorised system; collective, as ``ContactProblem.destroy``."""
        if not (self._system is None or isinstance(self._system, Destroyed)):
            self._system.destroy()
        if not isinstance(self.Q, Destroyed):
            self.Q.destroy()
        gone: Any = Destroyed("this classical form")
        self._system = self.Q = gone


@dataclass(frozen=True, eq=False)
class _Ties:
    """Slave nodes of one interface on their master surface; n nodes, c constraints each."""

    x: np.ndarray  # (n, gdim) slave nodes [length]
    owner: np.ndarray  # (n,) rank of each
    base: np.ndarray  # (n, c, gdim) directions a_i
    gap: np.ndarray  # (n, gdim) X_m - X_s [length]
    rows: csr_matrix  # (n c, k) Q on the dofs of both surfaces
    dofs: np.ndarray  # (k,) their numbers in the vector of all bodies


class NodeToSegment(_ClassicalForm):
    """Classical node-to-segment Lagrange multipliers, (2)-(6), of a tied problem.

    Every slave node on the master's surface follows the master's shape functions there:
    a_i · (sum_J N_J u_J - u_s) + g_i = 0. Slave nodes beyond the master's outline are not tied;
    those on it are. Constraints between prescribed dofs alone are left out: the supports decide.
    Collective.

    Args:
        problem: ``ContactProblem``; its stiffness, loads, supports and surfaces are used.
        slave: side, 0 or 1, whose nodes are tied (in every interface).
        components: "all": a_i the Cartesian axes; "normal": only the master's outward normal.
        petsc_options: on top of those of (31), without prefix.

    Attributes:
        Q: PETSc AIJ of (3), one row per constraint, one column per dof of the bodies; columns of
            prescribed dofs are empty. Dimensionless.
        x: (n, gdim) slave nodes that are tied, one interface after the other [length].
        multiplier: after ``solve``, (n, c) forces along a_i on the slave [force]; a normal one is
            positive in compression.
        force: after ``solve``, (n, gdim) forces on the slave nodes [force].
        stats: ``ConstraintStats`` of Q.
        residual: of (6) after ``solve``, relative.

    Raises:
        ContactInputError: unknown slave or components, or a law other than ``Tied``.
        ContactError: no slave node lies on its master, or the constraints leave a body free.
    """

    def __init__(
        self,
        problem: ContactProblem,
        *,
        slave: int,
        components: str = "all",
        petsc_options: dict | None = None,
    ) -> None:
        with collective(_checked(problem).comm):
            if checks.integer("slave", slave, "choose side 0 or 1") not in (0, 1):
                checks.refuse("slave", slave, "choose side 0 or 1")
            checks.one_of("components", components, ("all", "normal"))
            check_petsc_options(petsc_options)
        agree(
            problem.comm, "slave, components and PETSc options", (slave, components, petsc_options)
        )
        rigid = [model.interface.name for model in problem.models if model.frame is None]
        if rigid:
            raise ContactInputError(f"interfaces {rigid}: node-to-segment needs two bodies")
        laws = [model.interface.law for model in problem.models]
        if not all(isinstance(law, Tied) for law in laws):
            raise ContactInputError(f"laws {laws}: node-to-segment is there for Tied() only")
        ties = [_tie(problem, model, slave, components) for model in problem.models]
        self.x = np.concatenate([t.x for t in ties])
        self._base = np.concatenate([t.base for t in ties])
        self._ties, self._surface_dofs = ties, np.concatenate([t.dofs for t in ties])
        rows = block_diag([t.rows for t in ties], format="csr")
        dofs = problem.bulk.dofs
        fixed = dofs.values(self._surface_dofs, dofs.fixed) > 0.0
        self._prescribed = rows[:, fixed]
        self._fixed = fixed
        rows = rows[:, ~fixed]
        self._kept = np.flatnonzero(np.asarray(abs(rows).sum(axis=1)).ravel())
        owner = np.concatenate([t.owner for t in ties])
        owner = np.repeat(owner, self._base.shape[1])[self._kept]
        self._numbering = Numbering(owner, problem.comm.rank)
        local = rows[self._kept[self._numbering.mine]].tocoo()
        sizes = problem.K.getSizes()[0]
        columns = self._surface_dofs[~fixed][local.col]
        local = csr_matrix((local.data, (local.row, columns)), (local.shape[0], sizes[1]))
        Q = create_aij(problem.comm, self._numbering.sizes, sizes, local)
        super().__init__(problem, Q, petsc_options)
        self._check_support()

    def _check_support(self) -> None:
        """Require that supports and constraints hold every body, for which Q is applied to rigid
        motions."""
        bodies, fixed = self.problem.bodies, self.problem.bulk.dofs.fixed
        modes = bodies.modes(bodies.label, bodies.points).reshape(len(fixed), -1)
        moved = np.column_stack([times(self.Q, mode) for mode in modes.T])
        change = gather_rows(self.problem.comm, moved)
        check_support(bodies, self.problem.K, fixed, [(None, change)])

    def solve(self) -> fem.Function | list[fem.Function]:
        """Assemble the load and solve (6).

        Returns:
            The displacement: a dolfinx Function, or a list of them for several meshes.

        Raises:
            ContactError: the system cannot be solved, or Q is of another geometry.
        """
        problem = self.problem
        f = self._load()
        gaps = [
            np.einsum("nci,ni->nc", t.base, t.gap * model.interface.law.close_gap).ravel()
            for t, model in zip(self._ties, problem.models, strict=True)
        ]
        prescribed = problem.bulk.dofs.values(self._surface_dofs[self._fixed], f)
        g = (np.concatenate(gaps) + self._prescribed @ prescribed)[self._kept]
        u, multiplier = self._solve(f, g[self._numbering.mine])
        values = np.zeros(self._base.shape[0] * self._base.shape[1])
        values[self._kept] = problem.operators.gather(self._numbering, multiplier)
        self.multiplier = values.reshape(self._base.shape[:2])
        self.force = np.einsum("nc,nci->ni", self.multiplier, self._base)
        return self._functions(u)


def _tie(problem: ContactProblem, model: ContactModel, slave: int, components: str) -> _Ties:
    """Locate the slave nodes of an interface on the master's facets, and the rows of (2)."""
    sides = model.sides[slave], model.sides[1 - slave]
    spaces = model.spaces[slave], model.spaces[1 - slave]
    frame = Frame(sides[1].x, sides[1].facets)  # facets turn outwards, and so does its normal
    at = frame.locate(sides[0].x)
    on = np.flatnonzero(at.outside <= _ON_OUTLINE)
    if not len(on):
        raise ContactError(
            f"none of the {len(at.cell)} nodes of {sides[0].name} (slave) lies on the facets of "
            f"{sides[1].name} (master). Choose slave={1 - slave}, whose facets may be smaller"
        )
    weights = frame.interpolation(at)[on]
    weights.data[np.abs(weights.data) < 1e-14] = 0.0  # rounding must not add master nodes
    weights.eliminate_zeros()
    _, y, tangents = frame.evaluate(at.cell[on], at.xi[on])
    gdim = frame.gdim
    base = np.broadcast_to(np.eye(gdim), (len(on), gdim, gdim))
    if components == "normal":
        base = bases(tangents)[:, -1:]
    dofs = [problem.bulk.dofs.of(*side) for side in zip(spaces, sides, strict=True)]
    shape = (len(on), base.shape[1], dofs[0].size + dofs[1].size)
    rows = _constraint_rows(weights, on, base, dofs[0].size, shape)
    x = sides[0].x[on]
    return _Ties(x, sides[0].owner[on], base, y - x, rows, np.concatenate(dofs, axis=None))


def _constraint_rows(
    weights: csr_matrix,
    nodes: np.ndarray,
    base: np.ndarray,
    first: int,
    shape: tuple[int, int, int],
) -> csr_matrix:
    """Q_c of (2): a_i times [-I, N_1 I, ...], slave dofs first, the master's from ``first`` on."""
    n, c, k = shape
    gdim = base.shape[2]
    N = weights.tocoo()
    value = np.concatenate([-base, N.data[:, None, None] * base[N.row]])
    node = np.concatenate([nodes * gdim, first + N.col * gdim])
    row = np.concatenate([np.arange(n), N.row])[:, None, None] * c + np.arange(c)[:, None]
    col = node[:, None, None] + np.arange(gdim)
    row, col = (np.broadcast_to(a, value.shape) for a in (row, col))
    keep = value != 0.0
    return csr_matrix((value[keep], (row[keep], col[keep])), shape=(n * c, k))


class Elimination(_ClassicalForm):
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
        ContactInputError: more than ``MAX_ROWS`` multipliers.
    """

    def __init__(self, problem: ContactProblem, *, petsc_options: dict | None = None) -> None:
        with collective(_checked(problem).comm):
            check_petsc_options(petsc_options)
        agree(problem.comm, "PETSc options", petsc_options)
        laws = [model.interface.law for model in problem.models]
        if not all(isinstance(law, Tied) for law in laws):
            raise ContactInputError(f"laws {laws}: the classical form is there for Tied() only")
        n, m = problem.L_b.getSize()
        if n > MAX_ROWS:
            raise ContactInputError(
                f"{n} multipliers: Q of (36) is dense, with {(n - m) / 1e3:.3g}e3 rows, and is "
                f"made for up to {MAX_ROWS}. Solve (31), problem.solve(), or take coarser meshes"
            )
        self._base = np.concatenate([p.base for p in problem.operators.pairs])
        dofs = np.concatenate(problem.operators.side_dofs)
        fixed = problem.bulk.dofs.values(dofs, problem.bulk.dofs.fixed) > 0.0
        # Ranks must not differ in the last bit of a basis: it is made on one.
        factors = None
        with collective(problem.comm):
            if problem.comm.rank == 0:
                basis, R = np.linalg.qr(problem.operators.L.toarray(), mode="complete")
                Phi = _acting(basis[:, m:], self._base, fixed)
                factors = basis[:, :m], R[:m], Phi
        self._range, self._R, self.Phi = problem.comm.bcast(factors)
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

    def solve(self) -> fem.Function | list[fem.Function]:
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
        multiplier = operators.least(self._basis @ gather_rows(problem.comm, reduced))
        motion = gap + operators.gather(rows, times(operators.B, u, transposed=True))  # g + Bᵀu
        v = solve_triangular(self._R, self._range.T @ motion)  # (33)
        if operators.held.any():
            force = problem.bulk.force(u)
            multiplier = with_reactions(operators, multiplier, v, u, force)
        self.multiplier = multiplier.reshape(self._base.shape[:2])
        self.force = np.einsum("nc,nci->ni", self.multiplier, self._base)
        directions = np.concatenate([model.directions for model in problem.models])
        self.v = np.einsum("md,mdi->mi", v.reshape(directions.shape[:2]), directions)
        return self._functions(u)


def _acting(Phi: np.ndarray, base: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Orthonormal basis of the part of Φ that acts on free dofs: with it Q has full row rank.

    Args:
        Phi: (n c, k) orthonormal columns.
        base: (n, c, gdim) local bases of the nodes.
        fixed: (n, gdim) prescribed dofs of the nodes.
    """
    if not fixed.any():
        return Phi
    n, c, gdim = base.shape
    free = np.where(fixed[:, None, :], 0.0, base)
    force = np.einsum("nci,nck->nik", free, Phi.reshape(n, c, -1)).reshape(n * gdim, -1)
    _, size, V = np.linalg.svd(force)
    return Phi @ V[: int((size > 1e-10).sum())].T
