"""Results of interfaces at finite deformation as arrays with names, and made of these again."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.finite.results import MovingInterfaceResult, MovingSideResult
from dolfinx_llm.geometry.frame import Frame


def arrays_of(result: MovingInterfaceResult) -> dict[str, Array]:
    """All that it holds."""
    found = _own(result, "") | _own(result.frame, "frame ")
    for k, side in enumerate(result.sides):
        found |= _own(side, f"side {k} ")
    return found


def result_of(arrays: dict[str, Array]) -> MovingInterfaceResult:
    """The result of which ``arrays_of`` are given."""
    sides = [
        MovingSideResult(**_named(MovingSideResult, arrays, f"side {k} "))
        for k in (0, 1)
        if f"side {k} x" in arrays
    ]
    own: dict[str, Any] = _named(MovingInterfaceResult, arrays, "")
    own["correction"] = float(own["correction"])
    frame = Frame(**_named(Frame, arrays, "frame ")) if "frame x" in arrays else None
    return MovingInterfaceResult(frame=frame, sides=tuple(sides), **own)


def _own(part: Any, start: str) -> dict[str, Array]:
    """Numbers among the fields of a dataclass, or of none."""
    every = {} if part is None else {f.name: getattr(part, f.name) for f in fields(part)}
    numbers = {name: v for name, v in every.items() if isinstance(v, (np.ndarray, float))}
    return {start + name: np.asarray(value) for name, value in numbers.items()}


def _named(kind: Any, arrays: dict[str, Array], start: str) -> dict[str, Array]:
    """Those of a dataclass's fields."""
    return {f.name: arrays[start + f.name] for f in fields(kind) if start + f.name in arrays}
