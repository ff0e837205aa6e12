"""What the linear model of an iteration says of an interface before its bodies move."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx_llm.finite.terms import ContactTerms, Held, MovingContact, Place, moved
from dolfinx_llm.laws.rows import CLOSED, OPEN


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
    every = np.where(pairs, CLOSED, OPEN)
    rows = contact.terms(place, np.zeros(len(q)), every, held, np.ones(len(dz), dtype=bool)).left
    then = moved(place, (rows @ dz)[:n])
    return contact.touching(then, q, every, held, reach)[0]
