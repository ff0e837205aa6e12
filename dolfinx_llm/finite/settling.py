"""What the linear model of an iteration says of an interface before its bodies move."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from dolfinx_llm.finite.terms import ContactTerms, Held, MovingContact, Origin, Place, moved
from dolfinx_llm.laws.rows import OPEN, STICK


def slide(contact: MovingContact, terms: ContactTerms, dz: np.ndarray) -> float:
    """How far nodes in contact slide over the other side for changes dz (width,) [length]."""
    on, n = terms.status != OPEN, terms.place.normal
    jump = (contact.sides.jumps(terms.place.N) @ dz).reshape(n.shape)
    jump -= np.einsum("ni,ni->n", jump, n)[:, None] * n
    return float(np.linalg.norm(jump[on], axis=1).max(initial=0.0))


def foreseen(
    contact: Any, place: Place, changed: tuple[np.ndarray, np.ndarray], held: Held, reach: float
) -> np.ndarray:
    """(n,) status of the pairs in the linear model.

    Args:
        contact: an interface whose pairs settle by themselves.
        place: as it is.
        changed: (width,) changes of the coordinates, and own unknowns after them.
        held: from the start of the step.
        reach: gap that is none [length].
    """
    dz, q = changed
    n, pairs = len(place.gap), place.pairs
    every = np.where(pairs, contact.pressed[0], OPEN)
    rows = contact.terms(place, np.zeros(len(q)), every, held, np.ones(len(dz), dtype=bool)).left
    then = replace(moved(place, (rows @ dz)[:n]), z=place.z + dz)
    return contact.touching(then, q, every, held, reach)[0]


def differ(now: np.ndarray, before: np.ndarray, origin: Origin | None) -> bool:
    """Whether pairs of status (n,) in the linear model are to be solved for again: others touch, or
    all slip. Where some of the same stick it says little of which, and iterates tell where nodes
    land that had a gap (``origin``, with friction): Newton's iteration finds them sooner alone."""
    lands = origin is not None and (origin.gap > 0.0) & ~origin.touched & (now != OPEN)
    touch = ((now != OPEN) != (before != OPEN)).any()
    again = (now != before).any() and (touch or STICK not in now)
    return bool(again and not np.any(lands))


def lands(held: list[Held]) -> bool:
    """Whether pairs with friction may yet meet for the first time: what counts as slip is kept of
    that iterate, and must not depend on how well it was solved for."""
    origins = [h.origin for h in held if h.origin is not None]
    return any(bool(((o.gap > 0.0) & ~o.touched).any()) for o in origins)
