"""The user's door: a linear elastic problem whose bodies touch, and its sensitivities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import ufl
from dolfinx import fem
from petsc4py import PETSc

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.disposable import Destroyed, Remains, free_garbage
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.log import warn
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.contact.results.doubts import doubts
from dolfinx_llm.contact.results.of_interfaces import Results
from dolfinx_llm.contact.results.results import InterfaceResult, collect_results
from dolfinx_llm.forms.cost import LOAD_STEPS
from dolfinx_llm.forms.step import StepForm
from dolfinx_llm.interface.choices import Interface
from dolfinx_llm.operators.system import anatomy
from dolfinx_llm.output.pictured import Pictured
from dolfinx_llm.problem.arguments import problem_arguments, step_arguments
from dolfinx_llm.problem.bulk import LinearBulk
from dolfinx_llm.problem.following import Following
from dolfinx_llm.problem.form_arguments import given_forms, in_order
from dolfinx_llm.problem.memory import Memory, Remembering
from dolfinx_llm.problem.methods import ContactMethod
from dolfinx_llm.problem.saving import SavedContact


class Differentiable:
    """A problem whose last solve can be differentiated."""

    bulk: LinearBulk
    method: ContactMethod

    def adjoint(self, dJ: ufl.Form | Sequence[ufl.Form]) -> Any:
        """Solve the transposed system of the last ``solve``, with its state of contact, for the
        sensitivities of a functional J(u): with p that is returned, dJ/dm is the derivative of
        L(p) - a(u, p) by what m changes there, u held. Collective.

        With friction it is that of one load step from rest, taken in one part, or of several in
        which nothing has slipped or opened before: what is left of earlier steps depends on m, too.

        Args:
            dJ: linear form, ``ufl.derivative(J, u, v)`` with v a test function of the space; a
                sequence of them for several meshes.

        Returns:
            The adjoint displacement p, a Function or a list, zero where displacements are
            prescribed.

        Raises:
            ContactInputError: another form.
            ContactError: nothing has been solved; contact alone holds a body; the form a is not
                symmetric; the state depends on load steps, or parts of the last one, before.
        """
        with collective(self.bulk.comm):
            spaces = [b.W for b in self.bulk.blocks]
            forms = in_order(self.bulk.forms, spaces, given_forms(1, dJ, self.bulk.entity_maps[0]))
        found = self.bulk.functions(self.method.adjoint(self.bulk.gradient(forms)))
        return found if self.bulk.several else found[0]


class ContactProblem(Remembering, Following, Differentiable, Pictured, SavedContact):
    """Bodies with stiffness a and load L that touch along interfaces, (31) of the paper.

    Args:
        a: bilinear UFL form of the bodies, or one per mesh; its space may be mixed, as (u, p), or
            scalar.
        L: linear UFL form, or a sequence of them.
        bcs: Dirichlet conditions.
        interfaces: the ``Interface`` objects, at least one.
        nodal_loads: Functions of nodal forces, added to the assembled L; a list may change between
            load steps.
        solver: "saddle": (31) with MUMPS; "condensed": the surfaces' displacements written in the
            frame's, by conjugate gradients with GAMG, or by Cholesky with petsc_options
            {"ksp_type": "preonly", "pc_type": "cholesky"}; "auto": by size; or your ``StepForm``.
        petsc_options_prefix: of the options of the linear solver.
        petsc_options: PETSc options on top of the solver's own.
        entity_maps: as of ``dolfinx.fem.form``, for forms with Functions or integrals of other
            meshes.

    Attributes:
        results: after ``solve``, an ``InterfaceResult`` per interface, the same on every rank.
        history: of the last ``solve``, a dict per iteration: "part" (of the load step),
            "iteration", "active" (pairs in contact), "stick", "slip", "changes", "residual"
            (relative).
        form: "saddle", "condensed", "flexibility", by ``solver``, laws and size; or of your own.
        unknowns: global number of displacements u, multipliers lambda and frame unknowns v.
        times: seconds per stage, summed over all calls.
        geometries: an ``InterfaceGeometry`` per interface: surfaces, frame, pairs and certificate.
        spaces: function space of the displacement on each mesh.
        K, B, L_b: PETSc matrices of (31) with conditions applied: at prescribed dofs K has identity
            rows and columns, and rows of B are zero.
        steps_expected: load steps, by which "auto" weighs what is done once against the rest.
        scale: mean stiffness of the surfaces, the unit of λ in the solvers [force / length].
        bulk, operators, method: ``LinearBulk``, ``ContactOperators``, ``ContactMethod``.

    Raises:
        ContactInputError: arguments that do not fit.
        ContactError: a scene that cannot be solved.
    """

    steps_expected = LOAD_STEPS

    def __init__(
        self,
        a: ufl.Form | Sequence[ufl.Form],
        L: ufl.Form | Sequence[ufl.Form],
        *,
        bcs: Sequence[Any] = (),
        interfaces: Interface | Sequence[Interface] = (),
        nodal_loads: Sequence[fem.Function] = (),
        solver: str | StepForm = "auto",
        petsc_options_prefix: str = "llm_",
        petsc_options: dict[str, Any] | None = None,
        entity_maps: Any = None,
    ):
        given = problem_arguments(
            a, L, bcs, interfaces, nodal_loads, solver, petsc_options_prefix, petsc_options,
            entity_maps,
        )  # fmt: skip
        free_garbage(given.blocks[0].W.mesh.comm)
        self.interfaces, self.solver = tuple(given.interfaces), solver
        self.times = StageTimes()
        self.history: list[dict[str, Any]] = []
        self.results: list[InterfaceResult] = Results()
        self._doubts: list[str] = []
        self._u: list[fem.Function] = []
        self._petsc = petsc_options_prefix, petsc_options
        self.bulk = LinearBulk(given, self.times)
        self.spaces, self.comm = self.bulk.spaces, self.bulk.comm
        self._build_operators()
        self.method = ContactMethod(self._setting())
        self._settle()
        self._remains = Remains([V.mesh for V in self.spaces])

    @property
    def form(self) -> str:
        """See the attributes above."""
        return self.method.form.name

    @property
    def u(self) -> Any:
        """The displacement of the last ``solve``, as it was returned: a Function, or a list.

        Raises:
            ContactError: nothing has been solved, or after ``destroy``.
        """
        if not self.results:
            raise ContactError("there is no displacement yet: call solve() first")
        return self._u if self.bulk.several else self._u[0]

    @property
    def pushed(self) -> Array:
        """(n_local,) -B λ, what interfaces push this rank's dofs with; as K and B, of second-order
        surfaces that may part in control values, see ``method.md`` [force].

        Raises:
            ContactError: nothing has been solved.
        """
        return self.method.pushed()

    @property
    def K(self) -> PETSc.Mat:
        """PETSc AIJ of the bodies' stiffness, identity rows and columns at prescribed dofs.

        The condensed form uses it up when it is set up; it is assembled anew when asked for.
        """
        return self.bulk.K

    @property
    def A(self) -> PETSc.Mat:
        """K, by the name that dolfinx's ``LinearProblem`` has for it."""
        return self.K

    def _take(self, increments: int, memory: Memory) -> Any:
        """A load step: ``update``, assemble the load, solve, and fill ``results``."""
        increments = step_arguments(self.comm, increments, self.interfaces, self.spaces)
        self.update()
        with self.times.timed("assembly of f"):
            f = self.bulk.load()
        method, said, goes_back = self.method, self._doubts, True
        method.prepare()
        before = method.snapshot(), (self.history, self.results, said, self._u)
        try:
            u, multiplier, w = method.solve(f, increments)
            self.history = method.history
            with self.times.timed("results"):
                self.results = collect_results(self.operators, u, multiplier, w, method.states)
            # On all ranks: it may raise.
            self._doubts = doubts(self.geometries, self.results, method.iteration, method.in_time)
            warn(self.comm, self._doubts, said)
            self._u = self.bulk.functions(u)
            goes_back = bool(memory.state)
            memory.found()
            goes_back = False
        finally:
            if goes_back:
                method.restore(before[0])
                self.history, self.results, self._doubts, self._u = before[1]
        return self.u

    def reset(self) -> None:
        """Forget the last load steps: contact state, slip, loads, results and what was told.

        Raises:
            ContactError: after ``destroy``.
        """
        self.method.reset()
        self.results, self._doubts = Results(), []

    def __str__(self) -> str:
        """Anatomy: sizes, blocks present, what was left out and why."""
        n_u, n_l, n_v = self.unknowns.values()
        lines = [
            f"ContactProblem: {len(self.spaces)} mesh(es), {self.bodies.count} bodies, "
            f"{len(self.geometries)} interface(s), {self.comm.size} rank(s)",
            f"  unknowns: {n_u + n_l + n_v} = {n_u} u + {n_l} λ + {n_v} v",
            f"  solver: {self.method.describe()}",
        ]
        lines += anatomy(self.operators)
        lines += [f"  after the last solve: {text}" for text in self._doubts]
        return "\n".join(lines)

    def destroy(self) -> None:
        """Free the PETSc objects; collective. May be called again, and is at the end of a ``with``
        block. On one rank the garbage collector does it, too; on several that runs at other times.
        """
        for part in (self.method, self.operators, self.bulk):
            if not isinstance(part, Destroyed):
                part.destroy()
        gone: Any = Destroyed("this ContactProblem")
        self._remains.destroyed = True
        self.method = self.operators = self.bulk = self.results = self.B = gone
