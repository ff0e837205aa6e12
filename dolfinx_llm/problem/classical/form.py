"""The classical form (6) of contact: its operator Q, how full it is, and its factorised system."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.disposable import Destroyed
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.parallel import gather_rows
from dolfinx_llm.forms.saddle import FactorisedStep
from dolfinx_llm.forms.step import LinearStep
from dolfinx_llm.forms.verdict import beyond, check_lost, judge, largest
from dolfinx_llm.operators.numbering import Numbering
from dolfinx_llm.operators.petsc import times
from dolfinx_llm.problem.problem import ContactProblem


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


def checked_problem(problem: Any) -> ContactProblem:
    """The problem, if it is one."""
    accepted = "give a ContactProblem"
    checks.instance("problem", problem, ContactProblem, accepted)
    if problem.bulk.dofs.mixed:
        raise ContactInputError(
            "the classical methods are made for displacements alone: a mixed "
            "function space needs ContactProblem.solve"
        )
    return problem


class ClassicalForm:
    """Q of (6) and its factorised system."""

    def __init__(
        self, problem: ContactProblem, Q: PETSc.Mat, petsc_options: dict[str, Any] | None
    ) -> None:
        self.problem, self.Q = problem, Q
        self.stats = constraint_stats(Q, problem.spaces[0].mesh.geometry.dim)
        self.residual: float | None = None  # of (6) after a solve, relative
        self._system: Any = None
        self._options = petsc_options
        self._operators, self._version = problem.operators, problem.bulk.version

    def _load(self) -> Array:
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

    def _solve(self, f: Array, g: Array) -> tuple[Array, Array]:
        """This rank's u and multipliers of (6)."""
        problem, comm, Q = self.problem, self.problem.comm, self.Q
        counts = comm.allgather(Q.getLocalSize()[0])
        rows = Numbering(np.repeat(np.arange(comm.size), counts), comm.rank)
        gaps = gather_rows(comm, g)
        if self._system is None:
            Q_t = Q.copy()
            Q_t.transpose()
            step = LinearStep.tied(csr_matrix((len(gaps), 0)), gaps)
            numbers = rows, Numbering(np.zeros(0, dtype=np.int64), comm.rank)
            prefix = f"{problem.method.setting.prefix}classical_"
            self._system = FactorisedStep(
                problem.K, Q_t, step, numbers, problem.scale, prefix, self._options
            )
            Q_t.destroy()
        u, multiplier, _ = self._system.ask(f, gaps, np.zeros(0))
        self._judge(f, g, u, multiplier[rows.mine])
        return u, multiplier[rows.mine]

    def _judge(self, f: Array, g: Array, u: Array, multiplier: Array) -> None:
        """Require what every solution is required to keep."""
        problem, Q = self.problem, self.Q
        free = ~problem.bulk.dofs.fixed
        pushed = times(Q, multiplier, transposed=True)
        motion = times(Q, u)
        left, apart, moved, terms, *forces = largest(
            problem.comm,
            free * (times(problem.K, u) + pushed - f),
            problem.scale * (motion + g),
            problem.scale * np.maximum(np.abs(motion), np.abs(g)),
            free * problem.operators.diagonal * u,
            free * f,
            free * pushed,
        )
        verdict = judge(
            max(left, beyond(apart, moved)), terms, max(forces), "(6) factorised by MUMPS"
        )
        check_lost(verdict)
        self.residual = verdict.residual

    def _functions(self, u: Array) -> Any:
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
