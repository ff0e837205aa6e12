"""What the iterations of a load step so far tell of those to come."""

from __future__ import annotations

from typing import Any

import numpy as np

CIRCLE = (2, 3)  # iterations in one
CIRCLES = 1e-3  # relative difference of residuals that are the same


def comes_back(history: list[dict[str, Any]]) -> bool:
    """Whether the last two or three iterates miss the laws as those before did: a known bound of
    friction leads out of circles."""
    residuals = [h["residual"] for h in history]
    return any(
        len(residuals) >= 2 * n
        and bool(np.allclose(residuals[-n:], residuals[-2 * n : -n], rtol=CIRCLES, atol=0.0))
        for n in CIRCLE
    )


def failure(history: list[dict[str, Any]]) -> str:
    """Words for a load step that came to no rest, with its last iterations."""
    last = history[-5:]
    return (
        f"the contact law did not converge in {len(history)} iterations; the last changed "
        f"{[h['changes'] for h in last]} states, with residuals "
        f"{', '.join(format(h['residual'], '.1e') for h in last)}. Apply the load in smaller "
        "steps (solve(increments=...)), and check that supports hold the bodies when they slip"
    )
