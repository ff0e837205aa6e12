"""Rigid motions of the bodies that neither supports nor interfaces hold."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.operators.motions import RigidMotions

FIT_DIRECTLY = 5000  # frame unknowns up to which a factorisation is the quickest least-squares fit
UNHELD = 1e-11  # singular values below, of the largest, are motions that nothing holds


def check_support(
    rigid: RigidMotions, interfaces: Sequence[tuple[csr_matrix | None, np.ndarray]]
) -> None:
    """Require that supports and tied interfaces hold every body.

    A combination of rigid motions is not held if it has no stiffness (K R c = 0), does not move
    prescribed dofs, and the frames can follow it (Bᵀ R c in the range of L_b). Of each interface
    L_b is given, None without a frame, and Bᵀ R (rows, modes).
    """
    bodies = rigid.bodies
    if not rigid.free:
        return
    moves = np.zeros((bodies.count, rigid.parts.shape[1], rigid.free))
    moves[rigid.body[: rigid.free], :, np.arange(rigid.free)] = rigid.parts[: rigid.free]
    moves = moves.reshape(-1, rigid.free)
    rows = [np.zeros((1, rigid.free))]
    for L, BtR in interfaces:
        BtR = BtR.reshape(len(BtR), len(moves)) @ moves
        rows.append(BtR if L is None else BtR - L @ _least_squares(L, BtR))
    _, values, vectors = np.linalg.svd(np.concatenate(rows), full_matrices=True)
    held = np.count_nonzero(values >= UNHELD * max(values[0], 1.0))
    left = moves @ vectors[held:].T
    if not left.shape[1]:
        return
    counts = np.linalg.matrix_rank(left.reshape(bodies.count, -1, left.shape[1]), 1e-6)
    names = [f"{bodies.name(b)} in {count}" for b, count in enumerate(counts) if count]
    raise ContactError(
        f"{left.shape[1]} rigid motion(s) are held by no support and no interface; they move "
        f"{', '.join(names)} independent way(s). Add Dirichlet conditions or springs that hold them"
    )


def _least_squares(L: csr_matrix, b: np.ndarray) -> np.ndarray:
    """Solution of min |L v - b| for every column of b (n, k), by a factorisation of LᵀL. It is like
    a mass matrix, so that large frames are iterated on by conjugate gradients; with small singular
    values, on which these are slow, they are factorised, too."""
    if L.shape[1] <= FIT_DIRECTLY:
        return _factorised(L).solve(L.T @ b)
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
    return _factorised(L).solve(L.T @ b)


def _factorised(L: csr_matrix) -> Any:
    symmetric = {"permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}
    return splu((L.T @ L).tocsc(), **symmetric)
