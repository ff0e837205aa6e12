"""Frames that have been held firmly, and are let go once contact has come to rest.

What firm springs bear then falls to the bodies. Corrected rows pass forces on beside contact, which
die out from frame node to frame node: each goes far until it touches, and to solve for them one by
one takes a step each. Bodies hardly move by such forces, so that the balance of frames tells all of
them at once.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import chosen
from dolfinx_llm.contact.equations.equations import Equations, on_frames
from dolfinx_llm.contact.search.iterate import Iterate
from dolfinx_llm.forms.exchange import forecast_of, row_stiffness, with_bodies
from dolfinx_llm.forms.step import SOFT, LinearStep

SPARED = 1e-9  # of the largest force: firm springs that bear less are let go as they are


def let_go(equations: Equations, step: LinearStep, share: float, now: Iterate, f: Array) -> Array:
    """(m,) where frames are once they are held weakly; interfaces take over which pairs press then.
    With friction frames are placed along their normals, and bodies stay. Collective.

    Args:
        equations: of the laws.
        step: the last one, with what is in contact, in which frames were held firmly.
        share: how weakly, over that.
        now: what the step has found.
        f: this rank's load.
    """
    loses = now.drawn > SPARED and step.may_open.any()
    operators, m = equations.operators, len(now.w)
    rubs = any(s.law.slips and not s.law.follows for s in equations.states)
    gives = step.compliance.max(initial=0.0) * operators.scale > (10.0 * SOFT if rubs else 0.0)
    if not loses or gives or not (step.symmetric or rubs):
        return now.w
    forecast = forecast_of(step, row_stiffness(operators), now.result)
    forecast = replace(forecast, hold=share * forecast.hold)
    if step.symmetric:
        at = np.arange(m)
        forecast, loads = with_bodies(forecast, operators.floating, f)
        target = np.append(np.zeros(m), loads)
    else:
        forecast, at = forecast.normal()
        if (at >= equations.n_v).any():  # jumps that a law gives way by
            return now.w
        left = on_frames(equations, now.multiplier, now.w) - equations.loads
        target = forecast.borne(now.multiplier) - left[at]
    settled = partial(forecast.settled, now.multiplier, now.position, target)
    pressing, found = chosen(operators.comm, settled)
    w = now.w.copy()
    w[at] = found[: len(at)]
    active = np.where(step.may_open, pressing, step.active)
    for s in equations.states:
        if s.law.opens:
            s.touch(active[s.nodes.rows[:, -1]])
    return w
