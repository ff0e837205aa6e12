"""What is asked of obstacles, laws and loads, for a while another thing: nothing as steps in time
start, a part of it in those that are divided."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.interface.obstacles import MeanDisplacement
from dolfinx_llm.laws.coulomb import Coulomb
from dolfinx_llm.laws.law import Law
from dolfinx_llm.laws.tied import Tied

LED_BY = "displacement", "rotation"  # obstacles are


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


def numbers(problem: Any) -> Array:
    """(k,) what its obstacles, ties and follower pressures are given now, NaN where that is None.

    Raises:
        ContactInputError: as of ``solve``.
    """
    gdim = problem.spaces[0].mesh.geometry.dim
    every = [_given_now(one, gdim) for one in _leaders(problem)]
    flat = [np.asarray(value, dtype=float).ravel() for given in every for value in given.values()]
    return np.concatenate([np.zeros(0), *flat])


def on_the_way(problem: Any, before: Array, part: float) -> AbstractContextManager[None]:
    """For a while they are given this part, in (0, 1], of what has changed since ``numbers`` were
    ``before`` (k,); what was None is what it is now."""
    leaders, gdim = _leaders(problem), problem.spaces[0].mesh.geometry.dim
    now, values, first = numbers(problem), [], 0
    there = np.where(np.isnan(before), now, now + (1.0 - part) * (before - now))
    for one in leaders:
        parts = {}
        for name, value in _given_now(one, gdim).items():
            size, several = np.size(value), np.ndim(value) > 0
            found = [None if np.isnan(x) else float(x) for x in there[first : first + size]]
            parts[name], first = tuple(found) if several else found[0], first + size
        values.append(parts)
    return _given(leaders, values)


def _leaders(problem: Any) -> list[Any]:
    """Obstacles, ties and follower pressures."""
    obstacles = [i.obstacle for i in problem.interfaces if i.obstacle is not None]
    ties = [i.law for i in problem.interfaces if isinstance(i.law, Tied)]
    return [*obstacles, *ties, *getattr(problem, "loads", ())]


def _given_now(one: Any, gdim: int) -> dict[str, Any]:
    """By name what one of them is given, numbers and tuples."""
    if isinstance(one, Tied):
        return {"gap": one.given_gap}
    if not hasattr(one, "pose"):
        return {"p": one.value()}
    shift, turn, _, force, moment = one.pose(gdim)
    if isinstance(one, MeanDisplacement):
        return {"mean": tuple(one.mean)}
    if gdim == 2:  # angle and moment are numbers
        (turn,), (moment,) = turn, moment
    return {"displacement": shift, "rotation": turn, "force": force, "moment": moment}


def unmoved(obstacles: Sequence[Any]) -> AbstractContextManager[None]:
    """For a while, of obstacles: what is prescribed of their motion is none."""
    names = [("mean",) if isinstance(o, MeanDisplacement) else LED_BY for o in obstacles]
    of = zip(obstacles, names, strict=True)
    return _given(obstacles, [{k: _none_of(getattr(o, k)) for k in led} for o, led in of])


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
