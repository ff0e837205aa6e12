"""CondensedSystem with parts of the components eliminated, against a dense solution of (31)."""

import json

import numpy as np
import scenes
from check_operators import dense
from mpi4py import MPI
from scipy.sparse import csr_matrix, vstack
from solve_scenes import loaded_forms

import dolfinx_llm as llm
from dolfinx_llm.forms.condensed.elimination import EliminatedRows
from dolfinx_llm.forms.condensed.splitting import SplitStiffness
from dolfinx_llm.forms.condensed.system import CondensedSystem
from dolfinx_llm.operators.numbering import Numbering

DIRECT = {"ksp_type": "preonly", "pc_type": "cholesky"}


def rotations(rng, n):
    """(n, 3, 3) random orthonormal bases."""
    return np.linalg.qr(rng.standard_normal((n, 3, 3)))[0]


def normals_only(problem, rng):
    """Frictionless: bases whose last vector is the normal, one frame unknown per node."""
    pairs = problem.operators.pairs
    normal = np.concatenate([p.normal for p in pairs])
    base = rotations(rng, len(normal))
    base[:, 2] = normal
    base[:, 0] -= np.einsum("ni,ni->n", base[:, 0], normal)[:, None] * normal
    base[:, 0] /= np.linalg.norm(base[:, 0], axis=1)[:, None]
    base[:, 1] = np.cross(normal, base[:, 0])
    eliminated = np.zeros((len(base), 3), dtype=bool)
    eliminated[:, 2] = True
    signs = [1.0, -1.0]  # the frame's unknown is its motion out of side 0
    L = vstack([s * p.N for s, p in zip(signs, pairs, strict=True)], format="csr")
    return base, eliminated, L, 1


def some_components(problem, rng, turned=True):
    """A random set of components, of turned or of Cartesian bases; some nodes are open."""
    pairs, frame = problem.operators.pairs, problem.geometries[0].frame
    n, gdim = sum(len(p.nodes) for p in pairs), 3
    base = rotations(rng, n) if turned else np.concatenate([p.base for p in pairs])
    eliminated = rng.random((n, gdim)) < 0.6
    eliminated[rng.random(n) < 0.2] = False
    N = vstack([p.N for p in pairs]).toarray()
    full = np.einsum("nm,nci->ncmi", N, base).reshape(n * gdim, len(frame.x) * gdim)
    return base, eliminated, csr_matrix(full[eliminated.ravel()]), gdim


def system(problem, base, eliminated, L, bs, proximal, options):
    owner = np.concatenate([p.owner for p in problem.operators.pairs])
    rank = problem.comm.rank
    node, component = np.nonzero(eliminated)
    frame_owner = problem.operators.frames.owner[::3]
    rows = EliminatedRows(
        np.concatenate(problem.operators.side_dofs)[node],
        base[node, component],
        L,
        Numbering(owner[node], rank),
        Numbering(np.repeat(frame_owner, bs), rank),
        np.repeat(np.arange(len(frame_owner)), bs),
        3,
    )
    dofs, diagonal = np.concatenate(problem.operators.side_dofs), problem.operators.diagonal
    split = SplitStiffness(problem.K.copy(), dofs, diagonal)
    made = CondensedSystem(
        split, rows, problem.bulk.dofs.fixed, problem.scale, proximal=proximal, options=options
    )
    return rows, made


def everywhere(comm, local):
    return np.concatenate(comm.allgather(local))


def exact(problem, rows, f, g, proximal, pull):
    """u, λ, v of (31) in NumPy; where λ is not unique the smallest, as the package does."""
    comm = problem.comm
    K, fixed, f = (
        dense(comm, problem.K),
        everywhere(comm, problem.bulk.dofs.fixed),
        everywhere(comm, f),
    )
    B = np.zeros((len(K), len(rows.dofs)))
    for r, (dofs, vector) in enumerate(zip(rows.dofs, rows.base, strict=True)):
        B[dofs, r] = vector
    B[fixed] = 0.0
    L, s = rows.L.toarray(), problem.scale
    n_l, n_v = L.shape
    A = np.block(
        [
            [K, s * B, np.zeros((len(K), n_v))],
            [s * B.T, np.zeros((n_l, n_l)), -s * L],
            [np.zeros((n_v, len(K))), -s * L.T, np.diag(proximal)],
        ]
    )
    x = np.linalg.lstsq(A, np.concatenate([f, -s * g, pull]), rcond=1e-13)[0]
    assert np.abs(A @ x - np.concatenate([f, -s * g, pull])).max() < 1e-9 * s
    return x[: len(K)], s * x[len(K) : len(K) + n_l], x[len(K) + n_l :]


def differences(problem, kind, seed, options) -> dict:
    """Largest errors of u, λ, v over their largest values."""
    comm, rng = problem.comm, np.random.default_rng(seed)
    if kind == "normals":
        base, eliminated, L, bs = normals_only(problem, rng)
        proximal = np.zeros(L.shape[1])
    else:
        base, eliminated, L, bs = some_components(problem, rng, kind == "turned")
        proximal = problem.scale * 10.0 ** rng.uniform(-4.0, 0.0, L.shape[1])
    rows, made = system(problem, base, eliminated, L, bs, proximal, options)
    f, pull = problem.bulk.load(), problem.scale * rng.standard_normal(L.shape[1])
    # Gaps that the prescribed dofs can follow: the rows may say the same thing twice.
    node, component = np.nonzero(eliminated)
    held = np.zeros(problem.K.getSize()[0])
    held[:] = everywhere(comm, problem.bulk.dofs.fixed)
    shift = rng.standard_normal((len(base), 3))
    shift *= held[np.concatenate(problem.operators.side_dofs)] == 0.0
    g = L @ rng.standard_normal(L.shape[1])
    g -= np.einsum("ri,ri->r", base[node, component], shift[node])
    u, multiplier, v = made.solve(f, g[rows.multipliers.mine], pull)
    known = exact(problem, rows, f, g, proximal, pull)
    order = rows.multipliers.number
    found = (
        everywhere(comm, u),
        everywhere(comm, multiplier)[order],
        everywhere(comm, v)[rows.frames.number],
    )
    errors = {
        key: float(np.abs(a - b).max() / np.abs(b).max())
        for key, a, b in zip(("u", "λ", "v"), found, known, strict=True)
    }
    idle = int(comm.allreduce(made.form.tail.idle.sum()))
    made.destroy()
    return {**errors, "idle": idle}


if __name__ == "__main__":
    comm = MPI.COMM_WORLD
    V, tags = scenes.two_blocks(comm, 4, 3)
    a, L = loaded_forms(V)
    bcs = scenes.hold(V, scenes.SYMMETRY)
    problem = llm.ContactProblem(a, L, bcs=bcs, interfaces=[llm.Interface(tags, (2, 3))])
    out = {}
    for kind, seed in (("normals", 3), ("turned", 5), ("turned", 6), ("cartesian", 7)):
        out[f"{kind} {seed}"] = differences(problem, kind, seed, DIRECT)
        out[f"{kind} {seed}, CG"] = differences(problem, kind, seed, None)
    if comm.rank == 0:
        print(json.dumps(out))
