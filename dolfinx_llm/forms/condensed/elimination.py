"""Elimination of constrained surface displacements: u = T q + u_0; NumPy and SciPy only.

A row of L_b with base vector a at node p says a · u_p = L_b v - g. It is solved for the node's free
dofs. What is left where there are none (symmetry planes, nodes in several interfaces) binds the
frame alone, D v = g_D, and is solved for some of the frame's unknowns.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import qr, solve_triangular
from scipy.sparse import coo_matrix, csr_matrix, diags

from dolfinx_llm.operators.numbering import Numbering
from dolfinx_llm.operators.prescribed import RANK


@dataclass(frozen=True, eq=False)
class EliminatedRows:
    """The rows of L_b of all frames that tie surface nodes to them, on every rank."""

    dofs: np.ndarray  # (rows, gdim) numbers, in the vector of all bodies, of the node's dofs
    base: np.ndarray  # (rows, gdim) base vectors, orthonormal at each node
    L: csr_matrix  # (rows, m) L_b
    multipliers: Numbering  # of the rows
    frames: Numbering  # of the columns
    items: np.ndarray  # (m,) node of each frame unknown, ascending: they share a block

    def __post_init__(self) -> None:
        rows, m = len(self.dofs), self.frames.sizes[1]
        if self.L.shape != (rows, m) or self.multipliers.sizes[1] != rows:
            raise ValueError(
                f"L has the shape {self.L.shape}: {rows} eliminated components, "
                f"{self.multipliers.sizes[1]} multipliers and {m} frame unknowns need ({rows}, {m})"
            )

    @property
    def local(self) -> tuple[np.ndarray, np.ndarray]:
        """(R, gdim) dofs and base vectors of this rank's rows, in the order of their numbers."""
        return self.dofs[self.multipliers.mine], self.base[self.multipliers.mine]


def widest(L: csr_matrix, gdim: int) -> float:
    """Nodes that the row of a frame node couples with in the condensed matrix, about: those of two
    layers of cells next to the c surface nodes that follow it, 2 (sqrt(c) + 2)^2."""
    c = np.bincount(L.indices, minlength=1).max()
    return 2.0 * (c ** (1.0 / (gdim - 1)) + 2.0) ** (gdim - 1)


@dataclass(frozen=True, eq=False)
class NodeElimination:
    """u = A (L_b v - g) + N w at one rank's dofs, and the rows that bind the frame alone."""

    A: csr_matrix  # (n_local, R)
    N: csr_matrix  # (n_local, n_local) the identity away from the contact
    W: csr_matrix  # (k, R) orthonormal combinations of rows that move no free dof


def eliminate_at_nodes(dofs: np.ndarray, vectors: np.ndarray, fixed: np.ndarray) -> NodeElimination:
    """Solve each node's rows S u_p = L_b v - g for its free dofs, with the pseudo-inverse of S;
    rows have (R, gdim) local dofs and base vectors. The directions that they leave free get
    unknowns w in the places of the node's free dofs."""
    R, gdim = dofs.shape
    n = len(fixed)
    _, group = np.unique(dofs[:, 0], return_inverse=True)
    order = np.argsort(group, kind="stable")
    place = np.empty(R, dtype=np.int64)  # of a row among its node's: interfaces may share nodes
    place[order] = np.arange(R) - np.searchsorted(group[order], group[order])
    shape = group.max(initial=-1) + 1, place.max(initial=0) + 1
    nodes = np.zeros((shape[0], gdim), dtype=np.int64)
    nodes[group] = dofs
    there = np.zeros(shape)
    there[group, place] = 1.0
    free = ~fixed[nodes]
    S = np.zeros((*shape, gdim))
    S[group, place] = vectors * free[group]
    inverse = np.linalg.pinv(S, rcond=1e-10)
    value = inverse[group, :, place]
    A = _csr(value, dofs, np.broadcast_to(np.arange(R)[:, None], dofs.shape), (n, R))

    g, j, vector = _unit_eigenvectors(free[:, :, None] * np.eye(gdim) - inverse @ S)
    seat = np.argsort(~free, axis=1, kind="stable")[g, j]  # free dofs first
    N = _csr(vector, nodes[g], np.broadcast_to(nodes[g, seat][:, None], vector.shape), (n, n))
    kept = np.ones(n)
    kept[nodes[free]] = 0.0
    g, j, vector = _unit_eigenvectors(there[:, :, None] * np.eye(shape[1]) - S @ inverse)
    row = np.zeros(shape, dtype=np.int64)
    row[group, place] = np.arange(R)
    number = np.broadcast_to(np.arange(len(g))[:, None], vector.shape)
    return NodeElimination(A, (N + diags(kept)).tocsr(), _csr(vector, number, row[g], (len(g), R)))


def _unit_eigenvectors(P: np.ndarray) -> Any:
    """Orthonormal bases of the ranges of projectors P (n, k, k): matrix, place, vector of each."""
    values, vectors = np.linalg.eigh(P)
    g, column = np.nonzero(values > 0.5)  # ascending: the last ones
    first = P.shape[1] - np.bincount(g, minlength=len(P))
    vector = vectors[g, :, column]
    vector[np.abs(vector) < 1e-15] = 0.0
    return g, column - first[g], vector


def _csr(value: np.ndarray, rows: Any, cols: Any, shape: tuple[int, int]) -> csr_matrix:
    keep = value != 0.0
    return csr_matrix((value[keep], (rows[keep], cols[keep])), shape=shape)


class FrameElimination:
    """v = Z v + v_0 with D Z = 0, D v_0 = g_D: the frame's unknowns that D determines go. The rows
    of D (k, m) bind the frame alone.

    By QR with column pivoting, D P = Q [R_1 R_2]: v_dep = R_1⁻¹ (Qᵀ g_D - R_2 v_ind). The others
    stay the unknowns they were, so that rigid modes need no transformation.

    With S (k, k) over c, S = ``soft``, the rows give way, D v = g_D - S μ / c. Their forces μ =
    c Q ν are then unknowns ν in the places of v_dep, and Z has columns -R_1⁻¹ Qᵀ S Q there.
    """

    def __init__(self, D: csr_matrix, soft: csr_matrix | None = None) -> None:
        m = D.shape[1]
        touched = np.unique(D.indices[D.data != 0.0])
        kept = np.ones(m)
        self.dependent, self.size, Z = touched[:0], m, None
        self.Q = np.zeros((D.shape[0], 0))
        if len(touched):
            Q, R, order = qr(D[:, touched].toarray(), mode="economic", pivoting=True)
            diagonal = np.abs(np.diag(R))
            r = int((diagonal > RANK * diagonal[0]).sum())
            self.Q, self.R = Q[:, :r], R[:r, :r]
            self.dependent, others = touched[order[:r]], touched[order[r:]]
            X = -solve_triangular(self.R, R[:r, r:])
            X[np.abs(X) < 1e-15] = 0.0
            X = coo_matrix(X)
            Z = csr_matrix((X.data, (self.dependent[X.row], others[X.col])), shape=(m, m))
            if soft is not None:
                give = coo_matrix(-solve_triangular(self.R, self.Q.T @ (soft @ self.Q)))
                at = self.dependent[give.row], self.dependent[give.col]
                Z = Z + csr_matrix((give.data, at), shape=(m, m))
            kept[self.dependent] = 0.0
        self.Z = diags(kept).tocsr() if Z is None else (diags(kept) + Z).tocsr()

    def particular(self, g_D: np.ndarray) -> np.ndarray:
        """(m,) v_0 with D v_0 = g_D (k,)."""
        v = np.zeros(self.size)
        if len(self.dependent):
            v[self.dependent] = solve_triangular(self.R, self.Q.T @ g_D)
        return v

    def multipliers(self, b: np.ndarray) -> np.ndarray:
        """(k,) smallest μ with Dᵀ μ = b, from b (r,) at the dependent unknowns."""
        if not len(self.dependent):
            return np.zeros(len(self.Q))
        return self.Q @ solve_triangular(self.R, b, trans="T")
