"""Iterates that come back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

ALIKE_AGAIN = 1e-3  # relative difference of residuals that are the same


def comes_back(residuals: Sequence[float], n: int) -> bool:
    """Whether the last n residuals are those of the n iterations before.

    >>> comes_back([3.0, 1.0, 2.0, 1.0, 2.0], 2), comes_back([1.0, 2.0], 1), comes_back([1.0], 1)
    (True, False, False)
    """
    last = residuals[-2 * n :]
    return len(last) == 2 * n and np.allclose(last[n:], last[:n], rtol=ALIKE_AGAIN, atol=0.0)
