"""Column spaces and independent rows of sparse matrices, against dense algebra."""

import numpy as np
import pytest
import scenes
from scipy.sparse import csr_matrix, vstack

import dolfinx_llm as llm
from dolfinx_llm.operators.prescribed import ColumnSpace, independent_rows, pieces, repeated


def interpolation(n, m):
    """Shape functions of m x m quads at the nodes of n x n others."""
    x, cells = scenes.grid(m, m, seed=11)
    frame = llm.Frame(np.column_stack([x, 0.0 * x[:, 0]]), cells)
    at, _ = scenes.grid(n, n, seed=12)
    return frame.interpolation(frame.locate(np.column_stack([at, 0.0 * at[:, 0]])))


def graded(rng):
    """Singular values from 1 to 1e-6."""
    Q = np.linalg.qr(rng.normal(size=(60, 12)))[0]
    return csr_matrix(
        Q @ np.diag(np.logspace(0, -6, 12)) @ np.linalg.qr(rng.normal(size=(12, 12)))[0]
    )


MATRICES = {
    "finer rows": lambda rng: interpolation(17, 15),
    "coarser rows": lambda rng: interpolation(9, 15),
    "rows twice": lambda rng: vstack([interpolation(15, 15)] * 2).tocsr(),
    "large": lambda rng: 1e9 * interpolation(5, 4),
    "rank 1": lambda rng: csr_matrix(np.outer(rng.normal(size=40), rng.normal(size=10))),
    "graded": graded,
    "zero": lambda rng: csr_matrix((5, 4)),
}


@pytest.mark.parametrize("name", MATRICES)
def test_column_space(name):
    rng = np.random.default_rng(2001)
    D = MATRICES[name](rng)
    U, size, _ = np.linalg.svd(D.toarray(), full_matrices=False)
    U = U[:, size > 1e-8 * max(size[0], 1e-300)]
    x = rng.normal(size=(len(U), 2))
    found = ColumnSpace(D).without(x)
    assert np.abs(found - (x - U @ (U.T @ x))).max() <= (1e-9 if name == "graded" else 1e-12)
    rows = independent_rows(D)
    assert len(np.unique(rows)) == U.shape[1]
    if len(rows):
        kept = np.linalg.svd(D[rows].toarray(), compute_uv=False)
        assert kept[-1] >= 1e-2 * size[U.shape[1] - 1]


def test_nearly_dependent_rows_are_exchanged():
    """Of rows one pair is next to parallel."""
    D = interpolation(17, 15).tolil()
    D[:, 0], D[:, 1] = 0.0, 0.0
    D[:3, :2] = np.array([[1.0, 0.9], [0.9, 0.81 + 1e-7], [0.5, 0.1]])
    D = D.tocsr()
    size = np.linalg.svd(D.toarray(), compute_uv=False)
    kept = np.linalg.svd(D[independent_rows(D)].toarray(), compute_uv=False)
    assert len(kept) == D.shape[1] and kept[-1] >= 1e-2 * size[-1]


def test_what_hardly_says_more_is_repeated():
    """A row that reaches past a node at a support by little, and of two that are alike the one
    whose gap would be closed."""
    D = csr_matrix([[1.0, 0.0], [1.0, 0.04], [1.0, 0.0], [0.5, 0.5]])
    alone = np.zeros(4, dtype=bool)
    assert repeated(D, np.array([1e-3, 0.0, 0.0, 0.0]), alone).sum() == 2
    assert repeated(D[[0, 2]], np.array([1e-3, 0.0]), alone[:2]).tolist() == [True, False]
    assert repeated(D[[0, 2]], np.array([0.0, 1e-3]), alone[:2]).tolist() == [False, True]
    assert repeated(D[[0, 1]], np.zeros(2), alone[:2]).sum() == 1
    assert not repeated(csr_matrix([[1.0, 0.0], [1.0, 0.2]]), np.zeros(2), alone[:2]).any()


def test_at_joints_little_is_said_for_good():
    """A row that says a little more stays where a node of several interfaces has a part in it."""
    D = csr_matrix([[1.0, 0.0], [1.0, 0.04], [1.0, 0.0]])
    assert repeated(D, np.zeros(3), np.array([False, True, False])).sum() == 1
    two = csr_matrix([[1.0, 0.0, 0.0, 0.0], [1.0, 0.04, 0.0, 0.0],
                      [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 1.0, 0.04]])  # fmt: skip
    found = repeated(two, np.zeros(4), np.array([True, False, False, False]))
    assert not found[:2].any() and found[2:].sum() == 1


def test_rounding_binds_no_pieces():
    """Entries of rounding do not hold rows together that have nothing in common: what is chosen
    for each piece depended on units."""
    D = csr_matrix([[1.0, 0.0, 0.0], [1e-3, 1e-17, 0.0], [0.0, 1.0, 1e-6], [0.0, 0.0, 0.5]])
    found = sorted(sorted(own.tolist()) for own in pieces(D))
    assert found == [[0, 1], [2, 3]]
