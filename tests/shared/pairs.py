"""Blocks of bricks or tetrahedra under uniaxial pressure: patch tests for any pair of surfaces."""

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat, post

E, NU, PRESSURE = 2600.0, 0.3, 260.0
TETS = [[0, 1, 3, 7], [0, 1, 5, 7], [0, 4, 5, 7], [0, 2, 3, 7], [0, 2, 6, 7], [0, 4, 6, 7]]
BELOW, ABOVE = 1, 2  # tags of a block's lower and upper face


def stress(u):
    mu, lam = E / (2 * (1 + NU)), E * NU / (1 + NU) / (1 - 2 * NU)
    strain = ufl.sym(ufl.grad(u))
    return 2 * mu * strain + lam * ufl.tr(strain) * ufl.Identity(3)


def block(
    comm, n, low, high, kind, *, jitter=0.0, rng=None, move=None, mask=None, x_low=None, x_high=None
):
    """Mesh of a block and the tags BELOW and ABOVE of its horizontal faces.

    Args:
        n: bricks in each direction.
        low, high: corners.
        kind: "hexahedron" or "tetrahedron".
        jitter: of the lateral positions of inner nodes, in cells; the same in all layers.
        move: map of positions (m, 3) within the plane.
        x_low, x_high: tags of the faces with the smallest and largest x.
        mask: keeps the columns of bricks whose centre (m, 2) on [0, 1]^2 it holds for.
    """
    axes = [np.linspace(0.0, 1.0, k + 1) for k in n]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    if jitter:
        shake = rng.uniform(-jitter, jitter, (*x.shape[:2], 1, 2)) / np.array(n[:2])
        shake[[0, -1], :] = shake[:, [0, -1]] = 0.0
        x[..., :2] += shake
    x = x.reshape(-1, 3)
    node = np.arange(len(x)).reshape([k + 1 for k in n])
    cells = np.stack(
        [
            node[i : n[0] + i, j : n[1] + j, k : n[2] + k].ravel()
            for k in (0, 1)
            for j in (0, 1)
            for i in (0, 1)
        ],
        axis=1,
    )
    if mask is not None:
        cells = cells[mask(x[cells].mean(axis=1)[:, :2])]
        used, cells = np.unique(cells, return_inverse=True)
        x, cells = x[used], cells.reshape(-1, 8)
    x = np.asarray(low) + x * (np.asarray(high) - low)
    x = x if move is None else move(x)
    if kind == "tetrahedron":
        cells = cells[:, TETS].reshape(-1, 4)
    if comm.rank:
        x, cells = x[:0], cells[:0]
    domain = compat.create_mesh(comm, cells, x, kind)
    faces = [(BELOW, 2, low), (ABOVE, 2, high), (x_low, 0, low), (x_high, 0, high)]
    faces = [face for face in faces if face[0] is not None]
    found = [
        mesh.locate_entities_boundary(domain, 2, lambda p, k=k, at=at: np.isclose(p[k], at[k]))
        for _, k, at in faces
    ]
    values = np.repeat([tag for tag, _, _ in faces], [len(f) for f in found]).astype(np.int32)
    facets = np.concatenate(found)
    order = np.argsort(facets)
    return domain, mesh.meshtags(domain, 2, facets[order], values[order])


def supports(V, low, high):
    """The lowest block slides on its base; two corners of it hold it in the plane."""

    def at(*corners):
        return lambda x: np.any(
            [np.isclose(x, np.reshape(c, (3, 1))).all(axis=0) for c in corners], axis=0
        )

    first, second = (low[0], low[1], low[2]), (high[0], low[1], low[2])
    bcs = []
    for k, where in (
        (2, lambda x: np.isclose(x[2], low[2])),
        (0, at(first)),
        (1, at(first, second)),
    ):
        Vk, _ = V.sub(k).collapse()
        dofs = fem.locate_dofs_geometrical((V.sub(k), Vk), where)
        bcs.append(fem.dirichletbc(fem.Function(Vk), dofs, V.sub(k)))
    return bcs


def stack(blocks, low, high, frame=None, ties=None, slope=(0.0, 0.0)):
    """Blocks [(mesh, tags), ...] tied to each other, under pressure on their free faces.

    Args:
        low, high: corners of the first block, which is supported.
        frame: for all interfaces, or None.
        ties: (block, tag, block, tag) of each interface; None: each block on the one before, with
            pressure on what they leave free of each other.
        slope: of the pressure along x and y, in PRESSURE.

    Returns:
        The problem and the largest relative error of the von Mises stress.
    """
    spaces = [compat.function_space(domain, shape=(3,)) for domain, _ in blocks]
    tags = [t for _, t in blocks]
    loads = []
    if ties is None:
        ties = [(k, ABOVE, k + 1, BELOW) for k in range(len(blocks) - 1)]
        for i, a, j, b in ties:
            below, above = (spaces[i], tags[i], a), (spaces[j], tags[j], b)
            loads.append(llm.free_surface_load(*below, PRESSURE, covered_by=above))
            loads.append(llm.free_surface_load(*above, PRESSURE, covered_by=below))
        tops = [len(blocks) - 1]
    else:
        tops = range(1, len(blocks))
    loads += [llm.free_surface_load(spaces[k], tags[k], ABOVE, PRESSURE) for k in tops]
    for load in loads:
        x = load.function_space.tabulate_dof_coordinates()[:, :2]
        load.x.array[:] *= np.repeat(1.0 + x @ slope, 3)
    interfaces = [
        llm.Interface(None, ((tags[i], a), (tags[j], b)), frame=frame) for i, a, j, b in ties
    ]
    forms = [(ufl.TrialFunction(V), ufl.TestFunction(V)) for V in spaces]
    problem = llm.ContactProblem(
        [ufl.inner(stress(u), ufl.grad(w)) * ufl.dx for u, w in forms],
        [
            ufl.inner(fem.Constant(V.mesh, np.zeros(3)), w) * ufl.dx
            for V, (_, w) in zip(spaces, forms, strict=True)
        ],
        bcs=supports(spaces[0], low, high),
        interfaces=interfaces,
        nodal_loads=loads,
    )
    error = 0.0
    for u in problem.solve():
        domain = u.function_space.mesh
        values = post.at_quadrature_points(post.von_mises(stress(u)), domain)
        local = np.abs(values / PRESSURE - 1.0).max(initial=0.0)
        error = max(error, domain.comm.allreduce(local, op=MPI.MAX))
    return problem, error


def random_pair(comm, seed, slope=(0.0, 0.0)):
    """Two blocks of random kinds, meshes, sizes, rotation and overlap; slope: of ``stack``."""
    rng = np.random.default_rng(seed)
    kinds = [str(rng.choice(["hexahedron", "tetrahedron"])) for _ in range(2)]
    ratio = rng.uniform(1, 10) if rng.random() < 0.4 else rng.uniform(1, 2.5)
    coarse = rng.integers(2, 6)
    counts = [coarse, min(max(2, round(coarse * ratio)), 24)]
    if rng.random() < 0.5:
        counts.reverse()
    n = [(c, max(2, c + rng.integers(-1, 2)), 2) for c in counts]
    half = rng.uniform(0.4, 1.6, 2)
    angle = rng.uniform(0, np.pi)
    shift = rng.uniform(-1, 1, 2) * (0.9 * (1 + half) - 0.3) * rng.choice([0.0, 0.5, 1.0])
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def move(x):
        return np.column_stack([x[:, :2] @ R.T + shift, x[:, 2]])

    low, high = (-1.0, -1.0, 0.0), (1.0, 1.0, 1.0)
    lower = block(comm, n[0], low, high, kinds[0], jitter=0.25, rng=rng)
    upper = block(
        comm, n[1], (*-half, 1.0), (*half, 2.0), kinds[1], jitter=0.25, rng=rng, move=move
    )
    return stack([lower, upper], low, high, slope=slope)
