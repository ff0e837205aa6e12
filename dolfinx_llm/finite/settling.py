"""Which pairs touch in the linear model of an iteration, before its bodies move.

Pairs that pull open and those that overlap close, all at once, and the model is solved again. Where
that leaves no fewer wrong ones for a while, one of them changes alone, until there are fewer than
ever: block principal pivoting, which single exchanges bring to an end wherever those do
(J. J. Judice, F. M. Pires, Computers & Operations Research 21 (1994) 587-596). Stiff bodies on the
few nodes of a soft one need it: their pairs go in and out for ever if all change at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.finite.pairs.terms import ContactTerms, Held, Origin, Place, moved
from dolfinx_llm.laws.rows import OPEN, SLIP, STICK

EXCHANGES = 60  # solves of a linear model, at most
WAITS = 3  # solves that may leave no fewer wrong pairs, before single exchanges


@dataclass
class Exchanges:
    """Which of the pairs that are wrong change, from solve to solve."""

    least: float = np.inf  # wrong pairs so far
    left: int = WAITS
    tried: set[bytes] = field(default_factory=set)  # pairs of which one changed, with that least

    def take(
        self, now: Sequence[Array], before: Sequence[Array], held: Sequence[Held]
    ) -> dict[int, Array]:
        """Status of the pairs to solve for next, per interface where some change.

        Args:
            now, before: per interface (n,) status as the model says, and as was put in.
            held: of the interfaces.
        """
        of = zip(now, before, held, strict=True)
        asked = [i for i, (a, b, h) in enumerate(of) if differ(a, b, h.origin)]
        wrong = {i: np.flatnonzero((now[i] != OPEN) != (before[i] != OPEN)) for i in asked}
        count = sum(map(len, wrong.values()))
        if asked and count < self.least:
            self.least, self.left, self.tried = count, WAITS, set()
        elif asked:
            self.left -= 1
        if self.left >= 0:
            return {i: now[i] for i in asked}
        key = b"".join((status != OPEN).tobytes() for status in before)
        if not count or key in self.tried:
            return {}  # friction alone goes to and fro, or all does: no solution is told
        self.tried.add(key)
        last = max(i for i in asked if len(wrong[i]))
        found, pair = before[last].copy(), wrong[last][-1]
        found[pair] = now[last][pair]
        return {last: found}


def foreseen(
    contact: Any, t: ContactTerms, q: Array, changes: tuple[Array, Array], held: Held, reach: float
) -> tuple[Array, Place]:
    """(n,) status of the pairs in the linear model, and how they stand there.

    Args:
        contact: an interface whose pairs settle by themselves.
        t: its terms as they are.
        q: own unknowns.
        changes: (width,) of the coordinates, and of own unknowns.
        held: from the start of the step.
        reach: gap that is none [length].
    """
    (dz, dq), place = changes, t.place
    then = replace(moved(place, contact.nearing(place, dz, dq)), z=place.z + dz)
    before = np.where(place.pairs & (t.status == OPEN), contact.pressed[-1], t.status)
    return contact.touching(then, q + dq, before, held, reach)[0], then


def differ(now: Array, before: Array, origin: Origin | None) -> bool:
    """Whether pairs of status (n,) in the linear model are to be solved for again: others touch,
    all slip, or some that slipped turn round, and stick first: bodies would go far the other way
    under friction that drives them. Else, where some stick, it says little of which, and iterates
    tell where nodes land that had a gap (``origin``, with friction): Newton's iteration finds them
    sooner alone."""
    lands = origin is not None and _to_meet(origin) & (now != OPEN)
    touch = ((now != OPEN) != (before != OPEN)).any()
    turns = ((now == STICK) & (before == SLIP)).any()
    again = (now != before).any() and (touch or turns or STICK not in now)
    return bool(again and not np.any(lands))


def lands(held: list[Held]) -> bool:
    """Whether pairs with friction may yet meet for the first time: what counts as slip is kept of
    that iterate, and must not depend on how well it was solved for."""
    return any(bool(_to_meet(h.origin).any()) for h in held if h.origin is not None)


def _to_meet(origin: Origin) -> Array:
    """(n,) pairs with friction that have not met yet."""
    return origin.drags & (origin.gap > 0.0) & ~origin.touched


def opened_or_closed(now: Sequence[Array], before: Sequence[Array]) -> int:
    """How many pairs of status (n,) per interface touch in one of two states alone."""
    both = zip(now, before, strict=True)
    return sum(int(((a != OPEN) != (b != OPEN)).sum()) for a, b in both)
