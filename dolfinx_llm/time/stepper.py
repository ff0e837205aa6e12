"""Steps in time of bodies with inertia in contact."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import agree, collective, told
from dolfinx_llm.geometry.spaces import check_space
from dolfinx_llm.operators.petsc import block_diagonal, diagonal_of, times
from dolfinx_llm.problem.arguments import LOADS, communicator, interface_list, kept_list
from dolfinx_llm.problem.bulk import fill
from dolfinx_llm.problem.form_arguments import form_space, given_forms, listed
from dolfinx_llm.problem.nonlinear import NonlinearContactProblem
from dolfinx_llm.problem.problem import ContactProblem
from dolfinx_llm.time.given import KnownMass, given_densities, step_length
from dolfinx_llm.time.inertia import tell_of_turns, without_surfaces
from dolfinx_llm.time.mean import MeanForces
from dolfinx_llm.time.momenta import End, Momenta
from dolfinx_llm.time.pulls import Pulls
from dolfinx_llm.time.steps import Steps, Touch

SCHEMES = "massless", "newmark"
PARTED = 6  # of a step that fails
UP_TO_ONE = "give a number from 0 to 1"


class StepProblem(ContactProblem):
    """Of a step in time, one of many."""

    steps_expected = 1000


class TimeStepper(Steps):
    """Bodies of static forms that have inertia, stepped in time by the trapezoidal rule, nonlinear
    forces by their mean on the way of a step.

    The cells at surfaces that may meet have no mass, the next ones carry it: these surfaces are at
    rest with what touches them and what lies behind, so that impact needs no impulse and contact
    forces do not chatter. Pairs that press each other at the start of a step stay in contact in
    it, so that the forces of both ends do no work where bodies part: energy under constant loads
    never grows without friction, and what impact takes falls with the square of the step. Of
    nonlinear bodies that neither supports nor obstacles touch, velocities are projected so that
    momenta are those of the loads and energy does not grow.

        M (u - u0 - dt v0) 4 / dt² + 2 F̄ + B λ + B λ0 = 0,   v = 2 (u - u0) / dt - v0

    with F̄ the mean of F on the straight way from u0 to u, (F(u) + F(u0)) / 2 where F is linear.
    With damping d the end of a step has the weight (1 + d) / 2 and its start (1 - d) / 2, in forces
    and velocities.

    Args:
        rho: density as drawn: a number, a Constant, Function or UFL expression that does not
            change; or a sequence of them, one per mesh.
        a: static bilinear form, or a sequence, as of ``ContactProblem``; or the residual form F of
            ``NonlinearContactProblem``.
        L: linear form, or a sequence; or the displacement u that F is written in.
        dt: length of a step [time]; may be set anew between steps, which factorises again.
        scheme: "massless"; or "newmark": all mass where it is, for bodies that are tied or stay
            in contact: energy grows where bodies meet.
        interfaces: as of the problem; at least one.
        nodal_loads: as of the problem.
        accepted: called with the stepper after each step that has been found, also after parts of
            one that was divided: update what bodies remember in it. Obstacles have what you gave
            them then, for the end of the whole step; ``t`` and ``u`` are those of the part.
        adaptive: part of the largest kinetic energy so far that closing may take in a step, and
            square of the part of the largest force that a pair which opens may pull with; where it
            is more the step is divided, which factorises anew. None: no step is.
        damping: 0 to 1: takes d ω² dt / 2 of a motion of frequency ω per unit of time; 0.1 takes
            the swinging that follows the front of a wave, and the energy in it.
        options: of the problem: ``bcs``, ``solver``, ..., but no ``J``.

    Attributes:
        u, v: displacement and velocity, a Function or a list; set them before steps.
        t, dt: time, 0 at first; as given.
        density: per mesh the density that has been moved, UFL.
        problem: ``ContactProblem`` or ``NonlinearContactProblem`` of a step: its ``results`` are at
            the end of the step.

    Raises:
        ContactInputError: arguments that do not fit.
        ContactError: a scene that cannot be solved.
    """

    def __init__(
        self,
        rho: Any,
        a: ufl.Form | Sequence[ufl.Form],
        L: Any,
        *,
        dt: float,
        scheme: str = "massless",
        interfaces: Any = (),
        nodal_loads: Any = (),
        accepted: Callable[[TimeStepper], None] | None = None,
        adaptive: float | None = None,
        damping: float = 0.0,
        **options: Any,
    ):
        self.comm = communicator(a, L)
        self._several, self._accepted, self.t = isinstance(a, (list, tuple)), accepted, 0.0
        nonlinear = any(isinstance(item, fem.Function) for item in listed(L))
        with collective(self.comm):
            spaces = _spaces(a, L, nonlinear, options.get("entity_maps"))
            maps = compat.entity_maps_of(options.get("entity_maps"), len(spaces))
            self.dt = dt = step_length(dt)
            checks.one_of("scheme", scheme, SCHEMES)
            if accepted is not None and not callable(accepted):
                checks.refuse("accepted", accepted, "give a function of the stepper, or None")
            _check_choices(adaptive, damping)
            if options.get("J") is not None:
                raise ContactInputError(
                    "J: forces of a step are means of F on its way, and those of inertia, whose "
                    "derivatives are found: leave J out"
                )
            chosen = interface_list(interfaces, spaces)
            densities = given_densities(rho, spaces)
            one = [nodal_loads] if isinstance(nodal_loads, fem.Function) else nodal_loads
            self._nodal = kept_list(one, checks.items("nodal_loads", one, LOADS))
        for V in spaces:
            check_space(V, highest=2)
        agree(self.comm, "dt, scheme, adaptive and damping", (dt, scheme, adaptive, damping))
        agree(self.comm, "rho", [float(d.value) for d in densities if isinstance(d, fem.Constant)])
        self._end = 0.5 * (1.0 + damping)  # weight of what there is at the end of a step
        self._rates = [fem.Constant(V.mesh, self._rate(dt)) for V in spaces]
        forms, inertias, masses = list(listed(a)), [], []
        with collective(self.comm):
            self._mean = mean = MeanForces(forms, listed(L), maps) if nonlinear else None
        surfaces = [_surfaces(V, chosen) if scheme == "massless" else [] for V in spaces]
        self.density, eased = without_surfaces(spaces, densities, surfaces)
        for i, (V, density) in enumerate(zip(spaces, self.density, strict=True)):
            mass, now = _inertia(density, V, forms[i], listed(L)[i] if mean else None)
            forms[i] = sum((mean.forms[i],) if mean else (), forms[i] + self._rates[i] * now)
            inertias.append(mass)
            masses.append(compat.assemble_matrix(compat.form("rho", mass), [], 1.0))
        self._known_mass = KnownMass(inertias, spaces, [diagonal_of(M) for M in masses])
        self._M = block_diagonal(masses)
        self._pushes = [fem.Function(V, name="inertia") for V in spaces]
        self._loads = [*self._nodal, *self._pushes]
        kind: Any = NonlinearContactProblem if nonlinear else StepProblem
        self.problem = kind(
            forms if self._several else forms[0],
            L,
            interfaces=interfaces,
            nodal_loads=self._loads,
            **options,
        )
        self._u = list(listed(L)) if nonlinear else [fem.Function(V, name="u") for V in spaces]
        self._v, self._left = [fem.Function(V, name="v") for V in spaces], np.zeros(0)
        self._started, self._led = False, np.zeros(0)
        (self.problem.bulk if nonlinear else self.problem.method).in_time = True
        self._bare = diagonal_of(self._M) == 0.0
        tell_of_turns(spaces, chosen, eased, self.problem.bulk.dofs.fixed)
        alone = nonlinear and not options.get("loads")  # follower loads count as contact
        self._momenta = Momenta(spaces, chosen, self._M) if alone else None
        laws = [i.law for i in self.problem.interfaces]
        rubs = [law.opens and law.slips and not law.gives for law in laws]
        self._pulls = [Pulls(i.name) if r else None for i, r in zip(chosen, rubs, strict=True)]
        self._adaptive, self._touch = adaptive, Touch(*(np.zeros(0),) * 3, 0.0, 0.0)

    @property
    def u(self) -> Any:
        """Displacement, a Function or a list [length]."""
        return self._u if self._several else self._u[0]

    @property
    def v(self) -> Any:
        """Velocity, a Function or a list [length / time]."""
        return self._v if self._several else self._v[0]

    def step(self) -> Any:
        """Go on by dt, to the loads and prescribed values as they are now; in parts where that
        fails, or ``adaptive`` asks for it. Each part leads supports, obstacles, given gaps and
        follower pressures by its share of the way; forms and nodal loads are as they are now.

        Returns:
            The displacement u.

        Raises:
            ContactInputError: dt is not positive, or rho has changed.
            ContactError: it fails in small parts, too; the last that was found is kept.
        """
        with collective(self.comm):
            step_length(self.dt)
        agree(self.comm, "dt", self.dt)
        if not self._started:  # not told by _left, which is empty where a rank has no dofs
            self.start()
        self._advance(told(self.comm, self.dt), PARTED)
        return self.u

    def _once(self, dt: float, part: float) -> None:
        u, c = self._values(self._u), self._rate(dt)
        v = self._speed(u)
        before = 1.0 / self._end - 1.0  # weight of what there was, over that
        push = c * times(self._M, u + dt * v) - before * self._left
        counts = self.problem.bulk.dofs.counts
        self._use(c)
        self._push(push)
        if self._mean:
            pushed = self.problem.pushed
            start = End(u, v, self._left + pushed, pushed)
            self._mean.begin(u, counts, 0.5 / self._end)
        self._solve(part)
        now = self._values(listed(self.problem.u))
        self._left = push - c * times(self._M, now)
        rate = (now - u) / dt
        found = np.where(self._bare, rate, rate / self._end - before * v)
        if self._mean:
            fixed = self.problem.bulk.dofs.fixed
            beyond = np.where(fixed, 0.0, self._mean.values())
            self._left -= beyond
            pushed = self.problem.pushed
            end = End(now, found, self._left + pushed, pushed)
            if self._momenta:
                mean = 0.5 * (start.F + end.F) + self._end * beyond
                parts = (1.0 - self._end) * dt, self._end * dt
                found = self._momenta.projected(start, end, mean, parts, fixed)
        fill(self._u, now, counts)
        fill(self._v, found, counts)

    def _rate(self, dt: float) -> float:
        return 1.0 / (self._end * dt) ** 2

    def _use(self, c: float, starts: bool = False) -> None:
        if not self._mean:
            self.problem.method.starts = starts
        for rate in self._rates:
            rate.value = c

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.problem.destroy()
        self._M.destroy()


def _spaces(a: Any, L: Any, nonlinear: bool, entity_maps: Any) -> list[Any]:
    """Function spaces of the displacement."""
    if not nonlinear:
        return [form_space(form) for form in given_forms(2, a, entity_maps)]
    for item in listed(L):
        checks.instance("L", item, fem.Function, "give the Function u that F is written in")
    given_forms(1, a, entity_maps)
    return [u.function_space for u in listed(L)]


def _inertia(density: Any, V: Any, form: ufl.Form, u: Any) -> tuple[ufl.Form, ufl.Form]:
    """Mass, and inertia of a static form in V, which is a residual in the Function u or bilinear,
    None; with its own arguments: spaces are compared by identity."""
    w, *others = form.arguments()
    dx = ufl.Measure("dx", domain=V.mesh)
    mass = density * ufl.inner(others[0] if others else ufl.TrialFunction(V), w) * dx
    return mass, mass if u is None else density * ufl.inner(u, w) * dx


def _check_choices(adaptive: Any, damping: Any) -> None:
    if adaptive is not None:
        checks.number("adaptive", adaptive, "give a positive number", above=0.0)
    if checks.number("damping", damping, UP_TO_ONE, low=0.0) > 1.0:
        checks.refuse("damping", damping, UP_TO_ONE)


def _surfaces(V: Any, interfaces: Sequence[Any]) -> list[tuple[Any, int]]:
    """Facets of V's mesh that may part from what they meet."""
    sides = [side for i in interfaces if i.law.opens for side in i.tagged_sides()]
    return [(tags, tag) for tags, tag in sides if compat.tags_belong_to(tags, V.mesh)]
