"""Small scenes for the tests: bodies of bricks on plane quads, with meshes that do not match."""

import numpy as np
import ufl
from dolfinx import fem, mesh

import dolfinx_llm as llm
from dolfinx_llm import compat

E, NU, PRESSURE = 2600.0, 0.3, 260.0
STRAIN = np.array([NU, NU, -1.0]) * PRESSURE / E  # of uniaxial stress -PRESSURE along z


def grid(nx, ny, low=(0.0, 0.0), high=(1.0, 1.0), jitter=0.0, seed=7):
    """Nodes and anticlockwise quads of a rectangle; inner nodes moved by up to jitter cells."""
    u, v = np.linspace(0.0, 1.0, nx + 1), np.linspace(0.0, 1.0, ny + 1)
    s, t = (g.ravel() for g in np.meshgrid(u, v, indexing="ij"))
    inner = (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)
    move = np.random.default_rng(seed).uniform(-jitter, jitter, (len(s), 2)) * inner[:, None]
    x = np.column_stack([s, t]) + move / [nx, ny]
    corner = np.array([i * (ny + 1) + j for i in range(nx) for j in range(ny)])
    quads = corner[:, None] + np.array([0, ny + 1, ny + 2, 1])
    return np.asarray(low) + x * (np.asarray(high) - low), quads


def stacked(comm, sections, heights, layers=(2, 2), transform=lambda x: x):
    """One mesh of bodies that share no node, one on top of the other.

    Args:
        comm: MPI communicator.
        sections: per body its plane nodes and quads.
        heights: levels: body k reaches from heights[k] to heights[k + 1].
        layers: of bricks, per body.
        transform: moves the points after tagging.

    Returns:
        Mesh and facet tags: the bottom of body k has tag 2 k + 1, its top 2 k + 2.
    """
    points, cells, ends = [], [], [0]
    for k, (x, quads) in enumerate(sections):
        n, bricks = len(x), quads[:, [0, 1, 3, 2]]
        for layer, z in enumerate(np.linspace(heights[k], heights[k + 1], layers[k] + 1)):
            points.append(np.column_stack([x, np.full(n, z)]))
            if layer < layers[k]:
                first = ends[-1] + layer * n
                cells.append(np.concatenate([bricks + first, bricks + first + n], axis=1))
        ends.append(ends[-1] + n * (layers[k] + 1))
    where = [
        (tag, k, on(2, z))
        for k in range(len(sections))
        for tag, z in ((2 * k + 1, heights[k]), (2 * k + 2, heights[k + 1]))
    ]
    domain, tags = bodies_mesh(comm, points, cells, "hexahedron", ends, where)
    domain.geometry.x[:] = transform(domain.geometry.x)
    return domain, tags


def bodies_mesh(comm, points, cells, kind, ends, where):
    """Mesh of several bodies and tags of their facets.

    Args:
        points, cells: lists of arrays, body by body.
        ends: first node of each body, and their number.
        where: of (tag, body, function of points).
    """
    points, cells = np.concatenate(points), np.concatenate(cells)
    if comm.rank > 0:
        points, cells = points[:0], cells[:0]
    domain = compat.create_mesh(comm, cells, points, kind)
    dim = domain.topology.dim
    node = np.asarray(domain.geometry.input_global_indices)
    body = np.searchsorted(ends, node[compat.cell_dofs(domain.geometry)[:, 0]], side="right") - 1
    domain.topology.create_connectivity(dim - 1, dim)
    to_cell = domain.topology.connectivity(dim - 1, dim)
    entities, values = [], []
    for tag, k, at in where:
        found = mesh.locate_entities_boundary(domain, dim - 1, at)
        found = found[body[to_cell.array[to_cell.offsets[found]]] == k]
        entities.append(found)
        values.append(np.full(len(found), tag, dtype=np.int32))
    return domain, tags_from(domain, entities, values, dim - 1)


def tags_from(domain, entities, values, dim=2):
    """Mesh tags from lists of entities and values in any order."""
    entities, values = np.concatenate(entities), np.concatenate(values)
    order = np.argsort(entities, kind="stable")
    return mesh.meshtags(domain, dim, entities[order].astype(np.int32), values[order])


def stress(u, scale=1.0):
    """Hooke's law in 2D (plane strain) and 3D; ``scale`` multiplies E."""
    mu, lam = E / (2 * (1 + NU)), E * NU / (1 + NU) / (1 - 2 * NU)
    eps = ufl.sym(ufl.grad(u))
    return scale * (2 * mu * eps + lam * ufl.tr(eps) * ufl.Identity(len(u)))


def forms(V, scale=1.0):
    """Bilinear form of linear elasticity and a zero linear form."""
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    zero = fem.Constant(V.mesh, np.zeros(V.mesh.geometry.dim))
    return ufl.inner(stress(u, scale), ufl.grad(w)) * ufl.dx, ufl.inner(zero, w) * ufl.dx


def elastic_problem(spaces, bcs, interfaces, **options):
    """Elastic bodies without loads."""
    a, L = zip(*map(forms, spaces), strict=True)
    return llm.ContactProblem(list(a), list(L), bcs=bcs, interfaces=interfaces, **options)


def hold(V, conditions, value=None):
    """Dirichlet conditions from pairs (component, where); zero, or a function's component."""
    bcs = []
    for k, where in conditions:
        Vk, to_V = V.sub(k).collapse()
        prescribed = fem.Function(Vk)
        if value is not None:
            prescribed.interpolate(lambda p, k=k: value(p)[k])
        dofs = fem.locate_dofs_geometrical((V.sub(k), Vk), where)
        bcs.append(fem.dirichletbc(prescribed, dofs, V.sub(k)))
    return bcs


def on(axis, level):
    """Points at a coordinate."""
    return lambda p: np.isclose(p[axis], level)


SYMMETRY = ((2, on(2, 0.0)), (0, on(0, 0.0)), (1, on(1, 0.0)))  # planes through the contact too


def two_blocks(comm, n0=4, n1=3, jitter=0.25, **kwargs):
    """Two jittered unit cubes on each other: tags 2 (top of the lower) and 3 face each other."""
    sections = (grid(n0, n0, jitter=jitter, seed=2001), grid(n1, n1, jitter=jitter, seed=11))
    domain, tags = stacked(comm, sections, (0.0, 1.0, 2.0), **kwargs)
    return compat.function_space(domain, shape=(3,)), tags


def block_problem(V, tags, sides=(2, 3), bcs=None, loads=None, scale=1.0, options=None, **chosen):
    """Two blocks under pressure on top, symmetry planes at x = 0 and y = 0."""
    a, L = forms(V, scale)
    return llm.ContactProblem(
        a,
        L,
        bcs=hold(V, SYMMETRY) if bcs is None else bcs,
        interfaces=[llm.Interface(tags, sides, **chosen)],
        nodal_loads=[llm.free_surface_load(V, tags, 4, PRESSURE)] if loads is None else loads,
        **(options or {}),
    )


def squares(domain, terms, degree=None):
    """Integrals of |e|² over a mesh, of each of several expressions e; one form for all, as
    compiling it takes longer than all else."""
    weights, found = [fem.Constant(domain, 0.0) for _ in terms], []
    form = sum(c * ufl.inner(e, e) for c, e in zip(weights, terms, strict=True))
    form = fem.form(form * ufl.dx(domain, degree=degree))
    for c in weights:
        c.value = 1.0
        found.append(domain.comm.allreduce(fem.assemble_scalar(form)))
        c.value = 0.0
    return np.array(found)


def displacement_error(u, exact):
    """Largest error at this function's nodes over the largest displacement, on all ranks."""
    V = u.function_space
    gdim = V.mesh.geometry.dim
    n = V.dofmap.index_map.size_local
    x = V.tabulate_dof_coordinates()[:n]
    known = exact(x.T).T[:, :gdim]
    got = u.x.array[: n * gdim].reshape(n, gdim)
    error, size = np.abs(got - known).max(initial=0.0), np.abs(known).max(initial=0.0)
    return max(V.mesh.comm.allgather(error)) / max(V.mesh.comm.allgather(size))


def uniaxial(p):
    """Exact displacement of uniaxial stress, at points (3, n)."""
    return STRAIN[:, None] * p[:3]


def sorted_nodes(u):
    """Positions and values at all nodes, the same on every rank and for every number of them."""
    V = u.function_space
    gdim, n = V.mesh.geometry.dim, V.dofmap.index_map.size_local
    x, value = V.tabulate_dof_coordinates()[:n, :gdim], u.x.array[: n * gdim].reshape(n, gdim)
    # Bodies that touch have two nodes at one place: that its cells are below or above tells.
    dofs = compat.cell_dofs(V)
    centre = np.zeros((n + V.dofmap.index_map.num_ghosts, gdim))
    count = np.zeros(len(centre))
    full = V.tabulate_dof_coordinates()[:, :gdim]
    for column in dofs.T:
        np.add.at(centre, column, full[dofs].mean(axis=1))
        np.add.at(count, column, 1.0)
    side = np.sign(np.round((centre / np.maximum(count, 1.0)[:, None])[:n] - x, 6))
    rows = np.concatenate(V.mesh.comm.allgather(np.column_stack([x, side[:, -1], value])))
    order = np.lexsort(np.round(rows[:, [gdim, *range(gdim)]], 8).T)
    return rows[order, :gdim], rows[order, gdim + 1 :]


def check_uniaxial(contact, u):
    """Require the exact answer of two blocks under ``PRESSURE``, forces and frame with it."""
    assert displacement_error(u, uniaxial) <= 1e-12
    result = contact.results[0]
    assert np.abs(result.frame.v - STRAIN * result.frame.x).max() <= 1e-13
    for side in result.sides:
        force = PRESSURE * side.area
        assert np.abs(side.normal_force - force).max() <= 1e-12 * force.max()
        # Tangential ones as well: nothing undetermined is left in the multipliers. Rounding grows
        # by 1 / 0.005, the smallest singular value of the rows of L_b at prescribed dofs.
        assert np.abs(side.tangential_force).max() <= 1e-10 * force.max()
