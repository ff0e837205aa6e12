"""What is asked of obstacles and laws, set aside for a while: as steps in time start."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import numpy as np

from dolfinx_llm.laws.coulomb import Coulomb
from dolfinx_llm.laws.law import Law

LED_BY = ("displacement", "rotation", "mean")  # of obstacles


@contextmanager
def _given(objects: Sequence[Any], values: Sequence[dict[str, Any]]) -> Iterator[None]:
    """For a while attributes of some objects, frozen ones as well, have other values."""
    pairs = list(zip(objects, values, strict=True))
    kept = [(one, name, getattr(one, name)) for one, given in pairs for name in given]
    try:
        for one, given in pairs:
            for name, value in given.items():
                object.__setattr__(one, name, value)
        yield
    finally:
        for one, name, value in kept:
            object.__setattr__(one, name, value)


def unmoved(obstacles: Sequence[Any]) -> AbstractContextManager[None]:
    """For a while, of obstacles: what is prescribed of their motion is none."""
    led = [{k: _none_of(v) for k, v in vars(o).items() if k in LED_BY} for o in obstacles]
    return _given(obstacles, led)


def slippery(laws: Sequence[Law]) -> AbstractContextManager[None]:
    """For a while Coulomb's laws bear no friction: where bodies came from tells how they slide, and
    nothing of what acted there. With a dynamic coefficient it tells which nodes did, too."""
    rough = [law for law in laws if isinstance(law, Coulomb) and law.dynamic is None]
    return _given(rough, [{"mu": 0.0, "cohesion": 0.0}] * len(rough))


def _none_of(value: Any) -> Any:
    """Zeros, but None where a force is prescribed."""
    if value is None or np.ndim(value) == 0:
        return None if value is None else 0.0
    return tuple(None if part is None else 0.0 for part in value)
