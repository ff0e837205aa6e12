"""Load steps: applied in parts, taken back and halved where one does not converge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.log import log, warn
from dolfinx_llm.contact.iteration import ContactIteration
from dolfinx_llm.contact.limit_analysis import unbalanced
from dolfinx_llm.contact.neutral import neutral
from dolfinx_llm.contact.search.reached import Reached, take_back, untied
from dolfinx_llm.forms.step import StepResult
from dolfinx_llm.forms.verdict import (
    EPS,
    SEVERAL,
    UNBALANCED,
    FinalError,
    Imprecise,
    Verdict,
    beyond,
    check_lost,
    judge,
    largest,
    size,
)
from dolfinx_llm.operators.petsc import times
from dolfinx_llm.operators.support import least_squares
from dolfinx_llm.operators.system import FLUSH

AT_STAKE = 1e-12  # of contact forces: rounding of stiffness times displacement that may matter
TORN = 1e-3  # of motions, by which rows of ties may be missed, as those of chords are
SMALLEST = 1.0 / 16.0  # part of an increment that is tried before giving up


def advance(
    iteration: ContactIteration, f: Array, g: Array, increments: int, instead: Callable[[str], str]
) -> tuple[Array, Array, Array, Reached]:
    """One load step to this rank's load f and gaps g, in parts; where one fails another form goes
    on, if there is one, else halves.

    Args:
        iteration: where the last load step ended.
        f: (n_local,) prescribed values at fixed dofs [force, length].
        g: (n,) [length].
        increments: equal parts to begin with.
        instead: have another form solve steps from now on, and say which; "" if none is left. Told
            in words how this one has failed.

    Returns:
        u of this rank, λ (n,), the frames' displacement (n_v,), and the ``snapshot`` where the last
        part began.

    Raises:
        ContactError: no convergence even in small parts. The iteration is somewhere on the way
            then, as after any other error: the caller takes it back.
    """
    equations = iteration.equations
    start = iteration.f, iteration.g, equations.loads
    end = f, g, equations.frame_loads()
    tied = iteration.operators.tied  # a part is as hard as the whole
    done, part, tried = 0.0, 1.0 if tied else 1.0 / increments, ""
    for state in iteration.states:
        state.read()
    # Loads that go back to zero leave rounding of those at the start.
    iteration.forces, iteration.pressed = iteration.ended, size(equations.loads)
    iteration.history = []
    while done < 1.0 - 1e-9:
        reached = min(done + part, 1.0)
        now = [a + reached * (b - a) for a, b in zip(start, end, strict=True)]
        f_t, g_t, equations.loads = end if reached > 1.0 - 1e-9 else now
        before = iteration.snapshot()
        falls = unbalanced(equations, iteration.operators.floating, f_t, equations.loads)
        try:
            found = _iterated(iteration, before, f_t, g_t, falls, reached)
        except (FinalError, ContactInputError):  # smaller parts are of no help
            raise
        except ContactError as failed:
            if tied:
                raise
            if told := falls():
                raise told from failed
            iteration.restore(before)
            if other := instead("contact came to no rest"):
                tried = f"{failed}. {other}: "
                continue
            if part <= SMALLEST / increments:
                raise ContactError(
                    f"{tried}{failed}. Parts down to {part:.3g} of the step did not help"
                ) from failed
            take_back(iteration.states, untied(iteration.states))
            part /= 2.0
            log.info("no convergence: the load is applied in parts of %.3g", part)
            continue
        try:
            u = _judged(iteration, found, f_t, g_t)
        except Imprecise as failed:  # slender bodies lose digits in some forms, not in all
            iteration.restore(before)
            if tied or not (other := instead("solves left too much of the forces")):
                raise
            tried = f"{failed}. {other}: "
            continue
        iteration.accept(found, g_t)
        done = reached
    iteration.f, iteration.g = f, g
    return _settled(iteration, u), found.multiplier, iteration.w[: equations.n_v], before


def _settled(iteration: ContactIteration, u: Array) -> Array:
    """This rank's u without the motions that carry no force; the frames go with the bodies."""
    equations, floating = iteration.equations, iteration.operators.floating
    strayed = floating.strayed(u)
    if not strayed.any():
        return u
    L, n_v = equations.L[:, : equations.n_v], equations.n_v
    moved = floating.G[:, : floating.count] @ strayed
    iteration.w, iteration.alpha = iteration.w.copy(), iteration.alpha - strayed
    if n_v:
        iteration.w[:n_v] -= least_squares(L, moved[:, None])[:, 0]
    return u - floating.modes @ strayed


def _iterated(
    iteration: ContactIteration,
    start: Reached,
    f: Array,
    g: Array,
    falls: Callable[[], Any],
    part: float,
) -> StepResult:
    """The iteration from its start to a part of the load step, which the history says."""
    first = len(iteration.history)
    try:
        return iteration.iterate(start, f, g, falls)
    finally:
        for entry in iteration.history[first:]:
            entry["part"] = part


def _judged(iteration: ContactIteration, found: StepResult, f: Array, g: Array) -> Array:
    """u of this rank, once the equations hold for its load f and the gaps g."""
    form, equations, operators = iteration.form, iteration.equations, iteration.operators
    free, u, multiplier = ~operators.dofs.fixed, form.displacement(found), found.multiplier
    pushed = times(operators.B, multiplier[operators.rows.numbering.mine])
    stiffness, moved, left, terms, *forces = largest(
        operators.comm,
        free * operators.diagonal,
        ~free * u,
        free * form.left(f, u, multiplier),
        free * operators.diagonal * u,
        free * f,
        free * pushed,
    )
    iteration.ended, before = max(forces), iteration.rounded
    iteration.forces = max(iteration.forces, iteration.ended)
    iteration.rounded = SEVERAL * EPS * max(terms, size(multiplier))
    iteration.rounding = max(before, iteration.rounded)
    follows = equations.L @ found.w + equations.compliance * multiplier
    _see_torn(iteration, found.y, follows, g)
    # Of rows in contact, before and after the last step: where it is open, or opens without a
    # force, gaps of any size carry none.
    closed = found.active & equations.closed_rows()
    y, follows, g = (closed * a for a in (found.y, follows, g))
    apart, *motions = (operators.scale * size(a) for a in (y - follows + g, y, follows, g))
    left = max(left, beyond(apart, max(motions)))
    unheld = equations.imbalance(multiplier, found.w)
    verdict = Verdict(0.0, 0.0)  # where free dofs carry no force
    # Gaps that may close are differences of positions, whose rounding is no force.
    positions = 0.0 if operators.tied else operators.bodies.farthest
    far = stiffness * max(moved, size(g), positions)
    if beyond(max(left, unheld, iteration.forces), far):
        # Where next to nothing presses frames are left with it.
        rounds = max(terms, far) if left <= UNBALANCED * iteration.forces < unheld else terms
        left = max(left, unheld)
        verdict = judge(left, rounds, iteration.forces, form.describe(), form.tolerance)
    check_lost(verdict)
    most = size(multiplier)
    # What has slipped before by rounding sticks there.
    felt = iteration.felt if any(s.law.slips for s in iteration.states) else 0.0
    if form.factorised and iteration.rounded < most < EPS * terms / AT_STAKE:
        felt = max(felt, EPS * _felt(iteration, f, u))
    iteration.felt, felt = felt, felt / most if most > iteration.rounded else 0.0
    drift = operators.floating.drift(equations.L, equations.n_v, equations.closed_rows())
    left_open = neutral(equations, operators.floating, multiplier)
    said = iteration.verdict.lost
    iteration.verdict = replace(verdict, felt=felt, drift=drift, neutral=left_open)
    warn(operators.comm, iteration.verdict.lost, said)
    return u


def _see_torn(iteration: ContactIteration, y: Array, follows: Array, g: Array) -> None:
    """By how much ties have left what they follow (n,), also in rows that are left out: by more
    than chords do, and than positions are rounded by."""
    least = TORN * max(map(size, (y, follows, g)))
    least += FLUSH * iteration.operators.bodies.farthest
    for s in iteration.states:
        if s.law.ties:
            opened: Array = (y + g - follows)[s.nodes.rows]
            s.torn = np.linalg.norm(np.where(np.abs(opened) > least, opened, 0.0), axis=1)


def _felt(iteration: ContactIteration, f: Array, u: Array) -> float:
    """Largest contact force [force] that answers to forces of the sizes that are summed up in
    K u - f, of random signs, with the pairs in contact as they are: their size alone does not tell
    what slender bodies, whose ends they bend, make of their rounding."""
    form, operators = iteration.form, iteration.operators
    free, random = ~operators.dofs.fixed, np.random.default_rng(2001 + operators.comm.rank)
    signs = random.choice([-1.0, 1.0], (2, len(u)))
    summed = form.left(0.0 * f, signs[0] * free * u, np.zeros(iteration.equations.n))
    load = free * signs[1] * (np.abs(summed) + np.abs(f))
    return size(form.solve(load, iteration.last.unloaded()).multiplier)
