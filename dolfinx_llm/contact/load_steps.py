"""Load steps: applied in parts, taken back and halved where one does not converge."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from scipy.sparse import diags

from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.contact.iteration import ContactIteration
from dolfinx_llm.forms.step import StepResult
from dolfinx_llm.forms.verdict import FinalError, judge

log = logging.getLogger("dolfinx_llm")

SMALLEST = 1.0 / 16.0  # part of an increment that is tried before giving up


def advance(
    iteration: ContactIteration, f: np.ndarray, g: np.ndarray, increments: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One load step to this rank's load f and gaps g, in parts; halved where one fails.

    Args:
        iteration: where the last load step ended.
        f: (n_local,) prescribed values at fixed dofs [force, length].
        g: (n,) [length].
        increments: equal parts to begin with.

    Returns:
        u of this rank, λ (n,) and the frames' displacement (n_v,).

    Raises:
        ContactError: no convergence even in small parts; the iteration is then where it was.
    """
    equations = iteration.equations
    start = iteration.f, iteration.g, equations.loads
    end = f, g, equations.frame_loads()
    done, part = 0.0, 1.0 / increments
    iteration.history = []
    first = iteration.snapshot()
    while done < 1.0 - 1e-9:
        reached = min(done + part, 1.0)
        now = [a + reached * (b - a) for a, b in zip(start, end, strict=True)]
        f_t, g_t, equations.loads = end if reached > 1.0 - 1e-9 else now
        before = iteration.snapshot()
        try:
            found = iteration.iterate(f_t, g_t)
        except (FinalError, ContactInputError):  # smaller parts are of no help
            iteration.restore(first)
            raise
        except ContactError as failed:
            iteration.restore(before)
            if part <= SMALLEST / increments:
                iteration.restore(first)
                raise ContactError(
                    f"{failed}. Parts down to {part:.3g} of the step did not help"
                ) from failed
            part /= 2.0
            log.info("no convergence: the load is applied in parts of %.3g", part)
            continue
        try:
            u = _judged(iteration, found)
        except ContactError:
            iteration.restore(first)
            raise
        iteration.accept(found, g_t)
        done = reached
    iteration.f, iteration.g = f, g
    return u, found.multiplier, found.w[: iteration.equations.n_v]


def _judged(iteration: ContactIteration, found: StepResult) -> np.ndarray:
    """u of this rank, once its equations hold."""
    form, equations = iteration.form, iteration.equations
    u, left, terms, loads = form.displacement(found)
    largest = [np.abs(a).max(initial=0.0) for a in (loads, found.multiplier)]
    iteration.forces = max(iteration.forces, float(np.max(form.comm.allgather(largest))))
    verdict = judge(form.comm, left, terms, iteration.forces, form.name)
    on = diags(equations.closed_rows().astype(float))
    drift = form.floating.drift((on @ equations.L[:, : equations.n_v]).tocsr())
    iteration.verdict = replace(verdict, drift=drift)
    for words in iteration.verdict.lost if form.comm.rank == 0 else []:
        log.warning(words)
    return u
