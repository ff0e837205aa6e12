"""Steps of contact laws in the condensed form: rows in contact are eliminated, others free.

Without friction the matrix stays symmetric positive definite, and CG with GAMG solves it at any
size. With friction the rows of κ hold Coulomb's law instead of the equilibrium of L_bᵀ λ; the
reduced matrix is then not symmetric (``friction``).
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from petsc4py import PETSc

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import gather_rows
from dolfinx_llm.base.sparse import of_rows
from dolfinx_llm.forms.condensed.elimination import EliminatedRows
from dolfinx_llm.forms.condensed.friction import SOLVED, FrictionStep
from dolfinx_llm.forms.condensed.friction_system import FrictionSystem
from dolfinx_llm.forms.condensed.modes import soft_modes_of, weak_motions
from dolfinx_llm.forms.condensed.splitting import SplitStiffness
from dolfinx_llm.forms.condensed.symmetric import items_of
from dolfinx_llm.forms.condensed.system import CondensedSystem
from dolfinx_llm.forms.cost import FEWEST
from dolfinx_llm.forms.exchange import MANY_ASKED, SetUp, WholeSteps, forecast_of, with_bodies
from dolfinx_llm.forms.options import FACTORISED
from dolfinx_llm.forms.step import SOFT, LinearStep, StepResult
from dolfinx_llm.forms.verdict import FinalError
from dolfinx_llm.operators.floating import Floating
from dolfinx_llm.operators.numbering import Numbering
from dolfinx_llm.operators.petsc import times
from dolfinx_llm.operators.system import ContactOperators

SWINGS = 8  # steps towards one load in which no fewer pairs are wrong than in any before
LOOSELY = 1e-2  # of the load, that the first solve towards it leaves if its signs are wrong
FIRMER = 0.1  # from one of these to the next
DOUBTLESS = 10.0  # times that, of the largest force: signs that are wrong beyond doubt
SWUNG = 16  # steps towards one load without friction: more are factorised
SWINGS_ON = "contact goes back and forth, its pairs are asked for one by one"
ASKED = 8  # pairs that are asked for with friction, where each takes a solve by GMRES


class CondensedForm(WholeSteps):
    """The condensed form of a step, which uses up K's storage."""

    name = "condensed"
    takes_K = True
    accuracy = 1e-11  # of balance and law, relative: what CG leaves
    most = 60  # as of ``WholeSteps``
    split: Any = None  # stiffness of the bodies, once it is known
    system: Any = None  # ``CondensedSystem``, without friction, once there is one
    friction: Any = None  # ``FrictionSystem``, with friction, once there is one

    def prepare(self, K: PETSc.Mat, operators: ContactOperators) -> None:
        """See ``StepForm``."""
        self.destroy()
        super().prepare(K, operators)
        with self.times.timed("reduction"):
            self.split = SplitStiffness(K, operators.rows.dofs, operators.diagonal)
            self._items = items_of(operators)
        self._known = np.zeros(0)  # what the system's matrix was made of
        self._spring, self._swings, self._fewest = 0.0, 0, np.inf
        self._seen: list[Array] = []  # rows in contact in the steps towards one load
        self._steps, self._hold = 0, 0.0  # of them since frames are held as they are

    def solve(self, f: Array, step: LinearStep) -> StepResult:
        """See ``StepForm``."""
        given = step.compliance[step.active].max(initial=0.0) * self.scale
        if given > 10.0 * SOFT:
            raise FinalError(
                f"rows that give way (compliance {given:.1e} of the surfaces') cannot be "
                "eliminated: use solver='saddle' in the place of 'condensed'"
            )
        step = replace(step, g=step.g - step.compliance * step.about)  # rows are eliminated as such
        if not step.holds:  # what the matrix alone does not tell
            self.release()
        new = f is not self._f
        hold = step.D.diagonal().min(initial=0.0)
        self._seen = [] if new else self._seen
        self._steps = 1 if new or hold != self._hold else self._steps + 1
        self._hold = hold
        back = any(np.array_equal(step.active, one) for one in self._seen)
        self._seen.append(step.active)
        if step.symmetric:
            found = self._frictionless(f, step, back)
        else:
            found = self._with_friction(f, step, back, new)
        self.factorised = (self.system if self.friction is None else self.friction).direct
        return found if back else self._foretold(f, step, found)

    def _by_cg(self, step: LinearStep) -> bool:
        """Whether CG solves it: of rows that stay, by options of the user's, and of bodies that may
        slide freely, where GMRES stalls; elsewhere GMRES's multigrid follows what changes."""
        stays = self.operators.floating.rigid.modes.shape[1] > 0 or not step.may_open.any()
        return step.symmetric and bool(stays or _chosen(self.options or {}))

    def _frictionless(self, f: Array, step: LinearStep, back: bool) -> StepResult:
        """A step without friction. Where signs are wrong it need not be solved to the end: what
        presses next is forecast; pairs are asked for where that comes back, or takes long."""
        if self.friction is not None and self._steps > SWUNG and not self._by_cg(step):
            self.friction.give_up(SWINGS_ON)
            back = True
        self.most, self.many = CondensedForm.most if back else 0, 0
        made = self._served(step)
        by_cg = isinstance(made, _Symmetric)  # stays, whichever pairs may open now
        system = self.system if by_cg else self.friction
        if step.may_open.any() and not (back or system.direct):
            system.loose = loose = LOOSELY * FIRMER ** len(self._seen)
            found = self.result(step, *made.ask(step.loaded(f), step.g, step.rhs, step.about))
            system.loose = 0.0
            least = -DOUBTLESS * loose * step.level(found.multiplier, found.y, self.scale)
            gap = self.scale * (step.L @ found.w - found.y - step.g)
            if (found.wrong & (np.where(step.active, found.multiplier, gap) < least)).any():
                self._f, self._wrong = f, np.inf
                return found
        found = super().solve(f, step)
        self.accuracy = CondensedForm.accuracy
        self.tolerance = self.system.tolerance if by_cg else 0.0
        return found

    def _with_friction(self, f: Array, step: LinearStep, back: bool, new: bool) -> StepResult:
        """A step with friction, as far as the law's residual is worth it."""
        self._served(step)
        self.friction.turn(new)
        direct = self.friction.direct
        self.most, self.many = (WholeSteps.most, MANY_ASKED) if direct else (ASKED * back, 0)
        found = super().solve(f, step)
        if new:
            self._swings, self._fewest = 0, np.inf
        elif self._wrong:
            self._swings += self._wrong >= self._fewest
            self._fewest = min(self._wrong, self._fewest)
        self._judge_friction(found, step)
        return found

    def _foretold(self, f: Array, step: LinearStep, found: StepResult) -> StepResult:
        """The same, with those rows wrong that will change."""
        direct = self.friction is not None and self.friction.direct
        asked = direct and not (step.symmetric and found.wrong.sum() > self.most)
        if not found.wrong.any() or asked:
            return found
        # By the balance of frames and jumps.
        told = step.symmetric or _smooth(self.operators)
        bodies = self.operators.floating if told else None
        pressing = _pressing(step, self._stiffness, found, bodies, f)
        wrong = step.may_open & (pressing != step.active)
        return replace(found, wrong=wrong) if wrong.any() else found

    def _judge_friction(self, found: StepResult, step: LinearStep) -> None:
        """How far balance and laws may be trusted; where contact goes back and forth, pairs are
        asked for one by one from now on, which takes a factorisation."""
        if self._swings > SWINGS:
            self.friction.give_up(SWINGS_ON)
        self.eager = self.friction.direct
        if self.eager:  # what a factorisation leaves is the rounding of f - K u
            level = step.level(found.multiplier, found.y, self.scale)
            noise = 0.5 * self.noise / level
            self.accuracy = min(max(noise, WholeSteps.accuracy), CondensedForm.accuracy)
        else:  # an inexact solve ends no iteration
            self.accuracy = CondensedForm.accuracy if self.friction.residual <= SOLVED else -1.0

    def left(self, f: Array, u: Array, multiplier: Array) -> Array:
        """See ``StepForm``."""
        operators = self.operators
        forces = times(operators.B, multiplier[operators.rows.numbering.mine])
        forces[operators.floating.pins] -= self._spring * u[operators.floating.pins]
        return self.split.times(u) + forces - f

    def set_up(self, step: LinearStep) -> SetUp:
        """See ``WholeSteps``."""
        on, rows = np.flatnonzero(step.active), self.operators.rows
        self._spring = step.spring
        numbering = Numbering(rows.numbering.owner[on], self.operators.comm.rank)
        eliminated = EliminatedRows(
            rows.dofs[on],
            rows.base[on],
            of_rows(step.L, on),
            numbering,
            self.operators.unknowns,
            self._items,
            self.operators.dofs.gdim,
        )
        if self._by_cg(step):
            hold = -step.D.diagonal()
            self._eliminate(eliminated, step, hold)
            self.eager = False  # to ask takes a solve by CG
            return _Symmetric(self.system, eliminated, on)
        self.split.hold(self.operators.floating.pins, self._spring)
        if self.friction is None:
            options = self.prefix, dict(self.options or {})
            few = self.split.sizes[1] < FEWEST and not step.symmetric
            direct = _factorises(options[1], few, self.operators)
            self.friction = FrictionSystem(self.split, self.operators, options, direct)
        if self.operators.floating.rigid.modes.shape[1]:
            self.friction.weak = weak_motions(self.operators, step.L)
        with self.times.timed("factorisation"):
            made = FrictionStep(self.friction, eliminated, on, step)
        self.eager = self.friction.direct
        return made

    def _eliminate(self, eliminated: EliminatedRows, step: LinearStep, hold: Array) -> None:
        """Take what is in contact into the system, if it is not there yet."""
        floating, n = self.operators.floating, len(step.active)
        wanted = np.concatenate([step.active, hold, [self._spring * floating.count]])
        if np.array_equal(wanted, self._known):
            return
        self.split.hold(floating.pins, self._spring)
        if self.system is not None:
            changed = int((wanted[:n] != self._known[:n]).sum())
            self.system.eliminate(eliminated, hold, changed)
        else:
            with self.times.timed("reduction"):
                self.system = CondensedSystem(
                    self.split, eliminated, self.operators.dofs.fixed, self.scale, self.prefix,
                    self.options, modes=partial(soft_modes_of, self.operators),
                    weak=weak_motions(self.operators, step.L), firm=self.operators.firm,
                    proximal=hold if hold.any() else None,
                )  # fmt: skip
            if self.operators.tied:  # the matrix stays
                with self.times.timed("factorisation"):
                    self.system.set_up()
        self._known = wanted

    def describe(self) -> str:
        """See ``StepForm``."""
        if self.friction is not None:
            return self.friction.describe()
        if self.system is None or not self.system.solver.set_ups:
            return "condensed, symmetric positive definite"
        took = f", {self.system.iterations} iterations" if self.system.iterations else ""
        return "; ".join([f"condensed, {self.system.solver.method}{took}", *self.system.notes])

    def destroy(self) -> None:
        """See ``StepForm``."""
        super().destroy()
        if self.split is not None:
            self.split.destroy()  # first: K's inside need not be taken back
        if self.friction is not None:
            self.friction.discard()
        if self.system is not None:
            self.system.destroy()
        self.system = self.split = self.friction = None


class _Symmetric(SetUp):
    """A step whose matrix is that of a ``CondensedSystem``, which may serve other steps as well:
    rows in contact stand at the places ``on`` (r,) among all."""

    def __init__(self, system: CondensedSystem, eliminated: EliminatedRows, on: Array) -> None:
        self._system, self._rows, self._on = system, eliminated, on

    def ask(
        self, f: Array, g: Array, rhs: Array, about: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """See ``SetUp``."""
        rows, comm = self._rows, self._system.comm
        u, found, w = self._system.solve(f, g[self._on][rows.multipliers.mine], -rhs)
        multiplier = np.zeros(len(g))
        multiplier[self._on] = gather_rows(comm, found)[rows.multipliers.number]
        return u, multiplier, gather_rows(comm, w)[rows.frames.number]

    def destroy(self) -> None:
        """What is set up may serve the next step."""


def _factorises(options: dict[str, Any], few: bool, operators: ContactOperators) -> bool:
    """Whether steps that GMRES would solve are factorised from the start: as options say, else of
    ``few`` unknowns, and along curved surfaces of second order: hundreds of iterations left no time
    to ask for pairs, and the law took two to three times its own."""
    if "pc_type" in options:
        return options["pc_type"] in FACTORISED
    return few or any(geometry.interface.law.follows for geometry in operators.geometries)


def _smooth(operators: ContactOperators) -> bool:
    """Whether nothing acts along any surface that bodies may slide on."""
    laws = [geometry.interface.law for geometry in operators.geometries]
    return all(law.follows or not (law.slips or law.gives) for law in laws)


def _pressing(
    step: LinearStep, k: Array, found: StepResult, floating: Floating | None, f: Array
) -> Array:
    """(n,) rows that press next. Bodies that contact alone holds go to where what presses balances
    this rank's loads f on them; with friction, floating None, they stay. k (n,) of rows."""
    forecast, g = forecast_of(step, k, found), step.g
    if floating is None:
        return forecast.normal()[0].pressing(found.multiplier, found.y + g)
    forecast, loads = with_bodies(forecast, floating, f)
    return forecast.pressing(found.multiplier, found.y + g, loads)


def _chosen(options: dict[str, Any]) -> bool:
    """Whether options of PETSc say how a symmetric matrix is to be solved."""
    krylov = any(key.startswith("ksp_") for key in options)
    return krylov or options.get("pc_type") in FACTORISED
