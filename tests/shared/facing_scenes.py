"""Bodies whose whole surfaces are tagged, in any orientation."""

import contact_scenes as cs
import numpy as np
import ufl
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
    forms = [(ufl.TrialFunction(V), ufl.TestFunction(V)) for V in spaces]
    problem = llm.ContactProblem(
        [ufl.inner(cs.stress(u), ufl.grad(w)) * ufl.dx for u, w in forms],
        [
            ufl.inner(fem.Constant(V.mesh, np.zeros(gdim)), w) * ufl.dx
            for V, (_, w) in zip(spaces, forms, strict=True)
        ],
        bcs=bcs,
        interfaces=interfaces([tags for _, tags in bodies], R),
    )
    u = problem.solve()
    return problem, [f.x.array.reshape(-1, gdim) @ R for f in u], R


def apart(one, other):
    """Largest difference of displacements over the largest one."""
    size = max(np.abs(u).max() for u in one)
    return max(np.abs(u - v).max() for u, v in zip(one, other, strict=True)) / size
