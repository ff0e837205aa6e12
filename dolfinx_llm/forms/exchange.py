"""Steps of contact laws on the whole system, set up where its matrix changes.

The same as ``flexibility``, where the surfaces have so many nodes that asking the bodies for their
answer to every multiplier costs more than a few factorisations. They are asked for the few whose
sign is wrong, and for those that get it wrong in turn.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import islice
from typing import Any, Protocol

import numpy as np
from petsc4py import PETSc
from scipy.sparse import hstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import chosen, gather_rows
from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.forms.step import ROUNDED_GAP, SIGN, LinearStep, StepForm, StepResult
from dolfinx_llm.forms.verdict import EPS, SEVERAL, UNBALANCED, largest
from dolfinx_llm.laws.complementarity import complementarity
from dolfinx_llm.laws.forecast import Forecast
from dolfinx_llm.operators.floating import Floating
from dolfinx_llm.operators.petsc import times
from dolfinx_llm.operators.system import ContactOperators

Load = tuple[Array, Array, Array]  # this rank's f, all of g and rhs
Answer = tuple[Array, ...]  # this rank's u, all of λ and w
MANY_ASKED = 1000  # pairs that a factorisation may be asked for, ``COLUMNS`` at once
YIELDING = 1.5  # by so much a node yields more than its own stiffness says


class SetUp(Protocol):
    """What a step's matrix was set up to; it answers to so many loads at once."""

    columns: int = 1

    def ask(
        self, f: Array, g: Array, rhs: Array, about: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """This rank's u, and all of λ (n,) and w (m,), for this rank's f, (n,) g and (m,) rhs;
        ``about`` as of ``LinearStep``, where g has not taken it up."""

    def ask_many(self, loads: Sequence[Load]) -> list[Answer]:
        """The same for each of several loads, without refinement where they are solved at once."""
        return [self.ask(*load) for load in loads]

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""


class WholeSteps(StepForm):
    """What steps on the whole system share; what has been set up serves as long as the step's
    matrix stays."""

    accuracy = 1e-13  # of balance and law, relative
    most = 200  # pairs that are asked for; where more have a wrong sign, all of these change
    many = 0  # the same where changing all has left no fewer; ``MANY_ASKED`` where factors answer
    eager = True  # asks whenever it may, not only where change has brought nothing

    def __init__(
        self,
        prefix: str = "llm_",
        options: dict[str, Any] | None = None,
        times: StageTimes | None = None,
    ) -> None:
        self.prefix, self.options = prefix, options
        self.times = StageTimes() if times is None else times
        self._set: tuple[LinearStep, SetUp] | None = None
        self._f: Array | None = None  # this rank's load of the last step
        self._wrong: float = np.inf  # signs that were wrong there

    def prepare(self, K: PETSc.Mat, operators: ContactOperators) -> None:
        """See ``StepForm``."""
        self.release()
        super().prepare(K, operators)
        self.scale = operators.scale
        self.__dict__.pop("_stiffness", None)

    def set_up(self, step: LinearStep) -> SetUp:
        """The matrix of a step, ready for loads; it has the springs of the step."""
        raise NotImplementedError

    def _served(self, step: LinearStep) -> SetUp:
        """What there is, if it serves this step."""
        if self._set is not None and step.same_matrix(self._set[0]):
            return self._set[1]
        self.release()
        made = self.set_up(step)
        self._set = step, made
        return made

    @cached_property
    def _stiffness(self) -> Array:
        """(n,) of rows."""
        return row_stiffness(self.operators)

    def release(self) -> None:
        """Free what was set up; collective."""
        if self._set is not None:
            self._set[1].destroy()
        self._set = None

    def solve(self, f: Array, step: LinearStep) -> StepResult:
        """See ``StepForm``."""
        if f is not self._f:
            self._f, self._wrong = f, np.inf
        made, f = self._served(step), step.loaded(f)
        found = self.result(step, *made.ask(f, step.g, step.rhs, step.about))
        before, self._wrong = self._wrong, int(found.wrong.sum())
        stalls = self._wrong >= before
        most = max(self.most, self.many) if stalls else self.most
        if 0 < self._wrong <= most and (self.eager or stalls):
            pairs, forces, among = self._choose(made, step, found, most)
            if len(pairs):
                found = self._changed(made, f, step, pairs, forces, among)
        operators = self.operators
        terms = largest(operators.comm, ~operators.dofs.fixed * operators.diagonal * found.u)
        self.noise = SEVERAL * EPS * terms[0]
        return replace(found, wrong=found.wrong | self._held_apart(step, found))

    def _changed(
        self, made: SetUp, f: Array, step: LinearStep, pairs: Array, forces: Array, among: Array
    ) -> StepResult:
        """The step under this rank's load f where pairs (k,) change, by ``forces`` of ``_choose``:
        differences of large answers where frames are held weakly, which what is left corrects."""
        active, opens = step.active.copy(), step.active[pairs]
        active[pairs] ^= True
        for corrected in (False, True):
            df, dg, drhs = self._loads(step, pairs, forces)
            loads = f + df, step.g + dg, step.rhs + drhs
            u, asked, w = made.ask(*loads, step.about)
            multiplier = asked.copy()
            multiplier[pairs] = np.where(opens, 0.0, forces)
            found = self.result(step, u, multiplier, w, active)
            left = self._signs(step, pairs, asked, found.y, w, step.g)
            left += np.where(opens, 0.0, self.scale * step.compliance[pairs] * forces)
            level = step.level(multiplier, found.y, self.scale)
            if corrected or np.abs(left).max() <= SIGN * level:
                break
            correction = partial(np.linalg.solve, among, left)
            forces = forces - chosen(self.operators.comm, correction)
        return found

    def _held_apart(self, step: LinearStep, found: StepResult) -> Array:
        """(n,) rows at supports, in contact, that are open. Those of both sides that are held apart
        contradict each other: elimination leaves the frame between them, and no force tells."""
        position = found.y + step.g
        least = UNBALANCED * step.level(found.multiplier, found.y, self.scale) / self.scale
        least = max(least, ROUNDED_GAP * np.abs(position).max(initial=0.0))
        gives = step.compliance * (np.abs(found.multiplier) + np.abs(step.about))
        held = found.active & step.may_open & self.operators.held
        return held & (step.L @ found.w - position - gives > least)

    def _loads(self, step: LinearStep, pairs: Array, forces: Array) -> tuple[Array, Array, Array]:
        """What is added to f, g and rhs for pairs that are to change: those out of contact get
        forces, the others gaps of forces / c."""
        closing = np.zeros(len(step.active))
        closing[pairs] = np.where(step.active[pairs], 0.0, forces)
        opening = np.zeros(len(step.active))
        opening[pairs] = np.where(step.active[pairs], forces / self.scale, 0.0)
        operators = self.operators
        pushed = times(operators.B, closing[operators.rows.numbering.mine])
        return -pushed, opening, -(step.E @ closing)

    def _signs(
        self, step: LinearStep, rows: Array, force: Array, y: Array, w: Array, g: Array
    ) -> Array:
        """What must not be negative at rows, of a solution for gaps g: forces in contact, gaps
        times c elsewhere."""
        gap = step.L[rows] @ w - y[rows] - g[rows]
        return np.where(step.active[rows], force[rows], self.scale * gap)

    def asked(self, made: SetUp, loads: Iterable[Load]) -> Iterator[tuple[Load, Answer]]:
        """Loads of this rank's f, g and rhs, each with what ``SetUp.ask`` tells."""
        loads = iter(loads)
        while block := list(islice(loads, made.columns)):
            yield from zip(block, made.ask_many(block), strict=True)

    def _choose(
        self, made: SetUp, step: LinearStep, found: StepResult, most: int
    ) -> tuple[Array, Array, Array]:
        """Pairs (k,) that have to change so that all signs are right, their forces (gaps times c,
        where they open) and (k, k) what these do to what has to vanish there: linear
        complementarity among those whose sign is or becomes wrong."""
        rows = np.flatnonzero(step.may_open)
        place = np.cumsum(step.may_open) - 1
        on = step.active[rows]
        band = SIGN * step.level(found.multiplier, found.y, self.scale)

        now = self._signs(step, rows, found.multiplier, found.y, found.w, step.g)
        pairs, new = np.empty(0, dtype=np.int64), np.flatnonzero(found.wrong)
        answers: list[Array] = []
        change, forces = np.zeros(0, dtype=bool), np.zeros(0)
        while len(new) and len(pairs) + len(new) <= 2 * most:
            loads = (self._loads(step, np.array([p]), np.ones(1)) for p in new)
            told = zip(new, self.asked(made, loads), strict=True)
            for p, ((_, g, _), (u, force, motion)) in told:
                column = self._signs(step, rows, force, self.motion(u), motion, g)
                column[place[p]] += 0.0 if on[place[p]] else self.scale * step.compliance[p]
                answers.append(column)
            pairs = np.concatenate([pairs, new])
            exchanged = partial(_exchanged, np.column_stack(answers), now, place[pairs])
            try:
                change, forces, after = chosen(self.operators.comm, exchanged)
            except np.linalg.LinAlgError:  # forces that nothing determines: all wrong ones change
                return pairs[:0], forces[:0], np.zeros((0, 0))
            new = rows[after < -band]
        columns = np.reshape(answers, (len(pairs), len(rows)))[change]
        return pairs[change], forces[change], columns[:, place[pairs[change]]].T

    def destroy(self) -> None:
        """See ``StepForm``."""
        self.release()


def _exchanged(columns: Array, now: Array, at: Array) -> tuple[Array, Array, Array]:
    """Which pairs change, (k,), with what forces (k,), and what must not be negative then, (n,).

    Args:
        columns: (n, k) by which it changes with the pairs' forces.
        now: (n,) as it is.
        at: (k,) places of the pairs.

    Raises:
        numpy.linalg.LinAlgError: nothing determines the forces.
    """
    M, q, forces = columns[at], now[at], np.zeros(len(at))
    change = complementarity(M, q, q < 0.0)
    forces[change] = np.linalg.solve(M[np.ix_(change, change)], -q[change])
    after = now + columns @ forces
    after[at] = 0.0
    return change, forces, after


def forecast_of(step: LinearStep, k: Array, found: StepResult) -> Forecast:
    """What tells which rows press next: as in the step, where its springs hold frame nodes.

    Args:
        step: the step.
        k: (n,) stiffness of rows [force / length].
        found: its result.
    """
    touch = np.where(step.active | step.may_open, k, 0.0)
    hold = np.maximum(-step.D.diagonal(), 0.0)
    return Forecast(step.L, touch, step.may_open, hold, found.w)


def with_bodies(forecast: Forecast, floating: Floating, f: Array) -> tuple[Forecast, Array]:
    """The same where bodies that contact alone holds go to where what presses balances this rank's
    loads f on them, and these loads on all."""
    L = hstack([forecast.L, -floating.G[:, : floating.count]], format="csr")
    free = np.zeros(floating.count)
    hold, w = np.append(forecast.hold, free), np.append(forecast.w, free)
    return replace(forecast, L=L, hold=hold, w=w), -floating.loads(f)


def row_stiffness(operators: ContactOperators) -> Array:
    """(n,) what a body sets against the motion of a row's node alone, about [force / length].

    Args:
        operators: of the interfaces; at prescribed dofs the stiffness of the surfaces counts.
    """
    rows = operators.rows
    mine = rows.numbering.mine
    dofs = rows.dofs[mine] - operators.dofs.first
    own = np.where(operators.dofs.fixed[dofs], operators.scale, operators.diagonal[dofs])
    stiffness = (rows.base[mine] ** 2 * own).sum(axis=1) / YIELDING
    return gather_rows(operators.comm, stiffness)[rows.numbering.number]
