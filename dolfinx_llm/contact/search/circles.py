"""Iterates of a load step that come back, and what is said where it does not converge."""

from __future__ import annotations

from typing import Any

from dolfinx_llm.base.iterates import comes_back

CIRCLE = range(2, 7)  # iterations in one


class Circles:
    """Iterates that come back. Friction with the bound of the last iterate leads out of most
    circles that there are without, and the other way round.

    Args:
        history: of the load step, which grows.
    """

    def __init__(self, history: list[dict[str, Any]]) -> None:
        self._history, self._since, self._lags = history, len(history), False

    def lag(self, restless: bool) -> bool:
        """Whether friction is to have the bound of the last iterate, as long as contact is
        restless."""
        missed = [h["residual"] for h in self._history[self._since :]]
        if any(comes_back(missed, n) for n in CIRCLE):
            self._lags, self._since = not self._lags, len(self._history)
        self._lags = self._lags and restless
        return self._lags


UNSETTLED = "the contact law did not converge"


def failure(history: list[dict[str, Any]]) -> str:
    """Words for a load step that came to no rest, with its last iterations."""
    last = history[-5:]
    return (
        f"{UNSETTLED} in {len(history)} iterations; the last changed "
        f"{[h['changes'] for h in last]} states, with residuals "
        f"{', '.join(format(h['residual'], '.1e') for h in last)}. Apply the load in smaller "
        "steps (solve(increments=...)), and check that supports hold the bodies when they slip"
    )
