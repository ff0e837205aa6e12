"""Two blocks of second order on each other, in 2D and 3D, with polynomial answers."""

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scenes import bodies_mesh, displacement_error, on, squares, tags_from
from scipy.sparse.linalg import spsolve

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.geometry.loads import NodalLoads
from dolfinx_llm.geometry.overlap_flat import common_area, common_plane
from dolfinx_llm.geometry.surface import extract_surface

MU, LAMBDA = 1000.0, 1500.0  # of an elastic body with E = 2600, nu = 0.3

KUHN = np.array(
    [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]]
)
LATERAL, BOTTOM, TOP = 9, (1, 3), (2, 4)


def block(kind, n, layers, low, high, jitter, rng):
    """Points and cells of a box between corners, n cells along each direction of its section, whose
    nodes are moved by up to ``jitter`` cells; cells in dolfinx's order of nodes."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    gdim = len(low)
    counts = [n] * (gdim - 1) + [layers]
    axes = [np.linspace(0.0, 1.0, c + 1) for c in counts]
    x = np.stack([g.ravel() for g in np.meshgrid(*axes, indexing="ij")], axis=1)
    flat = len(axes[-1])
    section = x[::flat, :-1]
    inner = (section > 1e-9) & (section < 1.0 - 1e-9)
    move = rng.uniform(-jitter, jitter, section.shape) * inner / n
    x[:, :-1] += np.repeat(move, flat, axis=0)
    number = np.arange(len(x)).reshape([c + 1 for c in counts])
    ends = np.meshgrid(*[[0, 1]] * gdim, indexing="ij")
    corner = np.stack([e.T.ravel() for e in ends], axis=1)  # the first axis runs fastest
    cells = np.stack(
        [number[tuple(slice(e, c + e) for e, c in zip(k, counts))].ravel() for k in corner], axis=1
    )
    if kind == "triangle":
        cells = cells[:, [[0, 1, 3], [0, 3, 2]]].reshape(-1, 3)
    elif kind == "tetrahedron":
        cells = cells[:, KUHN].reshape(-1, 4)
    return low + x * (high - low), cells


def blocks(comm, kinds, n, low=((0, 0, 0), (0, 0, 1)), high=((1, 1, 1), (1, 1, 2)), **chosen):
    """Spaces and facet tags of two boxes: one pair for both where they are of one kind, else one
    each. Bottoms have the tags 1 and 3, tops 2 and 4, all other sides 9.

    Args:
        kinds: of each body's cells.
        n: cells along each.
        low, high: corners, last coordinate across the interface.
        chosen: ``degrees`` of both (2, 2), ``jitter``, ``seed``, ``turn``: a matrix applied to all
            points.
    """
    jitter, seed = chosen.get("jitter", 0.15), chosen.get("seed", 2001)
    degrees, turn = chosen.get("degrees", (2, 2)), chosen.get("turn")
    rng, spaces, tags = np.random.default_rng(seed), [], []
    made = [
        block(kind, k, max(1, k // 2), a, b, jitter, rng)
        for kind, k, a, b in zip(kinds, n, low, high, strict=True)
    ]
    same = kinds[0] == kinds[1] and degrees[0] == degrees[1]
    for bodies in [(0, 1)] if same else [(0,), (1,)]:
        points, cells, ends, where = [], [], [0], []
        for j, k in enumerate(bodies):
            x, own = made[k]
            points.append(x)
            cells.append(own + ends[-1])
            ends.append(ends[-1] + len(x))
            axis = x.shape[1] - 1
            where += [(2 * k + 1, j, on(axis, low[k][-1])), (2 * k + 2, j, on(axis, high[k][-1]))]
        kind = kinds[bodies[0]]
        domain, own = bodies_mesh(comm, points, cells, kind, ends, where)
        dim = domain.topology.dim
        rest = mesh.exterior_facet_indices(domain.topology)
        rest = np.setdiff1d(rest, own.indices)
        values = [own.values, np.full(len(rest), LATERAL, dtype=np.int32)]
        tags.append(tags_from(domain, [own.indices, rest], values, dim - 1))
        if turn is not None:
            domain.geometry.x[:, :dim] = domain.geometry.x[:, :dim] @ np.asarray(turn).T
        shape = (dim,)
        spaces.append(compat.function_space(domain, degree=degrees[bodies[0]], shape=shape))
    return spaces, tags


class Polynomial:
    """A vector field of random polynomials of a degree."""

    def __init__(self, degree, gdim, seed=77):
        rng = np.random.default_rng(seed)
        self.linear = 0.01 * rng.uniform(-1, 1, (gdim, gdim))
        self.square = 0.01 * (degree > 1) * rng.uniform(-1, 1, (gdim, gdim, gdim))

    def __call__(self, x):
        """Components at NumPy coordinates x (gdim or more, n)."""
        x = x[: len(self.linear)]
        return self.linear @ x + np.einsum("ijk,jn,kn->in", self.square, x, x)

    def expression(self, domain):
        x = ufl.SpatialCoordinate(domain)
        linear, square = ufl.as_matrix(self.linear.tolist()), ufl.as_tensor(self.square.tolist())
        i, j, k = ufl.indices(3)
        return ufl.as_vector(linear[i, j] * x[j] + square[i, j, k] * x[j] * x[k], i)

    def stress(self, x):
        """(n, gdim, gdim) at points x (n, gdim)."""
        both = self.square + self.square.transpose(0, 2, 1)
        grad = self.linear + np.einsum("ijk,nk->nij", both, x)
        eps = 0.5 * (grad + grad.transpose(0, 2, 1))
        trace = np.einsum("nii->n", eps)[:, None, None] * np.eye(x.shape[1])
        return 2 * MU * eps + LAMBDA * trace


def stress(u):
    eps = ufl.sym(ufl.grad(u))
    return 2 * MU * eps + LAMBDA * ufl.tr(eps) * ufl.Identity(len(u))


def elasticity(V):
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    return ufl.inner(stress(u), ufl.grad(w)) * ufl.dx


def covered_forces(side, other, field):
    """(n, gdim) nodal forces of the field's traction on what another surface covers of a side."""
    plane = common_plane(side, other)
    s = plane.project(side.x)
    loads = NodalLoads.on(side, s, common_area(side, other, plane), 2)
    normal = side.normal / np.linalg.norm(side.normal)
    at = field.stress(side.x) @ normal
    forces = loads.forces[:, None] * at
    for t, moment in zip(plane.base, loads.moments.T):
        forces += moment[:, None] * ((field.stress(side.x + t) @ normal) - at)
    return forces


def outer_forces(V, a, own, sides, field):
    """Function of the nodal forces that hold bodies in the state of a polynomial which V contains,
    but for those that act between two sides, of which these have some as their ``own``."""
    known, load = fem.Function(V), fem.Function(V)
    known.interpolate(field)
    n = V.dofmap.index_map.size_local * V.dofmap.index_map_bs
    K = compat.assemble_matrix(fem.form(a), [], 1.0)
    x, b = K.createVecs()
    x.array_w[:] = known.x.array[:n]
    K.mult(x, b)
    load.x.array[:n] = b.array_r
    for side in own:
        other = next(s for s in sides if s is not side)
        mine = side.owner == V.mesh.comm.rank
        gdim, start = side.x.shape[1], V.dofmap.index_map.local_range[0]
        dofs = (side.dofs[mine] - start)[:, None] * gdim + np.arange(gdim)
        load.x.array[dofs.ravel()] -= covered_forces(side, other, field)[mine].ravel()
    return load


def held_ends(V, tags, field):
    """Conditions that prescribe a field on the first bottom and the last top."""
    known = fem.Function(V)
    known.interpolate(field)
    at = np.concatenate([tags.find(tag) for tag in (BOTTOM[0], TOP[1])]).astype(np.int32)
    dofs = fem.locate_dofs_topological(V, V.mesh.geometry.dim - 1, np.sort(at))
    return fem.dirichletbc(known, dofs)


def _problem(a, L, spaces, tags, field, interface, make=llm.ContactProblem, **options):
    sides = (2, 3) if len(tags) == 1 else ((tags[0], 2), (tags[1], 3))
    one = len(spaces) == 1
    bcs = [held_ends(V, own, field) for V, own in zip(spaces, tags, strict=True)]
    chosen = [llm.Interface(tags[0], sides, **(interface or {}))]
    a, L = (a[0], L[0]) if one else (a, L)
    return make(a, L, bcs=bcs, interfaces=chosen, **options)


def patch_problem(spaces, tags, field, interface=None, **options):
    """Two tied blocks with the answer ``field``, a polynomial that both spaces contain: prescribed
    on the first bottom and the last top, with the nodal forces that belong to it elsewhere."""
    a, zero = [elasticity(V) for V in spaces], []
    for V in spaces:
        none = fem.Constant(V.mesh, np.zeros(V.mesh.geometry.dim))
        zero.append(ufl.inner(none, ufl.TestFunction(V)) * ufl.dx)
    sides = [extract_surface(spaces[k], tags[k], tag) for k, tag in ((0, 2), (-1, 3))]
    loads = [
        outer_forces(V, form, sides if len(spaces) == 1 else sides[k : k + 1], sides, field)
        for k, (V, form) in enumerate(zip(spaces, a, strict=True))
    ]
    return _problem(a, zero, spaces, tags, field, interface, nodal_loads=loads, **options)


def manufactured_problem(spaces, tags, field, interface=None, quadrature=None, **options):
    """Two tied blocks that cover each other, with the answer ``field``: prescribed on the first
    bottom and the last top, with its body forces, and its tractions at the other sides; both of
    the degree of ``quadrature``, if one is given."""
    a, L = [elasticity(V) for V in spaces], []
    for V, own in zip(spaces, tags, strict=True):
        exact, w = field.expression(V.mesh), ufl.TestFunction(V)
        ds = ufl.Measure("ds", domain=V.mesh, subdomain_data=own)
        traction = stress(exact) * ufl.FacetNormal(V.mesh)
        body = -ufl.inner(ufl.div(stress(exact)), w) * ufl.dx(degree=quadrature)
        L.append(body + ufl.inner(traction, w) * ds(LATERAL, degree=quadrature))
    return _problem(a, L, spaces, tags, field, interface, **options)


def largest_error(u, field):
    """Largest error of a solution, or of several, at nodes over the largest displacement."""
    return max(
        displacement_error(v, lambda x: np.pad(field(x), ((0, 3 - len(field(x))), (0, 0))))
        for v in (u if isinstance(u, list) else [u])
    )


def errors(u, field):
    """Relative errors of a solution, or of several, in L2 and in the gradient."""
    sums = np.zeros(4)
    for v in u if isinstance(u, list) else [u]:
        domain = v.function_space.mesh
        exact = field.expression(domain)
        sums += squares(domain, (v - exact, exact, ufl.grad(v - exact), ufl.grad(exact)), 6)
    return np.sqrt(sums[0] / sums[1]), np.sqrt(sums[2] / sums[3])


class Pressed(Polynomial):
    """Uniform stress along the last axis."""

    def __init__(self, gdim):
        self.linear = 1e-3 * np.diag([0.3] * (gdim - 1) + [-1.0])
        self.square = np.zeros((gdim,) * 3)


class Waves:
    """A smooth vector field that is no polynomial."""

    def __init__(self, gdim):
        rng = np.random.default_rng(29)
        self.k, self.phase = rng.uniform(0.8, 1.6, (gdim, gdim)), rng.uniform(0.0, 2.0, gdim)

    def __call__(self, x):
        return 0.01 * np.sin(self.k @ x[: len(self.k)] + self.phase[:, None])

    def expression(self, domain):
        x = ufl.SpatialCoordinate(domain)
        k, phase = (fem.Constant(domain, c) for c in (self.k, self.phase))
        i, j = ufl.indices(2)
        angle = ufl.as_vector(k[i, j] * x[j] + phase[i], i)
        return ufl.as_vector([0.01 * ufl.sin(angle[m]) for m in range(len(self.k))])

    def stress(self, x):
        """(n, gdim, gdim) at points x (n, gdim)."""
        slope = 0.01 * np.cos(x @ self.k.T + self.phase)
        eps = slope[:, :, None] * self.k
        eps = 0.5 * (eps + eps.transpose(0, 2, 1))
        trace = np.einsum("nii->n", eps)[:, None, None] * np.eye(x.shape[1])
        return 2 * MU * eps + LAMBDA * trace


def traction_errors(result, field, geometry=None):
    """Per side the relative error of the traction that is read at its nodes, by their areas; with a
    tied interface's geometry by nothing but the integrals of the shape functions' products."""
    out, read = [], [side.density for side in result.sides]
    if geometry is not None:
        sides = zip(geometry.pairs, result.sides, strict=True)
        read = [spsolve(p.loads.mass.tocsc(), side.force) for p, side in sides]
    for side, density in zip(result.sides, read, strict=True):
        exact = -np.einsum("nij,nj->ni", field.stress(side.x), side.normal)
        weight = np.abs(side.area) + 1e-2 * np.abs(side.area).max()
        error, size = (weight @ (v**2).sum(axis=1) for v in (density - exact, exact))
        out.append(float(np.sqrt(error / size)))
    return out


def overhanging(kind, n, law, make=llm.ContactProblem):
    """A block pressed by one that is coarser, far stiffer and longer at both ends.

    Args:
        kind: of the cells.
        n: of them along each.
        law: between the blocks.
        make: of forms and what else a problem takes, the problem.
    """
    gdim = 2 if kind in ("triangle", "quadrilateral") else 3
    low, high = [[0.0, 0.0, 0.0], [-0.5, -0.4, 0.5]], [[3.0, 1.0, 0.5], [3.5, 1.4, 0.9]]
    if gdim == 2:
        low, high = np.delete(low, 1, axis=1), np.delete(high, 1, axis=1)
    (V,), (tags,) = blocks(MPI.COMM_SELF, (kind, kind), n, low, high, jitter=0.0)
    u, w, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(V.mesh)
    stiff = ufl.conditional(ufl.lt(x[gdim - 1], 0.5), 0.02, 0.8)
    a = stiff * ufl.inner(stress(u), ufl.grad(w)) * ufl.dx
    L = ufl.dot(fem.Constant(V.mesh, np.zeros(gdim)), w) * ufl.dx

    def down(x):
        found = np.zeros((gdim, x.shape[1]))
        found[-1] = -0.03 * x[gdim - 1] / 0.9
        return found

    interfaces = [llm.Interface(tags, (2, 3), law=law)]
    return make(a, L, bcs=[held_ends(V, tags, down)], interfaces=interfaces)


def largest_pressures(result):
    """(3,) of the sides' own tractions, and at the frame's nodes; the finer side is the first."""
    own = [np.einsum("ni,ni->n", s.density, s.normal).max() for s in result.sides]
    return np.array([*own, result.pressure.max()])
