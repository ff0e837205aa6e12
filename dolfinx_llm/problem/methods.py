"""How a problem is solved: in load steps, each by linear steps in a form of (31)."""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.log import progress, warn
from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.contact.equations.state import InterfaceState
from dolfinx_llm.contact.iteration import ContactIteration
from dolfinx_llm.contact.load_steps import advance
from dolfinx_llm.contact.results.path_dependence import from_the_past
from dolfinx_llm.contact.search.circles import UNSETTLED
from dolfinx_llm.forms.choice import form_named, other_form
from dolfinx_llm.forms.step import StepForm
from dolfinx_llm.operators.petsc import is_symmetric, times
from dolfinx_llm.operators.reactions import with_reactions
from dolfinx_llm.operators.system import ContactOperators
from dolfinx_llm.problem.bulk import LinearBulk

TIGHT = 1e-9  # relative tolerance of linear steps by which laws still come to rest


@dataclass(frozen=True)
class Setting:
    """What a method works with."""

    form: str | StepForm  # of (31): "saddle", "condensed", "flexibility", or the user's own
    bulk: LinearBulk
    operators: ContactOperators
    prefix: str  # of the PETSc options
    options: dict[str, Any] | None  # PETSc options
    times: StageTimes
    why: str  # this form
    is_other: bool = False  # than the one that was chosen

    def prepare(self, form: StepForm) -> None:
        """Set up the form; collective."""
        form.prepare(self.bulk.take_K() if form.takes_K else self.bulk.K, self.operators)

    def other(self, failed: str) -> "Setting | None":
        """For load steps that have failed, as a warning says in words for how; None where options
        say how steps are solved, no other form serves, or this is the other one. Collective."""
        if self.options or self.is_other:
            return None
        if not (other := other_form(self.form, self.bulk.K, self.operators)):
            return None
        why = f"{failed} in the {self.form} form: load steps go on by {other}"
        warn(self.operators.comm, [why], [])
        return replace(self, form=other, why=why, is_other=True)


@contextmanager
def _naming_tolerance(options: dict[str, Any] | None) -> Iterator[None]:
    """Of a law that does not come to rest where steps are solved loosely, that they are."""
    try:
        yield
    except ContactError as failed:
        given = (options or {}).get("ksp_rtol")
        if given is None or UNSETTLED not in str(failed) or float(given) <= TIGHT:
            raise
        raise ContactError(
            f"{failed}. petsc_options ksp_rtol={given}: steps solved so loosely do not tell "
            f"contact from none: give at most {TIGHT:g}, or leave it out"
        ) from failed


class ContactMethod:
    """Load steps, iterated where laws let bodies part or slip, smaller where these do not converge;
    with ties alone each is one linear step, and what was factorised serves the next.

    Attributes:
        setting: what it works with.
        form: ``StepForm`` that solves the linear steps.
        iteration: ``ContactIteration``, which holds the state, once there is one.
        in_time: load steps are steps in time: pairs that press at the start of one, by more than
            rounding, stay in contact in it, and bodies may fly.
        starts: the next one finds the forces at the start: none stays, since it may not have been
            there, as on the mesh that a stepper goes on from.
    """

    in_time = starts = False

    def __init__(self, setting: Setting) -> None:
        self.iteration: Any = None
        nothing: Any = None
        self._last: tuple[Array, list[Array]] = nothing  # u of this rank, motions of obstacles
        self._reported: Array = nothing  # λ of the last step, with forces at supports
        self._began: Any = None  # snapshot where its last part began; None: it has failed
        self._use(setting)

    def _use(self, setting: Setting) -> None:
        form, self.setting = setting.form, setting
        if isinstance(form, str):
            form = form_named(form, setting.prefix, setting.options, setting.times)
        self.form: StepForm = form
        self._ready = False

    @property
    def states(self) -> list[InterfaceState]:
        """Per interface what there is of contact."""
        return self.iteration.states

    @property
    def history(self) -> list[dict[str, Any]]:
        """See ``ContactProblem``."""
        return self.iteration.history

    def renew(self, setting: Setting, keep: bool = False) -> None:
        """Work with another stiffness or other operators; ``keep``: go on from the state of contact
        and the displacement that there were, held by the load that it takes then."""
        self.destroy()
        self._use(setting)
        if not keep:
            self.iteration = None

    def prepare(self) -> None:
        """Set up what load steps need, which the first of them does otherwise; collective."""
        if self._ready:
            return
        operators = self.setting.operators
        before, at_rest = self.iteration, np.zeros(len(operators.dofs.fixed))
        known = before is not None and before.multiplier is not None and not operators.tied
        held = self._holding(before.multiplier) if known else at_rest
        self.setting.prepare(self.form)
        self.iteration = ContactIteration(operators, self.form, at_rest, self._gaps(at_rest))
        if known:
            self.iteration.resume(before, held, self._gaps(*self._last), self._last[0])
        self._ready = True

    def _gaps(self, u: Array, motions: Any = None) -> Array:
        """(n,) g where supports are as u (n_local,), and obstacles moved."""
        operators = self.setting.operators
        return operators.gather(operators.rows.numbering, operators.gap(u, motions))

    def _holding(self, multiplier: Array) -> Array:
        """This rank's load that holds the last displacement, prescribed values at fixed dofs."""
        bulk, operators = self.setting.bulk, self.setting.operators
        own = multiplier[operators.rows.numbering.mine]
        return times(bulk.K, self._last[0]) + times(operators.B, own)

    def snapshot(self) -> tuple[Any, ...]:
        """Where the last load step has ended; ``prepare`` comes first."""
        return self.iteration.snapshot(), self._last, self._reported

    def restore(self, snapshot: tuple[Any, ...]) -> None:
        """Go on from there again, once a step has failed, and what came of it."""
        reached, self._last, self._reported = snapshot
        self.iteration.restore(reached)
        self._began = None

    def solve(self, f: Array, increments: int) -> tuple[Array, Array, Array]:
        """This rank's u, and all of λ and v, at the end of the step to a load f (n_local,); where
        that fails the caller takes back what there was."""
        self.prepare()
        operators = self.setting.operators
        if getattr(self.form, "operators", operators) is not operators:
            raise ContactError(
                f"the form {self.form.name!r} has been handed to another problem since: give each "
                "problem an object of its own"
            )
        if self.in_time and self.iteration.multiplier is not None:
            self.iteration.stay(not self.starts)
        motions = operators.obstacle_motions()
        g = self._gaps(f, motions)
        stage = "solve" if operators.tied else "iteration of contact laws"
        with self.setting.times.timed(stage):
            with nullcontext() if operators.tied else progress(None, stage) as self.iteration.bar:
                self._began = None
                with _naming_tolerance(self.setting.options):
                    u, multiplier, v, began = advance(self.iteration, f, g, increments, self._other)
        self._last, self._began = (u, motions), began
        multiplier = self.iteration.equations.with_supports(multiplier, self.iteration.w)
        if operators.held.any() or (operators.interfaces_at > 1).any():
            friction = [(s.bearing_rows(), s.nodes.felt) for s in self.states]
            force = self.setting.bulk.force(u)
            multiplier = with_reactions(operators, multiplier, v, u, force, friction)
        self._reported = multiplier
        return u, multiplier, v

    def _other(self, failed: str) -> str:
        """Have another form solve steps from now on, and say which; "" if there is none."""
        if self.in_time or not (setting := self.setting.other(failed)):
            return ""
        self.renew(setting, keep=True)
        self.setting.prepare(self.form)
        self.iteration.form, self._ready = self.form, True
        return setting.why

    def pushed(self) -> Array:
        """(n_local,) -B λ of the last solve [force]."""
        if self.iteration is None or self.iteration.multiplier is None:
            raise ContactError("there are no contact forces yet: call solve() first")
        operators = self.setting.operators
        own = self.iteration.multiplier[operators.rows.numbering.mine]
        return -times(operators.B, own)

    def adjoint(self, load: Array) -> Array:
        """This rank's p of the transposed step of the last solve, load (n_local,).

        Raises:
            ContactError: nothing has been solved, or contact alone holds a body, or K is not
                symmetric, or what was solved depends on steps before.
        """
        i, setting = self.iteration, self.setting
        step = None if i is None else i.last
        if step is None or self._began is None or not self._ready:
            raise ContactError("there is no state to linearise about: call solve() first")
        states, before = self._began.states, self._began.multiplier
        if self.in_time:
            raise ContactError(
                "the adjoint of steps in time is not there: each depends on the last"
            )
        if before is not None and (
            told := from_the_past(self.states, states, i.multiplier, i.w, setting.operators.scale)
        ):
            raise ContactError(
                f"the adjoint is that of one load step from rest, taken in one part: {told}. Call "
                "reset() and solve() once"
            )
        if setting.operators.floating.count:
            raise ContactError(
                "the adjoint of bodies that contact alone holds is not there: hold them by supports"
            )
        if not is_symmetric(setting.bulk.K):
            raise ContactError("the adjoint asks for a symmetric form a")
        return self.form.displacement(self.form.solve(load, step.transposed()))

    def kept(self) -> tuple[dict[str, Array], dict[str, Array]]:
        """What the next load step goes on from, but for the states: what is the same on every rank,
        and this rank's u and f."""
        i = self.iteration
        if i is None or i.multiplier is None:
            raise ContactError("there is no state to save yet: call solve() first")
        u, motions = self._last
        common = {
            "multiplier": i.multiplier, "w": i.w, "g": i.g, "loads": i.equations.loads,
            "sizes": np.array([i.ended, i.rounding, i.rounded, i.moved]),
            "reported": self._reported,
        }  # fmt: skip
        return common | {f"motion {k}": m for k, m in enumerate(motions)}, {"u": u, "f": i.f}

    def take(self, common: dict[str, Array], local: dict[str, Array]) -> None:
        """Go on from what ``kept`` returned; collective."""
        self.prepare()
        i, u = self.iteration, local["u"]
        i.multiplier, i.w, i.g = (common[name] for name in ("multiplier", "w", "g"))
        i.f, i.equations.loads, self._reported = local["f"], common["loads"], common["reported"]
        i.ended, i.rounding, i.rounded, i.moved = map(float, common["sizes"])
        i.alpha, i.last, self._began = self.setting.operators.floating.amounts(u), None, None
        count = len(self.setting.operators.geometries)
        self._last = u, [common[f"motion {k}"] for k in range(count)]

    def describe(self) -> str:
        """For ``print(problem)``: the form, what the last solve took and lost, and why this one."""
        lost = self.iteration.verdict.lost if self.iteration is not None else []
        return "; ".join([self.form.describe(), *lost]) + f" ({self.setting.why})"

    def reset(self) -> None:
        """Forget the last load steps: contact state, slip and loads."""
        if self.iteration is not None:
            self.iteration.forget()

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.form.destroy()
        self._ready = False
