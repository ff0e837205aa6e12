"""Motions of bodies that contact as it has been found leaves open, and on which loads do no work.

A plate that balances on a point, or a body of which all slips: forces are unique there, the
displacement is not.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import hstack, identity
from scipy.sparse.linalg import splu

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal
from dolfinx_llm.contact.equations.equations import Equations
from dolfinx_llm.laws.coulomb import Coulomb
from dolfinx_llm.laws.rows import STICK
from dolfinx_llm.operators.floating import Floating

SINGULAR = 1e-14  # of the squares of rows, added so that they can be factorised
INVERSE = 4  # inverse ones, from a motion by chance
PRESSES = 1e-8  # of the largest force, up to which pairs touch without force
OPEN_SHARE = 1e-8  # of a motion, up to which rows in contact may feel it
ROUND_SHARE = 1e-3  # the same on curved facets of second order, which are round but for so much


def neutral(equations: Equations, floating: Floating, multiplier: Array) -> str:
    """Words for such a motion, the same on every rank; empty where there is none. Pairs that touch
    without force leave it open to where they part.

    Args:
        equations: of the laws, with the state of contact that has been found.
        floating: motions that supports leave free; what no contact holds in any state is left out.
        multiplier: (n,) that has been found [force].
    """
    if floating.count == floating.loose.count:
        return ""
    closed, size = equations.closed_rows(), np.abs(multiplier)
    idle = closed & equations.normal & (size <= PRESSES * size.max(initial=0.0))
    motion, felt, ways = _motion(equations, floating, closed & ~idle, idle)
    if idle.any() and (ways > OPEN_SHARE).any() and (ways < -OPEN_SHARE).any():
        motion, felt, _ = _motion(equations, floating, closed, idle)
    bent = any(s.nodes.geometry.bent for s in equations.states)
    if felt > (ROUND_SHARE if bent else OPEN_SHARE):
        return ""
    told = floating.rigid.describe(motion, np.zeros_like(motion))
    if felt > OPEN_SHARE:
        return (
            f"contact as it has been found hardly resists a motion: {told}. Facets of second order "
            f"that stand for round surfaces feel {felt:.1g} of it. Displacements may have any "
            "amount of it, and differ by solver; forces hardly change with it. Add supports or "
            "springs if they matter"
        )
    return (
        "contact as it has been found leaves a motion open on which the loads do no work: "
        f"{told}. Forces hold for any amount of it; of displacements those are given that are next "
        "to where the bodies were. Add supports or springs if they matter"
    )


def _motion(
    equations: Equations, floating: Floating, closed: Array, others: Array
) -> tuple[Array, float, Array]:
    """(count,) of size 1 that rows in contact (n,), without friction that slips, feel the least,
    the largest of what they feel, and what other rows (n,) do."""
    follows = np.zeros(equations.m, dtype=bool)  # frames, and slips that friction leaves free
    follows[: equations.n_v] = True
    for s in equations.states:
        if isinstance(s.law, Coulomb) and s.nodes.kappa.size:
            follows[s.nodes.kappa[s.own.status != STICK]] = True
    count, columns = floating.count, np.flatnonzero(follows)
    felt_by, others_by = (
        hstack([floating.G[rows][:, :count], equations.L[rows][:, columns]], format="csc")
        for rows in map(np.flatnonzero, (closed, others))
    )
    shift = np.full(felt_by.shape[1], SINGULAR)
    shift[:count] *= np.asarray(felt_by[:, :count].power(2).sum(axis=0)).max(initial=1.0)
    solve = splu((felt_by.T @ felt_by + diagonal(shift)).tocsc()).solve
    x, loose = np.random.default_rng(2003).normal(size=count), floating.loose
    every, found = identity(count, format="csr"), np.zeros(len(shift))
    for _ in range(INVERSE):
        found[:count] = x - loose.nearest(every, x) if loose.count else x
        found[count:] = 0.0
        found = solve(found)
        found /= np.abs(found[:count]).max()
        x = found[:count]
    return x, float(np.abs(felt_by @ found).max(initial=0.0)), others_by @ found
