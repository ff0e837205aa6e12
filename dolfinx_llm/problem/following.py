"""Problems that follow what changes between two solves: forms, conditions, meshes, obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.log import log
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.contact.results.of_interfaces import Results
from dolfinx_llm.contact.results.results import InterfaceResult
from dolfinx_llm.forms.choice import choose_solver
from dolfinx_llm.forms.step import StepForm
from dolfinx_llm.interface.against import as_drawn
from dolfinx_llm.interface.build import build_interfaces
from dolfinx_llm.interface.choices import Interface
from dolfinx_llm.interface.control import controlled
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.operators.system import ContactOperators
from dolfinx_llm.problem.bulk import LinearBulk
from dolfinx_llm.problem.methods import ContactMethod, Setting
from dolfinx_llm.problem.standing import Standing


class Following:
    """A problem whose operators are those of what it consists of now."""

    steps_expected: int
    interfaces: Sequence[Interface]
    solver: str | StepForm
    spaces: Sequence[Any]
    comm: MPI.Comm
    times: StageTimes
    bulk: LinearBulk
    method: ContactMethod
    operators: ContactOperators
    geometries: Sequence[InterfaceGeometry]
    results: list[InterfaceResult]
    _petsc: tuple[str, dict[str, Any] | None]
    _drawn: list[Array]  # what obstacles were taken to be

    @property
    def K(self) -> PETSc.Mat:
        """See ``ContactProblem``."""
        raise NotImplementedError

    @property
    def L_b(self) -> PETSc.Mat:
        """See ``ContactProblem``; collective where it is asked for first."""
        return self.operators.L_b

    def _build_operators(self) -> None:
        """Pairs, frames and operators, from positions, obstacles and conditions as they are now."""
        geometries = build_interfaces(self.interfaces, self.spaces, self.bulk.fixed)
        self.bulk.use_control(controlled(geometries))
        o = self.operators = ContactOperators(geometries, self.bulk.dofs, self.K, self.times)
        self.geometries, self.bodies, self.B = o.geometries, o.bodies, o.B

    def _setting(self) -> Setting:
        """What the method works with, in the form that suits."""
        self.scale, self.unknowns = self.operators.scale, self.operators.counts
        form, why = choose_solver(self.solver, self.K, self.operators, self.steps_expected)
        return Setting(form, self.bulk, self.operators, *self._petsc, self.times, why)

    def update(self) -> None:
        """Notice what has changed in forms, conditions and meshes; ``solve`` does so by itself.

        Where values of Constants or Functions in the forms a have changed, or which dofs are
        prescribed, K is assembled anew; laws that let bodies part or slip go on from the state of
        contact and the displacement that there were. Where a mesh was moved, or an obstacle drawn
        anew, contact is found anew for the new positions, from which displacements then count, and
        that state is forgotten. Forms are not compiled anew; what does not depend on the change
        stays. Collective.

        Raises:
            ContactError, ContactInputError: as when the problem was made.
        """
        with collective(self.comm):
            drawn = [part for geometry in self.geometries for part in as_drawn(geometry)]
        changes = self.bulk.changes()
        if any(self.comm.allgather(not all(map(np.array_equal, drawn, self._drawn)))):
            changes = changes | {"obstacles"}
        if not changes:
            return
        log.info("changed since the last solve: %s", ", ".join(sorted(changes)))
        keep = not changes & {"positions", "obstacles"}
        known = Standing.of(self) if keep else None
        self.method.destroy()
        before = self.operators
        if changes == {"stiffness"}:
            self.operators.renew(self.K, self.times)
        else:
            self._build_operators()
        alike = known is None or known.at_pairs_of(self.geometries)
        self.method.renew(self._setting(), keep=keep and alike)
        if not keep:
            self.results = Results()
        if self.operators is not before:  # which serve until then, also where this fails
            before.destroy()
        self._settle()
        if known is not None and not alike:
            known.go_on(self, known.u)

    def _settle(self) -> None:
        """All that follows from forms, meshes, conditions and obstacles is as these are now."""
        self._drawn = [part for geometry in self.geometries for part in as_drawn(geometry)]
        self.bulk.settle()
