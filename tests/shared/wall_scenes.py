"""Walls: blocks on one mesh that share no node, and touch at beds, head joints and crosses."""

import numpy as np
import ufl
from dolfinx import fem, mesh
from petsc4py import PETSc

import dolfinx_llm as llm
from dolfinx_llm import compat

E, NU = 2600.0, 0.3
OUTER = 1  # tag of what no other block touches; block b has 2 + 2 gdim b + 2 axis + end
TETS = [[0, 1, 3, 7], [0, 1, 5, 7], [0, 4, 5, 7], [0, 2, 3, 7], [0, 2, 6, 7], [0, 4, 6, 7]]


def courses(rows, columns, bond=0.5, depth=None):
    """(low, high) of the blocks of a wall of ``rows`` courses, blocks 1 x 0.5 (x depth); every
    other course begins with a part ``bond`` of a block, 0: crosses."""
    found = []
    for r in range(rows):
        cuts = np.arange(columns + 1.0)
        if r % 2 and bond:
            cuts = np.concatenate([[0.0], np.arange(columns) + bond, [columns]])
        for a, b in zip(cuts[:-1], cuts[1:], strict=True):
            low, high = [a, 0.5 * r], [b, 0.5 * (r + 1)]
            found.append((low, high) if depth is None else (low + [0.0], high + [depth]))
    return np.array(found)


def cubes(*n):
    """(low, high) of unit cubes or squares, corner to corner."""
    low = np.stack(np.meshgrid(*map(np.arange, n), indexing="ij"), axis=-1).reshape(-1, len(n))
    return np.stack([low, low + 1.0], axis=1)


def touching(blocks):
    """(block, axis, block): the high face along an axis of the first touches the second's low."""
    low, high = blocks[:, 0], blocks[:, 1]
    out = []
    for axis in range(low.shape[1]):
        others = [k for k in range(low.shape[1]) if k != axis]
        meets = np.abs(high[:, None, axis] - low[None, :, axis]) < 1e-9
        for k in others:
            meets &= np.minimum(high[:, None, k], high[None, :, k]) > 1e-9 + np.maximum(
                low[:, None, k], low[None, :, k]
            )
        out += [(int(i), axis, int(j)) for i, j in np.argwhere(meets)]
    return out


def bricks(low, high, n, kind, first):
    """Points and cells of one block."""
    axes = [np.linspace(a, b, k + 1) for a, b, k in zip(low, high, n, strict=True)]
    gdim = len(axes)
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, gdim)
    node = np.arange(len(x)).reshape([k + 1 for k in n])
    corners = [c[::-1] for c in np.ndindex(*[2] * gdim)]
    cells = np.stack(
        [node[tuple(slice(i, k + i) for i, k in zip(c, n))].ravel() for c in corners], axis=1
    )
    if kind == "triangle":
        cells = np.concatenate([cells[:, [0, 1, 3]], cells[:, [0, 3, 2]]])
    if kind == "tetrahedron":
        cells = cells[:, TETS].reshape(-1, 4)
    return x, cells + first


class Wall:
    """Blocks (b, 2, gdim) with (b, gdim) cells each, tied or with another law at all that touch.

    Args:
        comm: MPI communicator.
        blocks, counts: as above.
        kind: of cells.
        faces: what touches, as of ``touching``; None: all.
        turn: rotation of all, about z.
        degree: of the displacements.
    """

    def __init__(self, comm, blocks, counts, kind="quadrilateral", faces=None, turn=0.0, degree=1):
        self.blocks, self.gdim = blocks, blocks.shape[2]
        points, cells, ends = [], [], [0]
        for (low, high), n in zip(blocks, counts, strict=True):
            x, c = bricks(low, high, n, kind, ends[-1])
            points.append(x)
            cells.append(c)
            ends.append(ends[-1] + len(x))
        x, c = np.concatenate(points), np.concatenate(cells)
        if comm.rank:
            x, c = x[:0], c[:0]
        self.domain = domain = compat.create_mesh(comm, c, x, kind)
        self.faces = touching(blocks) if faces is None else faces
        node = np.asarray(domain.geometry.input_global_indices)
        first = compat.cell_dofs(domain.geometry)[:, 0]
        self.body = np.searchsorted(ends, node[first], side="right") - 1
        self.tags = self._tags()
        R = np.eye(self.gdim)
        R[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        self.R = R
        domain.geometry.x[:, : self.gdim] = domain.geometry.x[:, : self.gdim] @ R.T
        self.V = compat.function_space(domain, degree=degree, shape=(self.gdim,))
        self.ds = ufl.Measure("ds", domain, subdomain_data=self.tags)

    def tag(self, block, axis, end):
        return 2 + 2 * self.gdim * block + 2 * axis + end

    def _tags(self):
        """Facets by block and face; those of the bounding box are ``OUTER``."""
        domain, gdim = self.domain, self.gdim
        box = self.blocks[:, 0].min(axis=0), self.blocks[:, 1].max(axis=0)
        domain.topology.create_connectivity(gdim - 1, gdim)
        to_cell = domain.topology.connectivity(gdim - 1, gdim)
        facets, values = [], []
        for axis in range(gdim):
            for end in (0, 1):
                levels = self.blocks[:, end, axis]
                unique = np.unique(levels.round(9))

                def at(p, axis=axis, levels=unique):
                    return np.abs(p[axis][:, None] - levels).min(axis=1) < 1e-9

                found = mesh.locate_entities_boundary(domain, gdim - 1, at)
                own = self.body[to_cell.array[to_cell.offsets[found]]]
                middle = _midpoints(domain, gdim - 1, found)[:, axis]
                right = np.abs(middle - levels[own]) < 1e-9
                outer = np.abs(middle - box[end][axis]) < 1e-9
                facets.append(found[right])
                values.append(np.where(outer, OUTER, self.tag(own, axis, end))[right])
        facets, values = np.concatenate(facets), np.concatenate(values).astype(np.int32)
        order = np.argsort(facets, kind="stable")
        return mesh.meshtags(domain, gdim - 1, facets[order].astype(np.int32), values[order])

    def interfaces(self, law=None, **options):
        """One at each joint."""
        return [
            llm.Interface(
                self.tags, (self.tag(i, axis, 1), self.tag(j, axis, 0)), law=law or llm.Tied(),
                **options,
            )
            for i, axis, j in self.faces
        ]  # fmt: skip

    def forms(self, traction=None, weight=0.0):
        """a and L, with tractions stress · n on all that is outside."""
        u, w = ufl.TrialFunction(self.V), ufl.TestFunction(self.V)
        pull = np.zeros(self.gdim)
        pull[1] = -weight
        L = ufl.inner(fem.Constant(self.domain, pull), w) * ufl.dx
        if traction is not None:
            n = ufl.FacetNormal(self.domain)
            self.traction = fem.Constant(self.domain, traction)
            L += ufl.inner(ufl.dot(self.traction, n), w) * self.ds(OUTER)
        return ufl.inner(hooke(u), ufl.grad(w)) * ufl.dx, L

    def problem(self, traction=None, weight=0.0, **options):
        """Under tractions on as few supports as hold it, or under its weight on its base."""
        bcs = self.base() if traction is None else self.supports()
        law = options.pop("law", None)
        a, L = self.forms(traction, weight)
        return llm.ContactProblem(a, L, bcs=bcs, interfaces=self.interfaces(law), **options)

    def supports(self):
        """As few as hold it, far apart."""
        low, high = self.blocks[:, 0].min(axis=0), self.blocks[:, 1].max(axis=0)
        at = [low.copy() for _ in range(3)]
        at[1][0] = high[0]
        at[2][1] = high[1]
        held = [(at[0], range(self.gdim)), (at[1], range(1, self.gdim))]
        if self.gdim == 3:
            held.append((at[2], [2]))
        bcs = []
        for point, components in held:
            p = np.zeros(3)
            p[: self.gdim] = self.R @ point
            dofs = fem.locate_dofs_geometrical(
                self.V, lambda x, p=p: np.abs(x - p[:, None]).max(axis=0) < 1e-9
            )
            for k in components:
                bcs.append(
                    fem.dirichletbc(np.float64(0.0), _component(self.V, k, dofs), self.V.sub(k))
                )
        return bcs

    def base(self):
        """All nodes at the base held."""
        zero = fem.Function(self.V)
        dofs = fem.locate_dofs_geometrical(self.V, lambda x: np.abs(self._drawn(x)[1]) < 1e-9)
        return [fem.dirichletbc(zero, dofs)]

    def alone(self, **loads):
        """Displacement of a single block, without any interface."""
        a, L = self.forms(**loads)
        a, bcs, ksp = fem.form(a), self.base(), PETSc.KSP().create(self.domain.comm)
        ksp.setOperators(compat.assemble_matrix(a, bcs, 1.0))
        ksp.setType("preonly")
        ksp.getPC().setType("lu")
        u, b = fem.Function(self.V), ksp.getOperators()[0].createVecLeft()
        b.array_w[:] = compat.assemble_load(fem.form(L), a, bcs, compat.prescribed(self.V, bcs), [])
        x = b.duplicate()
        ksp.solve(b, x)
        u.x.array[: len(x.array_r)] = x.array_r
        return u

    def work(self, u):
        """Of a weight of 1 [force length]."""
        value = fem.assemble_scalar(fem.form(-u[1] * ufl.dx))
        return self.domain.comm.allreduce(value)

    def _drawn(self, x):
        """Points (3, n) before they were turned."""
        return self.R.T @ x[: self.gdim]

    def stress_error(self, u, stress):
        """Largest error of the stress over the largest."""
        off = np.abs(stresses(u) - stress).max(initial=0.0)
        return max(self.domain.comm.allgather(off)) / np.abs(stress).max()


def _component(V, k, dofs):
    return (dofs * V.mesh.geometry.dim + k).astype(np.int32)


def _midpoints(domain, dim, entities):
    return mesh.compute_midpoints(domain, dim, entities.astype(np.int32))


def stresses(u):
    """(cells, points, gdim, gdim) at points of quadrature."""
    domain = u.function_space.mesh
    points = compat.quadrature_points(domain, 2)
    return compat.evaluate(hooke(u), points, domain, (domain.geometry.dim,) * 2)


def hooke(u):
    mu, lam = E / (2 * (1 + NU)), E * NU / (1 + NU) / (1 - 2 * NU)
    eps = ufl.sym(ufl.grad(u))
    return 2 * mu * eps + lam * ufl.tr(eps) * ufl.Identity(len(u))


def unit_stresses(gdim):
    """The three or six constant stresses."""
    out = []
    for i in range(gdim):
        for j in range(i + 1):
            s = np.zeros((gdim, gdim))
            s[i, j] = s[j, i] = 1.0
            out.append(s)
    return out
