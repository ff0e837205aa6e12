"""What in a solution the method does not allow for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_llm.contact.results import InterfaceResult
from dolfinx_llm.interface.geometry import ContactModel
from dolfinx_llm.laws.coulomb import OPEN

LOOSE_SHARE = 1e-3  # of the normal force, on pairs without friction of their own


def doubts(
    models: Sequence[ContactModel], results: Sequence[InterfaceResult], states: Any = None
) -> list[str]:
    """What in a solution lies outside of what the method allows for: contact at the rim of what may
    touch, sliding farther than a facet, pairs that lost their friction."""
    out = []
    for state, result in zip(states or [], results):
        share = state.loose_share([side.normal_force for side in result.sides])
        if share > LOOSE_SHARE:
            out.append(
                f"interface {state.model.interface.name}: pairs that opened and closed by turns "
                f"have been left without friction of their own, and carry {share:.1%} of the "
                "normal force. Apply the load in more increments"
            )
    for model, result in zip(models, results, strict=True):
        for pairs, side, rim in zip(model.pairs, result.sides, model.rims, strict=True):
            reached = int((rim & (side.status != OPEN)).sum())
            if reached:
                out.append(
                    f"interface {model.interface.name}: contact reaches {reached} node(s) at the "
                    f"rim of what {pairs.surface.name} may touch with; facets beyond were left out "
                    "as too steep. Check the tags, or split the surface into several interfaces"
                )
            closed = side.status != OPEN
            slip = np.linalg.norm(side.slip[closed], axis=1).max(initial=0.0)
            size = np.abs(pairs.forces).max() ** (1.0 / (side.x.shape[1] - 1))
            if model.interface.law.unilateral and slip > size:
                out.append(
                    f"interface {model.interface.name}: nodes of {pairs.surface.name} slide by "
                    f"{slip:.3g}, more than a facet's size, {size:.3g}: contact is found for the "
                    "drawn positions (small sliding). Move the bodies in the drawing instead"
                )
    return out
