"""Obstacles that are where they were drawn, whatever is prescribed of their motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

LED_BY = ("displacement", "rotation", "mean")  # of obstacles


@contextmanager
def unmoved(obstacles: Sequence[Any]) -> Iterator[None]:
    """For a while, of obstacles: what is prescribed of their motion is none."""
    kept = [{k: v for k, v in vars(o).items() if k in LED_BY} for o in obstacles]
    try:
        for obstacle, motions in zip(obstacles, kept, strict=True):
            for name, value in motions.items():
                setattr(obstacle, name, _none_of(value))
        yield
    finally:
        for obstacle, motions in zip(obstacles, kept, strict=True):
            for name, value in motions.items():
                setattr(obstacle, name, value)


def _none_of(value: Any) -> Any:
    """Zeros, but None where a force is prescribed."""
    if value is None or np.ndim(value) == 0:
        return None if value is None else 0.0
    return tuple(None if part is None else 0.0 for part in value)
