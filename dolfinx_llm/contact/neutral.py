"""Motions of bodies that contact as it has been found leaves open, and on which loads do no work.

A plate that balances on a point, or a body of which all slips: forces are unique there, the
displacement is not.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import bmat, identity
from scipy.sparse.linalg import splu

from dolfinx_llm.base.sparse import diagonal
from dolfinx_llm.contact.equations import Equations
from dolfinx_llm.laws.coulomb import Coulomb
from dolfinx_llm.laws.rows import SLIP
from dolfinx_llm.operators.floating import Floating

SINGULAR = 1e-14  # of the squares of rows, added so that they can be factorised
INVERSE = 4  # inverse ones, from a motion by chance
OPEN_SHARE = 1e-8  # of a motion, up to which rows in contact may feel it


def neutral(equations: Equations, floating: Floating) -> str:
    """Words for such a motion, the same on every rank; empty where there is none.

    Args:
        equations: of the laws, with the state of contact that has been found.
        floating: motions that supports leave free; what no contact holds in any state is left out.
    """
    motion = _motion(equations, floating) if floating.count else None
    if motion is None:
        return ""
    return (
        "contact as it has been found leaves a motion open on which the loads do no work: "
        f"{floating.rigid.describe(motion, np.zeros_like(motion))}. Forces hold for any amount of "
        "it; of displacements those are given that are next to where the bodies were. Add supports "
        "or springs if they matter"
    )


def _motion(equations: Equations, floating: Floating) -> np.ndarray | None:
    """(count,) of size 1, or None: rows in contact, without friction that slips, feel nothing."""
    follows = np.zeros(equations.m, dtype=bool)  # frames, and slips that friction leaves free
    follows[: equations.n_v] = True
    for s in equations.states:
        if isinstance(s.law, Coulomb) and s.nodes.kappa.size:
            follows[s.nodes.kappa[s.own.status == SLIP]] = True
    closed = equations.closed_rows().astype(float)
    G = diagonal(closed) @ floating.G[:, : floating.count]
    A = (diagonal(closed) @ equations.whole)[:, np.flatnonzero(follows)]
    shift = SINGULAR * np.asarray(G.power(2).sum(axis=0)).max(initial=1.0)
    square = bmat(
        [
            [G.T @ G + shift * identity(G.shape[1]), -(G.T @ A)],
            [-(A.T @ G), A.T @ A + SINGULAR * identity(A.shape[1])],
        ],
        format="csc",
    )
    solve, none = splu(square).solve, np.zeros(A.shape[1])
    x, loose = np.random.default_rng(2003).normal(size=G.shape[1]), floating.loose
    every = identity(G.shape[1], format="csr")
    for _ in range(INVERSE):
        if loose.count:
            x = x - loose.nearest(every, x)
        found = solve(np.concatenate([x, none]))
        found /= np.abs(found[: len(x)]).max()
        x = found[: len(x)]
    felt = np.abs(G @ x - A @ found[len(x) :]).max(initial=0.0)
    return x if felt <= OPEN_SHARE else None
