"""Frame nodes that hardly any pair holds, and the nodes that speak for them.

At the rim of contact a frame node may be reached by the far ends of a few shape functions only.
Its slip κ is then the small misfit of the pairs divided by these small numbers, and the law of
friction, which asks for the sense of κ alone, could be met with the sense reversed. Such a node
takes the slip of a neighbour, which carries the forces of both: the remedy for cells that are cut
by a boundary, aggregation (Badia, Verdugo, Martín, CMAME 336 (2018) 533-553). Plain SciPy.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.csgraph import connected_components

CROSSES = 1e-6  # the same, below which no force passes from side to side
HELD = 0.3  # least sum of N² over the pairs of each side that tells the slip of a frame node


def speakers(sides: list[csr_matrix], touching: list[csr_matrix] | None = None) -> np.ndarray:
    """(k,) the node that speaks for each frame node: itself, where pairs of both sides hold it.

    Nodes that no pair reaches, and the best one of every piece of contact, speak for themselves.

    Args:
        sides: per side (n, k) shape functions of the pairs that follow the frame.
        touching: the same of all pairs in contact, by which nodes are neighbours; by default those
            that follow the frame.

    >>> far = csr_matrix([[1.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.0, 0.9, 0.1]])
    >>> speakers([far, far]).tolist()
    [0, 1, 1]
    """
    k = sides[0].shape[1]
    shared, support = csr_matrix((k, k)), np.full(k, np.inf)
    for N in sides:
        support = np.minimum(support, np.asarray(N.power(2).sum(axis=0)).ravel())
    for N in touching or sides:
        shared = shared + abs(N).T @ abs(N)
    _, piece = connected_components(shared, directed=False)
    best = np.zeros(piece.max(initial=0) + 1)
    np.maximum.at(best, piece, support)
    known = support >= np.minimum(HELD, best[piece])
    speaker = np.where(known, np.arange(k), -1)
    while not known.all():  # outwards, a ring of nodes at a time
        ask = np.flatnonzero(~known)
        near = (shared[ask] @ diags(known.astype(float))).tocsr()
        near.eliminate_zeros()
        speaker[ask] = speaker[np.asarray(near.argmax(axis=1)).ravel()]
        reached = np.diff(near.indptr) > 0
        if not reached.any():
            break
        known[ask[reached]] = True
    return np.where(known, speaker, np.arange(k))


def unheld(sides: list[csr_matrix], speaker: np.ndarray) -> np.ndarray:
    """(k,) nodes for which one speaks that pairs of one side alone hold, or of none.

    No force passes there, so that equilibrium leaves the law nothing to say, and the slip would be
    free: these nodes stick.

    Args:
        sides: as in ``speakers``.
        speaker: (k,) what it returned.

    >>> unheld([csr_matrix([[1.0, 0.0]]), csr_matrix([[0.99, 0.01]])], np.arange(2)).tolist()
    [False, True]
    """
    support = np.min([np.asarray(N.power(2).sum(axis=0)).ravel() for N in sides], axis=0)
    return support[speaker] < CROSSES


def sums(speaker: np.ndarray) -> csr_matrix:
    """(k, k) sums over the nodes for which a node speaks.

    Args:
        speaker: (k,) of ``speakers``.
    """
    k = len(speaker)
    return csr_matrix((np.ones(k), (speaker, np.arange(k))), (k, k))


def follow(speaker: np.ndarray, tangents: np.ndarray) -> csr_matrix:
    """(k t, k t) slip of all nodes from that of those that speak for them.

    Its transpose sums the forces up. Both are components along the nodes' own tangents.

    Args:
        speaker: (k,) of ``speakers``.
        tangents: (k, t, gdim) unit tangents at the nodes.
    """
    k, t, _ = tangents.shape
    # The rotation next to this: what is passed on keeps its length on curved surfaces.
    left, _, right = np.linalg.svd(np.einsum("kai,kbi->kab", tangents, tangents[speaker]))
    turn = left @ right
    turn[speaker == np.arange(k)] = np.eye(t)
    index = np.arange(t)
    row = np.broadcast_to(np.arange(k)[:, None, None] * t + index[:, None], turn.shape)
    col = np.broadcast_to(speaker[:, None, None] * t + index, turn.shape)
    return coo_matrix((turn.ravel(), (row.ravel(), col.ravel())), (k * t, k * t)).tocsr()
