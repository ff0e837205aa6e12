"""Whether contact can balance the loads on bodies that it alone holds, by a linear programme.

Bodies that supports leave free are in balance where forces that the laws allow, normal ones that
press and friction of at most μ N, add up to the loads along each of their rigid motions, and to
nothing at the frames. Without friction this is also enough for a solution (Fichera); with friction
it is necessary alone, as in limit analysis, whose mechanism the programme's multipliers are.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
from scipy.linalg import qr
from scipy.sparse import csr_matrix, hstack, identity, vstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import chosen
from dolfinx_llm.base.sparse import diagonal
from dolfinx_llm.contact.equations.equations import Equations
from dolfinx_llm.contact.equations.state import InterfaceState
from dolfinx_llm.forms.floating import out_of_balance
from dolfinx_llm.forms.verdict import FinalError
from dolfinx_llm.laws.coulomb import Coulomb
from dolfinx_llm.operators.floating import Floating
from dolfinx_llm.operators.motions import RigidMotions

LEFT = 1e-6  # of the forces, that the programme may leave: it solves to seven digits
PROGRAMMED = 10_000  # multipliers up to which it takes less than a solve
BOUNDED = 4_000  # bounds of friction up to which it may
PIVOTS = 1_000  # after so many it takes longer than what it would save, and is given up
DIRECTIONS = 16  # of friction in the plane: its bound is the polygon about the circle


def unbalanced(
    equations: Equations, floating: Floating, f: Array, loads: Array
) -> Callable[[], FinalError | None]:
    """What tells, as contact is now, the error of loads that no contact forces balance, with the
    motion that they drive; None where some do, or where the programme would be too large. It is
    collective, and solves the programme, which most load steps do without, when it is asked first.

    Args:
        equations: of the laws.
        floating: motions that supports leave free.
        f: this rank's loads [force].
        loads: (n_v,) on the frame unknowns [force].
    """
    may_open = equations.may_open()

    @cache
    def told() -> FinalError | None:
        jumps = [s.nodes.kappa for s in equations.states if isinstance(s.law, Coulomb)]
        bounds = sum(len(kappa) * (2 if kappa.shape[1] == 1 else DIRECTIONS) for kappa in jumps)
        if not floating.count or equations.n > PROGRAMMED or bounds > BOUNDED:
            return None
        along, sizes = floating.loads(f), floating.sizes(f)
        size = max(sizes.max(), np.abs(loads).max(initial=0.0))
        if not size > 0.0:
            return None
        left = partial(_left, equations, floating, along / size, loads / size, may_open)
        share, motion, pushed = chosen(floating.comm, left)
        if share <= LEFT:
            return None
        return FinalError(out_of_balance(floating, share, motion, along, pushed * size))

    return told


def _left(
    equations: Equations, floating: Floating, along: Array, loads: Array, may_open: Array
) -> tuple[float, Array, float]:
    """The least force that must be left along some motion, and the mechanism (count,): of all with
    a sum of motions of 1 the one on which loads do most work, and what of that those on the frame
    unknowns do, forces on obstacles."""
    n, n_v, k = equations.n, equations.n_v, floating.count
    low, high = np.where(may_open, 0.0, -np.inf), np.full(n, np.inf)
    drags, bears, limits = [csr_matrix((0, n))], [csr_matrix((0, n))], [np.zeros(0)]
    for s in equations.states:
        rows = s.nodes.rows
        if isinstance(s.law, Coulomb) and s.nodes.kappa.size:
            for known, of in zip((drags, bears, limits), _friction(s, n), strict=True):
                known.append(of)
        elif s.nodes.kappa.size and not isinstance(s.law, Coulomb):
            low[rows.ravel()] = -np.inf  # a law of one's own may hold all, or nothing
        left_out = rows.ravel()[~s.nodes.kept]
        low[left_out] = high[left_out] = 0.0
    basis = _plain(floating.rigid)
    own, one = basis @ floating.G[:, :k].T, identity(k)
    balance = vstack(
        [hstack([own, one, csr_matrix((k, 1))]), hstack([equations.L_t, csr_matrix((n_v, k + 1))])]
    )
    most = -np.ones((k, 1))  # no motion is left more than the last unknown
    least = [hstack([csr_matrix((k, n)), sign * one, most]) for sign in (1.0, -1.0)]
    free, drag, bear = np.full(k, np.inf), vstack(drags), vstack(bears)
    limit, none = np.concatenate(limits), csr_matrix((drag.shape[0], k + 1))

    from scipy.optimize import linprog  # rarely needed, and a third of the time of all imports

    def solved(rows: csr_matrix, limit: Array) -> Any:
        return linprog(
            np.append(np.zeros(n + k), 1.0),
            A_ub=vstack([hstack([rows, none]), *least]).tocsr(),
            b_ub=np.concatenate([limit, np.zeros(2 * k)]),
            A_eq=balance.tocsr(),
            b_eq=np.concatenate([basis @ along, loads]),
            bounds=np.column_stack([np.r_[low, -free, 0.0], np.r_[high, free, np.inf]]),
            method="highs",
            options={"maxiter": PIVOTS},
        )

    found = solved(drag - bear, limit)
    if found.status or found.fun <= LEFT:  # where it fails the iteration will tell
        return 0.0, np.zeros(k), 0.0
    # What slips does not part: friction as the normal forces found bear it, and no more with more.
    # Where it would do for normal forces that are others, a mechanism is that of the first.
    slips = solved(drag, limit + np.maximum(bear @ found.x[:n], 0.0)) if len(limit) else found
    motion = found if slips.status or slips.fun <= LEFT else slips
    moved, pushed = np.split(motion.eqlin.marginals, [k])
    return float(found.fun), basis.T @ moved, float(pushed @ loads)


def _plain(rigid: RigidMotions) -> csr_matrix:
    """(free, free) basis in which the free motions of each body are its translations and rotation,
    as far as supports leave these."""
    blocks, at = [], []
    for b in np.unique(rigid.body[: rigid.free]):
        own = np.flatnonzero(rigid.body[: rigid.free] == b)
        _, pivots = qr(rigid.parts[own], mode="r", pivoting=True)
        blocks.append(np.linalg.inv(rigid.parts[np.ix_(own, pivots[: len(own)])]).ravel())
        at.append([i.ravel() for i in np.meshgrid(own, own, indexing="ij")])
    return csr_matrix((np.concatenate(blocks), np.hstack(at)), (rigid.free, rigid.free))


def _friction(s: InterfaceState, n: int) -> tuple[csr_matrix, csr_matrix, Array]:
    """Friction at the nodes of an interface along some directions, |T| <= μ N + cohesion area: rows
    (j, n) of T and μ N, and what cohesion bears (j,)."""
    assert isinstance(s.law, Coulomb)
    nodes, at = s.nodes, s.at_rest()
    T = nodes.operator(nodes.tangential, n)
    mu, q = diagonal(s.law.coefficient(at)), nodes.kappa.shape[1]
    bears = mu @ nodes.operator(nodes.L_normal, n)
    angles = np.pi * np.arange(2) if q == 1 else 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    along = zip(*[np.cos(angles), np.sin(angles)][:q], strict=True)
    rows = [sum(a * T[i::q] for i, a in enumerate(by)) for by in along]
    count, cohesive = len(angles), at.given["cohesive"]
    return vstack(rows).tocsr(), vstack([bears] * count).tocsr(), np.tile(cohesive, count)
