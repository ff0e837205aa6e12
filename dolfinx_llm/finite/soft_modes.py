"""Motions that hardly any energy goes into, for GAMG: rigid ones, and bodies that slide."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_llm.finite.terms import ContactTerms
from dolfinx_llm.laws.rows import OPEN, STICK
from dolfinx_llm.operators.bodies import Bodies, rigid_modes, sliding_ways, two_sides
from dolfinx_llm.operators.numbering import BodyDofs


def soft_modes(
    dofs: BodyDofs,
    u: np.ndarray,
    bodies: Bodies,
    terms: Sequence[ContactTerms],
    sides: Sequence[Any],
    numbers: Sequence[np.ndarray],
) -> np.ndarray:
    """(n_local, k) motions of this rank's dofs that leave prescribed ones as they are; collective.

    Args:
        dofs: of the bodies.
        u: (n_local,) where they are.
        bodies: which of them is which.
        terms, sides, numbers: of the interfaces, with their surfaces and coordinates' dofs.
    """
    x = bodies.points + u.reshape(-1, dofs.gdim)
    low = np.min(dofs.comm.allgather(x.min(axis=0, initial=np.inf)), axis=0)
    high = np.max(dofs.comm.allgather(x.max(axis=0, initial=-np.inf)), axis=0)
    rigid = rigid_modes((x - 0.5 * (low + high)) / np.linalg.norm(high - low))
    ties: list[np.ndarray] = []
    meets: list[np.ndarray] = []
    normals = [np.zeros((0, dofs.gdim))]
    labels = dofs.spread(bodies.label)
    for t, surfaces, at in zip(terms, sides, numbers, strict=True):
        closed = t.status != OPEN
        if surfaces.frame is None or not closed.any():
            continue
        ends = dofs.values(at[list(surfaces.first)], labels).astype(int)
        slides = closed & (t.status != STICK)
        (meets if slides.any() else ties).append(ends)
        normals.append(t.place.normal[slides])
    every = np.concatenate(normals)
    modes = rigid.reshape(len(u), -1)
    if len(every):
        pairs = [np.reshape(np.array(ends, dtype=int), (-1, 2)) for ends in (ties, meets)]
        side = two_sides(bodies.count, *pairs)[bodies.label]
        sliding = 0.5 * side[:, None, None] * sliding_ways(every)
        modes = np.hstack([modes, sliding.reshape(len(u), -1)])
    return np.where(dofs.fixed[:, None], 0.0, modes)
