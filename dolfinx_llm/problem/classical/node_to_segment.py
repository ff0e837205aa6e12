"""Node-to-segment contact, (2)-(6): prefers a side, and fails the patch test."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import block_diag, csr_matrix

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.parallel import agree, collective, gather_rows
from dolfinx_llm.base.sparse import placed
from dolfinx_llm.geometry.cells import bases
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.operators.motions import rigid_motions
from dolfinx_llm.operators.numbering import Numbering
from dolfinx_llm.operators.petsc import create_aij, times
from dolfinx_llm.operators.support import check_support
from dolfinx_llm.problem.arguments import check_petsc_options
from dolfinx_llm.problem.classical.form import ClassicalForm, checked_problem
from dolfinx_llm.problem.problem import ContactProblem

_ON_OUTLINE = 1e-8  # [cells] a slave node this far beyond the master's outline still touches it


@dataclass(frozen=True, eq=False)
class _Ties:
    """Slave nodes of one interface on their master surface; n nodes, c constraints each."""

    x: Array  # (n, gdim) slave nodes [length]
    owner: Array  # (n,) rank of each
    base: Array  # (n, c, gdim) directions a_i
    gap: Array  # (n, gdim) X_m - X_s [length]
    normal: Array  # (n, gdim) of the master, outwards
    rows: csr_matrix  # (n c, k) Q on the dofs of both surfaces
    dofs: Array  # (k,) their numbers in the vector of all bodies


class NodeToSegment(ClassicalForm):
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
        ContactInputError: unknown slave or components, a law other than ``Tied``, a rigid obstacle,
            a temperature, or bodies of second order.
        ContactError: no slave node lies on its master, or the constraints leave a body free.
    """

    def __init__(
        self,
        problem: ContactProblem,
        *,
        slave: int,
        components: str = "all",
        petsc_options: dict[str, Any] | None = None,
    ) -> None:
        with collective(checked_problem(problem).comm):
            if checks.integer("slave", slave, "choose side 0 or 1") not in (0, 1):
                checks.refuse("slave", slave, "choose side 0 or 1")
            checks.one_of("components", components, ("all", "normal"))
            check_petsc_options(petsc_options)
        agree(
            problem.comm, "slave, components and PETSc options", (slave, components, petsc_options)
        )
        rigid = [g.interface.name for g in problem.geometries if g.rigid]
        if rigid:
            raise ContactInputError(f"interfaces {rigid}: node-to-segment needs two bodies")
        dofs = problem.bulk.dofs
        if dofs.order > 1 or dofs.components == 1:
            raise ContactInputError(
                "node-to-segment is there for displacements of first order: take a vector space of "
                "Lagrange elements of degree 1, or Elimination"
            )
        laws = [geometry.interface.law for geometry in problem.geometries]
        if not all(law.ties for law in laws):
            raise ContactInputError(f"laws {laws}: node-to-segment is there for Tied() only")
        ties = [_tie(problem, geometry, slave, components) for geometry in problem.geometries]
        self.x = np.concatenate([t.x for t in ties])
        self._base = np.concatenate([t.base for t in ties])
        self._ties, self._surface_dofs = ties, np.concatenate([t.dofs for t in ties])
        rows = block_diag([t.rows for t in ties], format="csr")
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
        modes = bodies.modes(bodies.label, bodies.points)
        modes = modes.reshape(len(fixed), modes.shape[2] * modes.shape[3])
        moved = np.column_stack([times(self.Q, mode) for mode in modes.T])
        change = gather_rows(self.problem.comm, moved)
        check_support(rigid_motions(bodies, self.problem.K, fixed), [(None, csr_matrix(change))])

    def solve(self) -> Any:
        """Assemble the load and solve (6).

        Returns:
            The displacement: a dolfinx Function, or a list of them for several meshes.

        Raises:
            ContactError: the system cannot be solved, or Q is of another geometry.
        """
        problem = self.problem
        f = self._load()
        laws = [geometry.interface.law for geometry in problem.geometries]
        gaps = [
            np.einsum("nci,ni->nc", t.base, t.gap * law.closes_gap + t.normal * law.given_gap)
            for t, law in zip(self._ties, laws, strict=True)
        ]
        prescribed = problem.bulk.dofs.values(self._surface_dofs[self._fixed], f)
        g = (np.concatenate(gaps, axis=None) + self._prescribed @ prescribed)[self._kept]
        u, multiplier = self._solve(f, g[self._numbering.mine])
        values = np.zeros(self._base.shape[0] * self._base.shape[1])
        values[self._kept] = problem.operators.gather(self._numbering, multiplier)
        self.multiplier = values.reshape(self._base.shape[:2])
        self.force = np.einsum("nc,nci->ni", self.multiplier, self._base)
        return self._functions(u)


def _tie(
    problem: ContactProblem, geometry: InterfaceGeometry, slave: int, components: str
) -> _Ties:
    """Locate the slave nodes of an interface on the master's facets, and the rows of (2)."""
    sides = geometry.sides[slave], geometry.sides[1 - slave]
    spaces = geometry.spaces[slave], geometry.spaces[1 - slave]
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
    normal = bases(tangents)[:, -1]
    base = np.broadcast_to(np.eye(gdim), (len(on), gdim, gdim))
    if components == "normal":
        base = normal[:, None]
    dofs = [problem.bulk.dofs.of(*side) for side in zip(spaces, sides, strict=True)]
    shape = (len(on), base.shape[1], dofs[0].size + dofs[1].size)
    rows = _constraint_rows(weights, on, base, dofs[0].size, shape)
    x = sides[0].x[on]
    return _Ties(x, sides[0].owner[on], base, y - x, normal, rows, np.concatenate(dofs, axis=None))


def _constraint_rows(
    weights: csr_matrix,
    nodes: Array,
    base: Array,
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
    return placed(value, row, col, (n * c, k))
