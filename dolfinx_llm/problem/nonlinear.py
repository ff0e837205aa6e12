"""Nonlinear bodies in contact at finite deformation, with a frame that moves with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.disposable import free_garbage
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.log import log
from dolfinx_llm.base.parallel import agree, collective
from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.contact.results.of_interfaces import Results
from dolfinx_llm.finite.load_step import LoadStep, NewtonState
from dolfinx_llm.finite.newton import NewtonSteps
from dolfinx_llm.finite.pressure import FreeSurfacePressure, pressures_of
from dolfinx_llm.finite.results import MovingInterfaceResult
from dolfinx_llm.interface.choices import Interface
from dolfinx_llm.output.pictured import Pictured
from dolfinx_llm.problem.bulk import Fingerprint
from dolfinx_llm.problem.memory import INSTANT, Memory, Remembering
from dolfinx_llm.problem.nonlinear_bulk import NonlinearBulk, nonlinear_arguments
from dolfinx_llm.problem.nonlinear_parts import anatomy, pose_of, results_of
from dolfinx_llm.problem.nonlinear_system import counted, hold, posed
from dolfinx_llm.problem.saving import SavedNonlinear


class NonlinearContactProblem(Remembering, Pictured, SavedNonlinear):
    """Bodies F(u; v) = 0 that touch along interfaces, at finite deformation and large sliding.

    The frame's nodes are those of the coarser surface of each interface, of the other one if the
    coarser one alone has sharp edges, or of one that supports move as a whole, as a rigid tool, if
    it is the finer one; the other one's nodes are found anew on it in each of Newton's iterations,
    along its averaged normals there, and their rows are designed with the areas that both surfaces
    cover now. The derivative is complete.

    Args:
        F: residual UFL form of the bodies in the Function ``u`` and a test function, e.g.
            ``ufl.derivative`` of an energy; a sequence of them for bodies on several meshes.
        u: displacement of Lagrange elements of first or second order, or a Function of a mixed
            space of which it is a block, or a sequence, in the order of F. It is updated in place;
            what it holds at first is where the first step starts.
        J: derivative of F, or a sequence; None: ``ufl.derivative(F, u)``.
        bcs: Dirichlet conditions on the displacement; a list and values may change between steps.
        interfaces: ``Interface`` objects, or none, with the law ``Tied()``, ``Frictionless()``,
            ``Coulomb(...)`` or one of your own, which hold at the nodes of the finer side; an array
            of mu has a value for each of these, areas are those covered now. Rigid obstacles, which
            move and turn by any amount or are pressed by forces, take these laws, too; with
            ``Tied()`` they are rigid ends, and ``MeanDisplacement`` holds a surface in the mean.
        loads: ``FreeSurfacePressure`` objects.
        nodal_loads: Functions of nodal forces; a list may change between load steps.
        solver: "saddle": Newton's systems factorised by MUMPS; "condensed": by GMRES, with GAMG on
            the bodies, onto which contact is condensed, else by MUMPS, of which a warning tells;
            "auto": by size.
        petsc_options_prefix: of the options of the linear solver.
        petsc_options: PETSc options on top of the solver's own.
        entity_maps: as of ``dolfinx.fem.form``, for forms with Functions or integrals of other
            meshes.

    Attributes:
        method: "saddle" or "condensed", by ``solver`` and size.
        results: after ``solve``, a ``MovingInterfaceResult`` per interface, the same on every rank.
        history: of the last ``solve``, a dict per iteration: "part" (of the load step), "iteration"
            of the increment, "active" (pairs in contact), "stick", "slip", "changes", "residual"
            (relative), "linear" (iterations of GMRES; 0: factorised).
        unknowns: global numbers of displacements u and of the interfaces' own unknowns.
        times: seconds per stage, summed over all calls.

    Raises:
        ContactInputError: arguments that do not fit.
        ContactError: surfaces that share nodes.
    """

    suited_scale = 1.0  # of pictures

    def __init__(
        self,
        F: ufl.Form | Sequence[ufl.Form],
        u: fem.Function | Sequence[fem.Function],
        *,
        J: ufl.Form | Sequence[ufl.Form] | None = None,
        bcs: Sequence[Any] = (),
        interfaces: Interface | Sequence[Interface] = (),
        loads: FreeSurfacePressure | Sequence[FreeSurfacePressure] = (),
        nodal_loads: Sequence[fem.Function] = (),
        solver: str = "auto",
        petsc_options_prefix: str = "llm_",
        petsc_options: dict[str, Any] | None = None,
        entity_maps: Any = None,
    ):
        options = petsc_options_prefix, petsc_options
        given = nonlinear_arguments(
            F, u, J, bcs, interfaces, loads, nodal_loads, solver, options, entity_maps
        )
        free_garbage(given.spaces[0].mesh.comm)
        self.interfaces, self.loads = tuple(given.interfaces), tuple(given.loads)
        self.times, self._several = StageTimes(), given.several
        self._solver, self._petsc = solver, options
        with self.times.timed("form compilation"):
            self.bulk = NonlinearBulk(given)
        self.spaces, self.comm = self.bulk.spaces, self.bulk.comm
        self._drawn = Fingerprint((), self.spaces)
        self._drawn.changes(())
        self._build()

    def _build(self) -> None:
        """Interfaces and unknowns, from positions as they are now."""
        given = self.interfaces, self.loads, self._solver, self._petsc, self.times
        equations, self.method, self._why = posed(self.bulk, self.bulk.now(), *given)
        self._newton, self._moved = NewtonSteps(equations), False
        self.unknowns = counted(equations)
        self.reset()

    def update(self) -> None:
        """Notice what has changed in conditions and meshes, as ``solve`` does; collective. Where a
        mesh was moved the state is forgotten: contact is that of a problem made now, from u as it
        stands. Where other dofs are prescribed it stays; what supports bore goes in the next step.

        Raises:
            ContactError, ContactInputError: as when the problem was made.
        """
        self.bulk.look()
        self._moved = bool(self._drawn.changes(())) or self._moved
        if self._moved:
            log.info("a mesh was moved since the last solve")
            self.destroy()
            self.bulk.measure()
            self._build()
        elif self._newton.equations.system.dofs is not self.bulk.dofs:
            equations, given = self._newton.equations, (self.interfaces, self.loads)
            self._state = hold(equations, self._state, *given, self._solver, self._petsc)
            self.unknowns = counted(equations)

    @property
    def u(self) -> Any:
        """The displacement, as it was given: a Function, or a list."""
        return self.bulk.u if self._several else self.bulk.u[0]

    @property
    def pushed(self) -> Array:
        """(n_local,) what interfaces and follower loads push this rank's dofs with in the last
        state [force]."""
        return self._state.pushed

    @property
    def history(self) -> list[dict[str, Any]]:
        """Iterations of the last ``solve``."""
        return self._newton.history

    def reset(self, moved: bool = False) -> None:
        """Start anew from the displacement as it stands in u when the next load step begins,
        without contact forces.

        Args:
            moved: rigid obstacles stand where they are now; else as drawn.
        """
        self.results: list[MovingInterfaceResult] = Results()
        self._newton.told = []
        contacts = self._newton.equations.interfaces
        self._state = NewtonState(
            self.bulk.now(),
            tuple(np.zeros(c.what.size) for c in contacts),
            (None,) * len(contacts),
            0.0 * pressures_of(self.loads),
            tuple(pose_of(c, moved) for c in contacts),
            (None,) * len(contacts),
            np.zeros(len(self.bulk.dofs.fixed)),
        )

    def _take(self, increments: int, memory: Memory) -> Any:
        """A load step from the last state."""
        self.update()
        with collective(self.comm):
            checks.integer("increments", increments, "give an integer of at least 1", low=1)
            pressures = pressures_of(self.loads)
            equations = self._newton.equations
            equations.interfaces = [placed.begun() for placed in equations.interfaces]
            poses = tuple(pose_of(c) for c in equations.interfaces)
        given = increments, pressures.tolist(), [pose.tolist() for pose in poses]
        agree(self.comm, "increments, pressures and obstacles", given)
        self._state = _from_u(self._state, self.bulk, bool(self.results))
        values = self.bulk.values()
        start, results = self._state, self.results
        memory.begins(INSTANT)
        unbalanced = self._newton.unbalanced(start)
        if wrong := self.comm.allreduce(int((~np.isfinite(unbalanced)).sum())):
            raise ContactInputError(
                f"the residual F has {wrong} entries that are NaN or infinite where the step "
                "starts: check that u turns no element inside out, coefficients and nodal loads"
            )
        values = np.where(self.bulk.dofs.fixed, values, start.u)
        step = LoadStep(start, values, pressures, poses, unbalanced)
        try:
            for reached in self._newton.step(step, increments, memory.begins):
                self._keep(reached)
                memory.found()
            start = self._state
        finally:  # what has been reached is kept where the rest fails and nothing is to go back
            if memory.state and self._state is not start:
                self._state, self.results = start, results
            self.bulk.put(self._state.u)
        return self.u

    def _keep(self, state: NewtonState) -> None:
        """Take over a state that has been found, with its results."""
        with self.times.timed("results"):
            self.results = results_of(self._newton, self.interfaces, state)
        self._state = state
        self.bulk.put(state.u)

    def destroy(self) -> None:
        """Free the factorisation, which the next ``solve`` makes anew; collective. On one rank the
        garbage collector does it, too."""
        self._newton.equations.system.destroy()

    def __str__(self) -> str:
        """Sizes, and which side of each interface carries the frame."""
        n_u, n_q = self.unknowns.values()
        lines = [
            f"NonlinearContactProblem: {len(self.spaces)} mesh(es), {len(self.interfaces)} "
            f"interface(s), {len(self.loads)} follower load(s), {self.comm.size} rank(s)",
            f"  unknowns: {n_u + n_q} = {n_u} u + {n_q} of the interfaces",
            f"  solver: {self.method} ({self._why})",
        ]
        of = zip(self.interfaces, self._newton.equations.interfaces, strict=True)
        lines += [anatomy(interface, placed) for interface, placed in of]
        return "\n".join(lines)


def _from_u(state: NewtonState, bulk: NonlinearBulk, known: bool) -> NewtonState:
    """The state from which a load step starts: before the first one with u as it stands; later on,
    as ``known``, it is what has been found. Steps in time have a u of their own.

    Raises:
        ContactInputError: u has been changed by hand since the last load step.
    """
    if bulk.in_time:
        return state
    now, free = bulk.now(), ~bulk.dofs.fixed
    changed = bulk.dofs.comm.allreduce(int(((now != state.u) & free).sum()))
    if not changed:
        return state
    if known:
        raise ContactInputError(
            f"u has been changed at {changed} dof(s) since the last load step, from which the "
            "next one goes on: leave it as it is, or call reset(), which starts from u as it "
            "stands, without contact forces"
        )
    return replace(state, u=np.where(free, now, state.u))
