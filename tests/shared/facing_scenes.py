"""Bodies whose whole surfaces are tagged, in any orientation."""

import contact_scenes as cs
import curved_scenes
import numpy as np
import pairs
import scenes
from dolfinx import fem, mesh

import dolfinx_llm as llm
from dolfinx_llm import compat

SURFACE, HOLE = 1, 2
ARC = 1.0  # [rad] of the part of a disc that faces a plane below it


def tagged(domain, groups):
    """Facet tags 1, 2, ... of groups of facets; the first that names a facet counts."""
    facets, first = np.unique(np.concatenate(groups), return_index=True)
    values = np.repeat(np.arange(1, len(groups) + 1), [len(g) for g in groups])[first]
    return mesh.meshtags(domain, domain.topology.dim - 1, facets, values.astype(np.int32))


def ring(comm, n, k=4, radius=1.0, inner=0.4, centre=(0.0, 1.0), whole=True, depth=0.0):
    """A ring of n bricks around and k through; its outer circle tagged, wholly or what faces down
    (or an angle from there).

    With a depth it is a tube of two layers of hexahedra along z.
    """
    t = 2 * np.pi * np.arange(n) / n - np.pi / 2
    r = np.linspace(inner, radius, k + 1)
    x = (r[:, None, None] * np.column_stack([np.cos(t), np.sin(t)])).reshape(-1, 2) + centre
    i, j = (g.ravel() for g in np.meshgrid(np.arange(k), np.arange(n), indexing="ij"))
    a, b = i * n + j, i * n + (j + 1) % n
    cells = np.column_stack([a, a + n, b, b + n])
    kind = "quadrilateral"
    if depth:
        layers, m = np.linspace(0.0, depth, 3), len(x)
        x = np.concatenate([np.column_stack([x[:, 0], 0 * x[:, 0] + z, x[:, 1]]) for z in layers])
        cells = np.concatenate([np.hstack([cells, cells + m]) + m * layer for layer in (0, 1)])
        kind = "hexahedron"
    if comm.rank:
        x, cells = x[:0], cells[:0]
    domain = compat.create_mesh(comm, cells, x, kind)
    dim = domain.topology.dim
    up = dim - 1  # the axis that points up
    away = lambda p: np.hypot(p[0] - centre[0], p[up] - centre[1])  # noqa: E731
    low = radius * (1.0 - np.cos(ARC if whole is False else whole))
    at = [
        lambda p: (
            np.isclose(away(p), radius) & ((whole is True) | (p[up] < centre[1] - radius + low))
        ),
        lambda p: np.isclose(away(p), inner),
    ]
    return domain, tagged(domain, [mesh.locate_entities_boundary(domain, dim - 1, f) for f in at])


def all_tagged(body):
    """The same body with its whole boundary tagged ABOVE."""
    domain, dim = body[0], body[0].topology.dim
    facets = mesh.locate_entities_boundary(domain, dim - 1, lambda p: np.isfinite(p[0]))
    return domain, mesh.meshtags(
        domain, dim - 1, np.sort(facets), np.full(len(facets), cs.ABOVE, dtype=np.int32)
    )


def turn(gdim, seed):
    """A rotation; the identity for None."""
    if seed is None:
        return np.eye(gdim)
    Q = np.linalg.qr(np.random.default_rng(seed).standard_normal((gdim, gdim)))[0]
    Q[:, 0] *= np.linalg.det(Q)
    return Q


def solved(bodies, interfaces, moved, fixed, motion, seed=None, obstacle=None):
    """Solve with all bodies turned, and turn the answer back.

    Args:
        bodies: [(mesh, tags), ...].
        interfaces: function of the bodies' tags and the rotation that gives them.
        moved: [(body, where it is moved), ...]; fixed: the same.
        motion: (gdim,) of what is moved.

    Returns:
        The problem, the displacements (n, gdim) turned back, the rotation.
    """
    gdim = bodies[0][0].geometry.dim
    R = turn(gdim, seed)
    spaces = [compat.function_space(d, shape=(gdim,)) for d, _ in bodies]
    bcs = []
    for where, amount in ((moved, R @ np.array(motion, float)), (fixed, np.zeros(gdim))):
        for body, at in where:
            value = fem.Function(spaces[body])
            for k in range(gdim):
                value.x.array[k::gdim] = amount[k]
            bcs.append(fem.dirichletbc(value, fem.locate_dofs_geometrical(spaces[body], at)))
    for domain, _ in bodies:
        domain.geometry.x[:, :gdim] = domain.geometry.x[:, :gdim] @ R.T
    problem = scenes.elastic_problem(spaces, bcs, interfaces([tags for _, tags in bodies], R))
    u = problem.solve()
    return problem, [f.x.array.reshape(-1, gdim) @ R for f in u], R


def apart(one, other):
    """Largest difference of displacements over the largest one."""
    size = max(np.abs(u).max() for u in one)
    return max(np.abs(u - v).max() for u, v in zip(one, other, strict=True)) / size


def roller(n, layers=3):
    """The shell of a cylinder of radius 1 along y that touches z = 0."""
    t, y = np.meshgrid(
        np.linspace(0, 2 * np.pi, n, False), np.linspace(0, 1, layers + 1), indexing="ij"
    )
    x = np.column_stack([np.cos(t.ravel()), y.ravel(), 1.0 + np.sin(t.ravel())])
    i, j = (g.ravel() for g in np.meshgrid(np.arange(n), np.arange(layers), indexing="ij"))
    m = layers + 1
    a, b = i * m + j, (i + 1) % n * m + j
    return curved_scenes.surface(x, np.column_stack([a, a + 1, b + 1, b]), "roller")


def on_block(comm, law, whole=True, block=False, seed=None, depth=0.0, n=48, motion=-0.02):
    """A roller pressed on a block: its whole circle tagged or a part, the block's top or all of it.

    With a depth in 3D.
    """
    rng = np.random.default_rng(5)
    roller = ring(comm, n, whole=whole, depth=depth)
    if depth:
        base = pairs.block(
            comm, (16, 3, 2), (-1.5, 0, -1), (1.5, depth, 0), "hexahedron", jitter=0.2, rng=rng
        )
    else:
        base = cs.rectangle(comm, (30, 6), (-1.5, -1.0), (1.5, 0.0), "triangle", 0.2, rng)
    base = all_tagged(base) if block else base

    def interfaces(tags, R):
        return llm.Interface(None, ((tags[0], SURFACE), (tags[1], cs.ABOVE)), law=law)

    down = np.eye(roller[0].geometry.dim)[-1] * motion
    fixed = [(1, lambda p: p[roller[0].geometry.dim - 1] < -1.0 + 1e-9)]
    up = roller[0].geometry.dim - 1
    moved = [(0, lambda p: np.hypot(p[0], p[up] - 1.0) < 0.41)]
    return solved([roller, base], interfaces, moved, fixed, down, seed)


def squeezed(comm, law, seed=None):
    """An O-ring between two plates."""
    rng = np.random.default_rng(11)
    o_ring = ring(comm, 40, inner=0.5)
    low = cs.rectangle(comm, (21, 4), (-1.5, -0.5), (1.5, 0.0), "triangle", 0.2, rng)
    high = cs.rectangle(comm, (17, 4), (-1.5, 2.0), (1.5, 2.5), "quadrilateral", 0.2, rng)

    def interfaces(tags, R):
        return [
            llm.Interface(None, ((tags[0], SURFACE), (tags[1], cs.ABOVE)), law=law),
            llm.Interface(None, ((tags[0], SURFACE), (tags[2], cs.BELOW)), law=law),
        ]

    moved, fixed = [(2, lambda p: p[1] > 2.5 - 1e-9)], [(1, lambda p: p[1] < -0.5 + 1e-9)]
    # The ring is held against sliding where its hole is, with nothing to carry by symmetry.
    fixed.append((0, lambda p: (np.abs(p[0]) < 1e-9) & (p[1] > 1.49) & (p[1] < 1.51)))
    return solved([o_ring, low, high], interfaces, moved, fixed, (0.0, -0.03), seed)
