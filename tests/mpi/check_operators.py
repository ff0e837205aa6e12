"""K, B and L_b against dense matrices made in NumPy from the contact pairs."""

import json

import numpy as np
import scenes
from mpi4py import MPI
from solve_scenes import CLAMPED, loaded_blocks


def dense(comm, A) -> np.ndarray:
    """All of a PETSc matrix, on every rank."""
    start, _ = A.getOwnershipRange()
    indptr, cols, values = A.getValuesCSR()
    rows = start + np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
    M = np.zeros(A.getSize())
    for r, c, v in comm.allgather((rows, cols, values)):
        np.add.at(M, (r, c), v)
    return M


def nodes_by_body(V):
    """Position and body (0 lower, 1 upper) of every node by its global number."""
    comm, index_map = V.mesh.comm, V.dofmap.index_map
    n = index_map.size_local
    x = V.tabulate_dof_coordinates()
    body = np.zeros(len(x), dtype=int)
    from dolfinx_llm import compat

    dofs = compat.cell_dofs(V)
    for column in dofs.T:
        body[column] = x[dofs][:, :, 2].mean(axis=1) > 1.0
    return np.concatenate(comm.allgather(x[:n])), np.concatenate(comm.allgather(body[:n]))


def errors(comm, conditions) -> dict:
    contact = loaded_blocks(comm, conditions)
    V = contact.spaces[0]
    K, B, L = (dense(comm, M) for M in (contact.K, contact.B, contact.L_b))
    x, body = nodes_by_body(V)
    pairs, frame = contact.geometries[0].pairs, contact.geometries[0].frame
    fixed = np.zeros(len(x) * 3, dtype=bool)
    for k, where in conditions:
        fixed[3 * np.flatnonzero(where(x.T)) + k] = True
    # Which column is which pair is the code's choice: each is found by its rows below.
    item = contact.operators.rows.numbering.number
    column = contact.operators.frames.number
    expected_B, expected_L = np.zeros_like(B), np.zeros_like(L)
    p = 0
    for side in (0, 1):
        N = pairs[side].N.toarray()
        for q, position in enumerate(pairs[side].x):
            node = np.flatnonzero((np.abs(x - position).max(axis=1) < 1e-12) & (body == side))
            assert len(node) == 1
            for i in range(3):
                a = pairs[side].base[q, i]
                expected_B[3 * node[0] + np.arange(3), item[3 * p + i]] = a
                for J in range(len(frame.x)):
                    expected_L[item[3 * p + i], column[3 * J + np.arange(3)]] = N[q, J] * a
            p += 1
    expected_B[fixed] = 0.0
    free = np.abs(expected_B).max(axis=0) > 0.0
    redundant = np.zeros(len(free), dtype=bool)
    redundant[item] = contact.operators.redundant
    unit = np.zeros_like(B.T @ B)
    unit[free, free] = 1.0
    Y = np.zeros(L.shape[1])
    Y[column] = frame.x.ravel()
    X = np.zeros(len(fixed))
    X[:] = x.ravel()
    K_fixed = np.zeros_like(K[fixed])
    K_fixed[np.arange(fixed.sum()), np.flatnonzero(fixed)] = 1.0
    lower = np.abs(x[:, 2] - 1.0) < 1e-12
    return {
        "B": np.abs(B - expected_B).max(),
        "B^T B": np.abs(B.T @ B - unit).max(),
        "L_b": np.abs(L - expected_L).max(),
        "L_b Y - B^T X": np.abs((L @ Y - B.T @ X)[free]).max(),
        "K": np.abs(K - K.T).max() / np.abs(K).max(),
        "K fixed": np.abs(K[fixed] - K_fixed).max(),
        "multipliers": abs(B.shape[1] - 3 * int(lower.sum())),
        "rank": int(np.linalg.matrix_rank(np.hstack([B[:, free].T, -L[free]]))) - int(free.sum()),
        "redundant": int(redundant.sum()),
        "rank of L_b lost": int(np.linalg.matrix_rank(L) - np.linalg.matrix_rank(L[~redundant])),
        "rank of L_b free": int(L.shape[1] - np.linalg.matrix_rank(L)),
        "left dependent": int(
            (~free & ~redundant).sum() - np.linalg.matrix_rank(L[~free & ~redundant])
        )
        if (~free).any()
        else 0,
    }


if __name__ == "__main__":
    comm = MPI.COMM_WORLD
    out = {"clamped": errors(comm, CLAMPED), "symmetric": errors(comm, scenes.SYMMETRY)}
    if comm.rank == 0:
        print(json.dumps({k: {n: float(e) for n, e in v.items()} for k, v in out.items()}))
