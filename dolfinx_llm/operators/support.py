"""Rigid motions of the bodies that neither supports nor interfaces hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from petsc4py import PETSc
from scipy.sparse import coo_matrix, csr_matrix, identity, vstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.parallel import chosen
from dolfinx_llm.base.sparse import NO_ROWS, symmetric_factors
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.floating import Loose
from dolfinx_llm.operators.motions import (
    RigidMotions,
    left_by_supports,
    no_motions,
    rigid_motions,
)
from dolfinx_llm.operators.prescribed import independent_rows

# Per interface L_b, None without a frame, and Bᵀ R (rows, rigid motions of all bodies)
Constraints = Sequence[tuple[csr_matrix | None, csr_matrix]]

FIT_DIRECTLY = 5000  # frame unknowns up to which a factorisation is the quickest least-squares fit
NAMED = 8  # bodies that a message names, of many
UNHELD = 1e-11  # singular values below, of the largest, are motions that nothing holds


def check_support(rigid: RigidMotions, interfaces: Constraints) -> None:
    """Require that supports and interfaces hold all bodies.

    Args:
        rigid: of the bodies.
        interfaces: as of ``unheld``.

    Raises:
        ContactError: they do not.
    """
    loose = unheld(rigid.bodies, (rigid.body[: rigid.free], rigid.parts[: rigid.free]), interfaces)
    if not loose.count:
        return
    if rigid.bodies.components == 1:
        raise ContactError(
            f"no value is prescribed for {', '.join(n for n, _ in _moved(rigid, loose))}, nor for "
            "what it is joined to: the field is known but for a constant. Add a Dirichlet "
            "condition, or a term h (u - u_0) ds of exchange with the surroundings"
        )
    raise ContactError(
        f"{loose.count} rigid motion(s) are held by no support and no interface; they move "
        f"{movers(rigid, loose)}. Add Dirichlet conditions or springs that hold them"
    )


def floating_motions(
    bodies: Bodies, K: PETSc.Mat, fixed: Array, constraints: Callable[[], Constraints], tied: bool
) -> tuple[RigidMotions, Loose, bool]:
    """The motions that contact has to hold; those combinations of the free ones that no contact
    holds, on which loads must not do work; and whether supports and ties hold all bodies: only
    where they do not the stiffness K is looked at for springs.

    Args:
        bodies: that move.
        K: their stiffness.
        fixed: (n_local,) prescribed dofs.
        constraints: gives the interfaces, as of ``unheld``; supports that hold all ask for none.
        tied: whether ties are all there is: they hold all bodies, or it is an error.

    Raises:
        ContactError: there are ties alone, or it is a scalar field, and something is not held.
    """
    left = left_by_supports(bodies, fixed)
    interfaces = constraints() if len(left[0]) else []
    if tied and not unheld(bodies, left, interfaces).count:
        return no_motions(bodies, len(fixed)), Loose(NO_ROWS), True
    rigid = rigid_motions(bodies, K, fixed)
    if not (tied or bodies.components == 1):
        free = rigid.body[: rigid.free], rigid.parts[: rigid.free]
        return rigid, unheld(bodies, free, interfaces), False
    check_support(rigid, interfaces)
    rigid = no_motions(bodies, len(fixed)) if tied else rigid
    return rigid, Loose(identity(rigid.free, format="csr")), False


def movers(rigid: RigidMotions, loose: Loose) -> str:
    """Words for the bodies that some of the free motions move, the first ones by name."""
    named = [f"{name} in {ways}" for name, ways in _moved(rigid, loose)]
    more = f" and {len(named) - NAMED} more" if len(named) > NAMED else ""
    return f"{', '.join(named[:NAMED])} independent way(s){more}"


def _moved(rigid: RigidMotions, loose: Loose) -> list[tuple[str, int]]:
    """Names of these bodies, and in how many ways each is moved."""
    some = loose.some(rigid.parts.shape[1] + 2)  # as many as tell them apart
    left = np.zeros((rigid.bodies.count, rigid.parts.shape[1], some.shape[1]))
    np.add.at(left, rigid.body[: rigid.free], rigid.parts[: rigid.free, :, None] * some[:, None])
    counts = np.linalg.matrix_rank(left, 1e-6)
    return [(rigid.bodies.name(b), int(ways)) for b, ways in enumerate(counts) if ways]


def unheld(
    bodies: Bodies,
    motions: tuple[Array, Array],
    interfaces: Constraints,
) -> Loose:
    """Combinations of motions that no interface holds both ways.

    A combination of rigid motions is not held if it has no stiffness (K R c = 0), does not move
    prescribed dofs, and the frames can follow it (Bᵀ R c in the range of L_b).

    Args:
        bodies: that move.
        motions: that nothing else is to hold, body (k,) and parts (k, 3 or 6) of each, as of
            ``RigidMotions``.
        interfaces: what they hold.
    """
    body, parts = motions
    free, ways = parts.shape
    if not free:
        return Loose(NO_ROWS)
    row = body[:, None] * ways + np.arange(ways)
    at = row.ravel(), np.repeat(np.arange(free), ways)
    moves = csr_matrix((parts.ravel(), at), (bodies.count * ways, free))

    def held() -> csr_matrix:
        rows = [csr_matrix((0, free))]
        for L, BtR in interfaces:
            own = (BtR @ moves).tocsc()
            used = np.flatnonzero(np.diff(own.indptr))  # of two bodies, as a rule
            felt = own[:, used].toarray()
            if L is not None and len(used):
                felt = felt - L @ least_squares(L, felt)
            felt = coo_matrix(np.linalg.qr(felt, mode="r"))
            shape = felt.shape[0], free
            rows.append(csr_matrix((felt.data, (felt.row, used[felt.col])), shape))
        found = vstack(rows, format="csr")
        found.data[np.abs(found.data) < UNHELD * np.abs(found.data).max(initial=1.0)] = 0.0
        found.eliminate_zeros()
        return found[independent_rows(found, UNHELD)]

    return Loose(chosen(bodies.comm, held))


def least_squares(L: csr_matrix, b: Array) -> Array:
    """Solution of min |L v - b| for every column of b (n, k), by a factorisation of LᵀL. It is like
    a mass matrix, so that large frames are iterated on by conjugate gradients; with small singular
    values, on which these are slow, they are factorised, too."""
    if L.shape[1] <= FIT_DIRECTLY:
        return symmetric_factors(L.T @ L, pivots=True).solve(L.T @ b)
    v = np.zeros((L.shape[1], b.shape[1]))
    r = L.T @ b
    p, size = r.copy(), np.einsum("nk,nk->k", r, r)
    goal = 1e-28 * size
    for _ in range(300):
        if (size <= goal).all():
            return v
        Lp = L @ p
        # A column that is done, or zero, stays as it is.
        length = np.where(size > goal, size, 0.0) / np.maximum(
            np.einsum("nk,nk->k", Lp, Lp), 1e-300
        )
        v += length * p
        r -= length * (L.T @ Lp)
        before, size = size, np.where(size > goal, np.einsum("nk,nk->k", r, r), size)
        p = r + size / np.maximum(before, 1e-300) * p
    return symmetric_factors(L.T @ L, pivots=True).solve(L.T @ b)
