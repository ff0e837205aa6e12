"""Nonlinear bodies: residual forms in the displacement, and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import agree, collective
from dolfinx_llm.finite.pressure import FreeSurfacePressure
from dolfinx_llm.forms.choice import SOLVERS
from dolfinx_llm.geometry.cells import middle_jacobians
from dolfinx_llm.geometry.spaces import CELLS
from dolfinx_llm.interface.choices import Interface
from dolfinx_llm.operators.numbering import BodyDofs
from dolfinx_llm.operators.petsc import block_diagonal
from dolfinx_llm.problem.arguments import (
    agree_on,
    by_mesh,
    check_petsc_options,
    communicator,
    conditions,
    interface_list,
    kept_list,
    nodal_by_mesh,
    nodal_list,
    pressure_list,
)
from dolfinx_llm.problem.blocks import Blocks
from dolfinx_llm.problem.form_arguments import (
    agree_on_constants,
    check_meshes,
    check_parts,
    check_positions,
    check_unknowns,
    listed,
)

RESIDUAL = "give a residual form in u and a test function, or a list of them, one per mesh"
DERIVATIVE = "give the derivative of F, bilinear in the space of u, or a list of them, or None"
UNKNOWN = "give the Function u of the displacement, or a list of them, in the order of F"


@dataclass(frozen=True, eq=False)
class NonlinearArguments:
    """Arguments of a nonlinear problem that fit each other."""

    several: bool  # forms came as sequences
    F: list[ufl.Form]  # one per mesh
    J: list[ufl.Form]  # their derivatives
    u: list[fem.Function]  # one per mesh
    bcs: Any  # the user's own list, which may change
    interfaces: list[Interface]
    loads: list[FreeSurfacePressure]
    nodal_loads: list[fem.Function]  # the user's own list, too
    blocks: list[Blocks]  # function space of each mesh, and that of its displacement
    entity_maps: list[Any]  # of dolfinx, per form F, or None

    @property
    def spaces(self) -> list[Any]:
        """Function space of each mesh."""
        return [b.W for b in self.blocks]


def nonlinear_arguments(
    F: Any,
    u: Any,
    J: Any,
    bcs: Any,
    interfaces: Any,
    loads: Any,
    nodal_loads: Any,
    solver: Any,
    options: tuple[Any, Any],
    entity_maps: Any,
) -> NonlinearArguments:
    """Check the arguments of ``NonlinearContactProblem``; collective.

    Args:
        F, u, J, bcs, interfaces, loads, nodal_loads, solver, entity_maps: as given.
        options: prefix and PETSc options.

    Raises:
        ContactInputError: an argument does not fit; on all ranks, with what is accepted.
    """
    comm = communicator(u, F, J, bcs, nodal_loads)
    with collective(comm):
        functions = list(listed(u)) or checks.refuse("u", u, UNKNOWN)
        for function in functions:
            checks.instance("u", function, fem.Function, UNKNOWN)
        spaces = [function.function_space for function in functions]
        forms = list(listed(F))
        for form in forms:
            checks.instance("F", form, ufl.Form, RESIDUAL)
            if len(form.arguments()) != 1:
                checks.refuse("F", form, RESIDUAL)
            check_parts("F", form)
        if len(forms) != len(functions):
            raise ContactInputError(
                f"{len(forms)} forms F, {len(functions)} Functions u: {UNKNOWN}"
            )
        check_meshes(spaces)
        for form, V in zip(forms, spaces, strict=True):
            if not _belong(form, V):
                raise ContactInputError(
                    "a form F has a test function of another space than u: " + RESIDUAL
                )
        if J is None:
            check_unknowns(forms, functions)
        derivatives = [ufl.derivative(f, w) for f, w in zip(forms, functions, strict=True)]
        derivatives = derivatives if J is None else list(listed(J))
        if len(derivatives) != len(forms):
            raise ContactInputError(f"{len(derivatives)} forms J, {len(forms)} forms F")
        for form, V in zip(derivatives, spaces, strict=True):
            checks.instance("J", form, ufl.Form, DERIVATIVE)
            if not (len(form.arguments()) == 2 and _belong(form, V)):
                checks.refuse("J", form, DERIVATIVE)
        check_petsc_options(options[1], options[0])
        checks.one_of("solver", solver, SOLVERS)
    blocks = [Blocks(V, scalar=False) for V in spaces]
    none = isinstance(interfaces, (list, tuple)) and not interfaces
    with collective(comm):
        chosen = [] if none else interface_list(interfaces, spaces)
        given = NonlinearArguments(
            isinstance(u, (list, tuple)),
            forms,
            derivatives,
            functions,
            kept_list(bcs, conditions(bcs, spaces)),
            chosen,
            pressure_list(loads, spaces, chosen),
            kept_list(nodal_loads, nodal_list(nodal_loads, blocks)),
            blocks,
            compat.entity_maps_of(entity_maps, len(forms)),
        )
    agree_on(comm, given, forms, (solver, *options))
    covers = [[type(cover).__name__ for cover in load.covers] for load in given.loads]
    tags = [[tag for _, tag in load.tagged()] for load in given.loads]
    agree(comm, "the loads", (tags, covers))
    return given


def _belong(form: ufl.Form, V: Any) -> bool:
    """Whether all arguments of a form are of a space."""
    spaces = [argument.ufl_function_space() for argument in form.arguments()]
    return all(hasattr(W, "dofmap") and compat.same_space(W, V) for W in spaces)


class NonlinearBulk:
    """Bodies with residual forms F(u).

    Args:
        given: arguments of ``NonlinearContactProblem``.

    Attributes:
        blocks: per mesh the dofs of its form's function space, of which the vector of all bodies
            has those that are no displacements in units of their own.
        spaces: function space of each mesh's displacement.
        dofs: their numbers in the vector of all bodies, and which are prescribed.
        size: of the largest cell along an axis [length].

    Raises:
        ContactInputError: a form that cannot be compiled.
    """

    in_time = False  # see ``Bodies``

    def __init__(self, given: NonlinearArguments) -> None:
        self.u, self.blocks, self._W = given.u, given.blocks, given.spaces
        self.spaces = [b.V for b in self.blocks]
        self.comm = self.spaces[0].mesh.comm
        with collective(self.comm):
            self._F = compat.forms("F", given.F, given.entity_maps)
            self._J = compat.forms("J", given.J, given.entity_maps)
        self._given, self._loads = given.bcs, given.nodal_loads
        self._forms = given.F
        self._nodal = nodal_by_mesh(self.comm, self._loads, self.blocks)
        self._bcs = by_mesh(self.comm, self._given, self._W)
        self.measure()
        if self.dofs.mixed:  # units are those of the first tangent
            self._tangent().destroy()

    def measure(self) -> None:
        """Places of the dofs, and the size of cells, as meshes are now; collective."""
        with collective(self.comm):
            for V in self.spaces:
                check_positions(V.mesh)
        self.held: Array | None = None  # u (n_local,), where prescribed dofs stay for now
        others = tuple(b.others for b in self.blocks) if any(b.mixed for b in self.blocks) else ()
        self.dofs = BodyDofs(self.comm, tuple(self.spaces), self._prescribed(), others)
        places = [V.tabulate_dof_coordinates()[compat.cell_dofs(V)] for V in self.spaces]
        mine = max(float(np.ptp(x, axis=1).max(initial=0.0)) for x in places)
        self.size = self.comm.allreduce(mine, op=MPI.MAX)

    def look(self) -> None:
        """Look at nodal loads and conditions anew; ``dofs`` is another object where these prescribe
        other dofs; collective.

        Raises:
            ContactInputError: other conditions or loads than these, Constants that differ between
                ranks.
        """
        agree_on_constants(self.comm, self._forms)
        self._nodal = nodal_by_mesh(self.comm, self._loads, self.blocks)
        self._bcs = by_mesh(self.comm, self._given, self._W)
        fixed = self._prescribed()
        if self.comm.allreduce(int((fixed != self.dofs.fixed).sum())):
            self.dofs = replace(self.dofs, fixed=fixed)

    def _prescribed(self) -> Array:
        """(n_local,) which dofs the conditions prescribe."""
        found = zip(self.blocks, self._W, self._bcs, strict=True)
        fixed = [b.ours(compat.prescribed(W, bcs)[0][: len(b.scale)]) for b, W, bcs in found]
        return np.concatenate(fixed)

    def values(self) -> Array:
        """(n_local,) prescribed displacements, as ``look`` last found them; 0 where a dof is free.

        Raises:
            ContactInputError: values that are not finite.
        """
        parts = [
            b.ours(compat.prescribed_values(b.W, bcs)[:n]) / b.scale
            for b, bcs, n in zip(self.blocks, self._bcs, self.dofs.counts)
        ]
        values = np.concatenate(parts)
        if count := self.comm.allreduce(int((~np.isfinite(values) & self.dofs.fixed).sum())):
            raise ContactInputError(
                f"{count} values that the Dirichlet conditions prescribe are NaN or infinite"
            )
        return np.where(self.dofs.fixed, values if self.held is None else self.held, 0.0)

    def now(self) -> Array:
        """(n_local,) what stands in the Functions u, finite numbers; collective."""
        u = np.concatenate([b.values(u) for b, u in zip(self.blocks, self.u, strict=True)])
        if count := self.comm.allreduce(int((~np.isfinite(u)).sum())):
            raise ContactInputError(
                f"u has {count} entries that are NaN or infinite: the first load step starts from "
                "u, so let it be 0, or a displacement"
            )
        return u

    def put(self, u: Array) -> None:
        """Write this rank's u (n_local,) into the Functions u; collective."""
        parts = np.split(u, np.cumsum(self.dofs.counts))
        for b, function, part in zip(self.blocks, self.u, parts, strict=False):
            b.fill(function, part)

    def residual(self, u: Array) -> Array:
        """This rank's F(u) less the nodal loads, of all dofs; collective."""
        self.put(u)
        parts = []
        for b, form, nodal in zip(self.blocks, self._F, self._nodal, strict=True):
            part = compat.assemble_force((form,), (1.0,), b.W)
            for load in nodal:
                part -= b.nodal(load)
            parts.append(b.ours(part) * b.scale)
        return np.concatenate(parts)

    def tangent(self, u: Array) -> PETSc.Mat:
        """PETSc AIJ of the derivative of F at u, without conditions; collective."""
        self.put(u)
        return self._tangent()

    def _tangent(self) -> PETSc.Mat:
        """The same at the Functions u as they are."""
        free = [np.zeros(len(b.scale), dtype=bool) for b in self.blocks]
        parts = zip(self.blocks, self._J, free, strict=True)
        return block_diagonal(
            [b.matrix(compat.assemble_matrix(J, [], 1.0), none) for b, J, none in parts]
        )

    def inside_out(self, u: Array) -> tuple[int, list[float]]:
        """How many cells are inside out, in the middle, at this rank's u (n_local,), and where the
        first of them is drawn; collective."""
        self.put(u)
        found = []
        for b, w in zip(self.blocks, self.u, strict=True):
            V, v = b.V, b.displacement(w)
            topology = V.mesh.topology
            cells = compat.cell_dofs(V)[: topology.index_map(topology.dim).size_local]
            cells = cells[:, : CELLS[compat.cell_kinds(V.mesh)[0]][0]]  # corners come first
            X = V.tabulate_dof_coordinates()[:, : self.dofs.gdim]
            x = X + v.x.array.reshape(X.shape)
            turned = middle_jacobians(X, cells) * middle_jacobians(x, cells) <= 0.0
            found += checks.place(X[cells[turned]].mean(axis=1))
        every = [place for places in self.comm.allgather(found) for place in places]
        return len(every), sorted(every)[0] if every else []
