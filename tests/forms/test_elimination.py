"""Frame unknowns that rows bind, against dense algebra."""

import numpy as np
import pytest
from mpi4py import MPI
from scipy.sparse import block_diag, csr_matrix, diags, identity, random, vstack

from dolfinx_llm.forms.condensed import elimination

pytestmark = pytest.mark.quick


@pytest.mark.parametrize("soft", [False, True])
def test_unknowns_that_rows_bind(soft, monkeypatch):
    """Many rows that determine what they touch, dependent ones, and one that binds nothing; where
    rows are rigid, no dense algebra sees the many."""
    rng = np.random.default_rng(2001)
    n = (40 if soft else elimination.SMALL + 100), 40
    many = vstack([identity(n[0]), random(n[1], n[0], 0.05, random_state=rng)])
    few = csr_matrix([[1.0, -1.0, 0.0], [2.0, -2.0, 0.0], [0.0, 1e-13, 0.0]])
    D = block_diag([many, few, few.T, csr_matrix((1, 2))], format="csr")
    D = D[rng.permutation(D.shape[0])][:, rng.permutation(D.shape[1])]
    dense = D.toarray()
    k, m = dense.shape

    def small(A, *args, qr=elimination.qr, **kwargs):
        assert soft or min(A.shape) <= elimination.SMALL
        return qr(A, *args, **kwargs)

    monkeypatch.setattr(elimination, "qr", small)
    S = diags(rng.random(k)).tocsr() if soft else None
    found = elimination.FrameElimination(MPI.COMM_SELF, D, S)
    g, forces = dense @ rng.random(m), dense.T @ rng.random(k)
    q, r = rng.random(m), len(found.dependent)
    assert r == np.linalg.matrix_rank(dense, tol=1e-8)
    v = found.Z @ q + found.particular(g)
    give = S @ (found.Q @ q[found.dependent]) if soft else 0.0
    assert np.abs(dense.T @ (D @ v + give - g)).max() < 1e-12
    assert np.linalg.matrix_rank(found.Z.toarray(), tol=1e-12) == (m if soft else m - r)
    mu = found.multipliers(forces[found.dependent])
    assert np.abs(mu - np.linalg.pinv(dense.T, rcond=1e-8) @ forces).max() < 1e-12


def test_nodes_whose_rows_are_orthonormal(monkeypatch):
    """Nothing is decomposed of them, whole bases or normals alone; the others, of which supports or
    other rows leave a part, get what the pseudo-inverse says."""
    rng, pinv, asked = np.random.default_rng(2001), np.linalg.pinv, []

    def counted(S, **kwargs):
        asked.append(len(S))
        return pinv(S, **kwargs)

    base = np.linalg.qr(rng.normal(size=(5, 3, 3)))[0]
    dofs = np.arange(15).reshape(5, 3)
    # Two whole bases; a normal; a base next to a support; two rows that are nearly one.
    count = [3, 3, 1, 3, 2]
    vectors = np.concatenate([b[:c] for b, c in zip(base, count, strict=True)])
    vectors[-1] = 0.6 * vectors[-1] + 0.8 * vectors[-2]
    fixed = np.zeros(15, dtype=bool)
    fixed[dofs[3, 1]] = True
    monkeypatch.setattr(np.linalg, "pinv", counted)
    found = elimination.eliminate_at_nodes(dofs.repeat(count, axis=0), vectors, fixed)
    assert asked == [2]
    assert found.W.shape[0] == 1
    starts = np.cumsum([0, *count])
    for own, first, last in zip(dofs, starts[:-1], starts[1:], strict=True):
        S = vectors[first:last] * ~fixed[own]
        A = found.A.toarray()[own, first:last]
        assert np.abs(A - pinv(S, rcond=1e-6)).max() < 1e-14
        N = found.N.toarray()[np.ix_(own, own)]
        projector = np.diag(~fixed[own]) - A @ S
        on = ~fixed[own]
        assert np.abs((N @ N.T)[np.ix_(on, on)] - projector[np.ix_(on, on)]).max() < 1e-14
