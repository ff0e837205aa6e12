"""Frame nodes that follow others (``speakers``), where bodies turn on each other.

One that moves just as its speaker does misses what a turn makes of the distance between the two: in
gross slip far more than bodies give way by. Pairs about it came and went, and what it held back of
them was missing in the friction, 1 to 7 % of the torque of a pad.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix, diags

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal

SPREAD = 0.06  # of a node's squared distance to its speaker, that of nodes which tell turns
IN_LINE = 0.03  # of squared distances along a line, across it: such nodes tell no turn from a shear


def by_turns(parts: csr_matrix, shared: csr_matrix, firm: Array, x: Array) -> csr_matrix:
    """(2 k, 2 k) by how much nodes that follow others move more than these: by the turn of the
    speakers about theirs, in the least squares.

    Args:
        parts: (k, k) of ``speakers``.
        shared: (k, k) entries where nodes are neighbours.
        firm: (k,) how firmly pairs hold each.
        x: (k, 2) where they are, along the surface [length].

    >>> parts = csr_matrix(np.diag([1.0, 1.0, 1.0, 0.0])) + csr_matrix(([1.0], ([3], [1])), (4, 4))
    >>> x = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [3.0, 0.0]])
    >>> turned = 0.1 * np.column_stack([-x[:, 1], x[:, 0]])
    >>> more = by_turns(parts, csr_matrix(np.ones((4, 4))), np.ones(4), x)
    >>> (more @ turned.ravel()).reshape(4, 2)[[0, 3]].round(12).tolist()
    [[0.0, 0.0], [0.0, 0.2]]
    """
    k = len(firm)
    speaks = parts.diagonal() > 0.0
    near = (parts @ shared) @ diags(np.where(speaks, firm, 0.0))
    near = (diagonal(~speaks) @ near).tocsr()
    near.eliminate_zeros()
    row, col = np.repeat(np.arange(k), np.diff(near.indptr)), near.indices
    mass = np.maximum(np.bincount(row, near.data, k), 1e-300)
    middle = np.column_stack([np.bincount(row, near.data * a[col], k) / mass for a in x.T])
    arm, out = x[col] - middle[row], x - parts @ x
    tensor = np.stack(
        [np.bincount(row, near.data * a * b, k) for a in arm.T for b in arm.T], axis=1
    )
    flat, broad = np.linalg.eigvalsh(tensor.reshape(k, 2, 2)).T
    inertia, far = flat + broad, np.einsum("ki,ki->k", out, out)
    told = (flat > IN_LINE * broad) & (inertia > SPREAD * mass * far)
    turn = np.where(told[row], near.data / np.where(told, inertia, 1.0)[row], 0.0)
    turn = turn[:, None] * np.column_stack([-arm[:, 1], arm[:, 0]])
    across = np.column_stack([-out[:, 1], out[:, 0]])[row]
    blocks = np.einsum("ni,nj->nij", across, turn)
    return bsr_matrix((blocks, col, near.indptr), (2 * k, 2 * k)).tocsr()
