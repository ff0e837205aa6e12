"""Where load steps end: all that the next one goes on from, in one place."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.contact.equations.state import ContactState, InterfaceState
from dolfinx_llm.forms.step import LinearStep
from dolfinx_llm.forms.verdict import Verdict


@dataclass(frozen=True, eq=False)
class Reached:
    """Where a load step has ended, all that the next one goes on from; but for f the same on every
    rank."""

    states: list[ContactState]  # of the interfaces
    loads: Array  # (n_v,) on the frame unknowns [force]
    multiplier: Any  # (n,) λ [force]; None before a solve
    w: Any  # (m,) frame and slip unknowns [length]
    alpha: Any  # (count,) rigid motion of bodies that nothing else holds
    f: Array  # (n_local,) load of this rank
    g: Array  # (n,) gaps [length]
    forces: float  # largest at the start and the end, by which it was judged [force]
    ended: float  # largest at its end [force]
    moved: float  # how far bodies have moved at their surfaces, at most [length]
    rounding: float  # of forces that were found from the last ones [force]
    rounded: float  # of these by themselves [force]
    felt: float  # what contact forces make of it, at most, and of what has slipped by it [force]
    verdict: Verdict  # of the last load step
    last: LinearStep | None  # of the last iteration
    history: list[dict[str, Any]]  # of the last load step


ATTRIBUTES = [one.name for one in fields(Reached) if one.name not in ("states", "loads")]


def untied(states: list[InterfaceState]) -> list[ContactState]:
    """Their own states as they are, but for ties, which are to be chosen anew."""
    return [replace(s.own.copy(), ties=None) for s in states]


def take_back(states: list[InterfaceState], to: list[ContactState]) -> None:
    """Have interfaces go on from other states of their own."""
    for state, kept in zip(states, to, strict=True):
        state.restore(kept)
