"""Two cylinders on each other in their half sections, r = x[0] and z = x[1]: forms over 2 pi r."""

import gmsh
import numpy as np
import ufl
from dolfinx import fem, mesh
from scipy.optimize import fsolve

import dolfinx_llm as llm
from dolfinx_llm import compat

LOWER, UPPER, TOP = 2, 11, 12  # facet tags
OUTER = 13  # the mantle of either


def around(x):
    """Thickness at positions (n, 2)."""
    return 2.0 * np.pi * x[:, 0]


def lame(E, nu):
    return E / (2.0 * (1.0 + nu)), E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))


def gradient(u, r):
    """(3, 3) of a displacement in the section."""
    g = ufl.grad(u)
    return ufl.as_tensor([[g[0, 0], g[0, 1], 0], [g[1, 0], g[1, 1], 0], [0, 0, u[0] / r]])


def block(comm, n, low, high, tags, cell="quadrilateral", degree=1):
    """Space and facet tags of a block: bottom, top, mantle."""
    domain = mesh.create_rectangle(
        comm, [np.array(low), np.array(high)], [n, n], getattr(mesh.CellType, cell)
    )
    at = [(1, low[1]), (1, high[1]), (0, high[0])]
    found = [
        mesh.locate_entities_boundary(domain, 1, lambda x, k=k, c=c: np.isclose(x[k], c))
        for k, c in at
    ]
    facets = np.concatenate(found)
    values = np.concatenate([np.full(len(f), t, dtype=np.int32) for f, t in zip(found, tags)])
    facets, first = np.unique(facets, return_index=True)
    own = mesh.meshtags(domain, 1, facets, values[first])
    return compat.function_space(domain, degree=degree, shape=(2,)), own


def held(V, k, where):
    Vk, _ = V.sub(k).collapse()
    dofs = fem.locate_dofs_geometrical((V.sub(k), Vk), where)
    return fem.dirichletbc(fem.Function(Vk), dofs, V.sub(k))


class Cylinders:
    """The lower one of radius 1, the upper one of another, about a bore or none; both 1 high.

    Attributes:
        spaces, tags, bcs: of the lower one and the upper one.
    """

    def __init__(self, comm, n, upper=1.0, bore=0.0, cell="quadrilateral", degree=1):
        ends = ((bore, 0.0), (1.0 + bore, 1.0)), ((bore, 1.0), (bore + upper, 2.0))
        of = (1, LOWER, OUTER), (UPPER, TOP, OUTER)
        built = [block(comm, m, *e, t, cell, degree) for m, e, t in zip(n, ends, of, strict=True)]
        self.spaces, self.tags = zip(*built, strict=True)
        self.bcs = [held(self.spaces[0], 1, lambda x: np.isclose(x[1], 0.0))]
        if not bore:
            self.bcs += [held(V, 0, lambda x: np.isclose(x[0], 0.0)) for V in self.spaces]

    def interface(self, law, thickness=around):
        sides = (self.tags[0], LOWER), (self.tags[1], UPPER)
        return llm.Interface(None, sides, law=law, thickness=thickness)

    def off(self, u, stretch):
        """Largest error of displacements against stretches along r and z."""
        most = 0.0
        for v in u:
            x = v.function_space.tabulate_dof_coordinates()[:, :2]
            exact = x * (np.array(stretch) - 1.0)
            most = max(most, np.abs(v.x.array.reshape(-1, 2) - exact).max())
        return self.spaces[0].mesh.comm.allreduce(most, op=max)

    def linear(self, law, p=1.0, E=1000.0, nu=0.3, thickness=around, more=(), **options):
        """Pressed by p on all that looks up and is free, with ``more`` interfaces; and the
        stretches then."""
        mu, lam = lame(E, nu)
        forms, loads = [], []
        for V, tags, tag in zip(self.spaces, self.tags, (None, TOP), strict=True):
            r = ufl.SpatialCoordinate(V.mesh)[0]
            e, d = (ufl.sym(gradient(f(V), r)) for f in (ufl.TrialFunction, ufl.TestFunction))
            sigma = 2 * mu * e + lam * ufl.tr(e) * ufl.Identity(3)
            ds = ufl.Measure("ds", domain=V.mesh, subdomain_data=tags)
            forms.append(ufl.inner(sigma, d) * 2 * np.pi * r * ufl.dx(degree=6))
            q = fem.Constant(V.mesh, p if tag else 0.0)
            weight = -q * 2 * np.pi * r
            loads.append(weight * ufl.TestFunction(V)[1] * ds(tag or LOWER, degree=6))
        on = self.tags[0], LOWER, p, (self.spaces[1], self.tags[1], UPPER)
        free = [llm.free_surface_load(self.spaces[0], *on, thickness=thickness)]
        problem = llm.ContactProblem(
            forms, loads, bcs=self.bcs, interfaces=[self.interface(law, thickness), *more],
            nodal_loads=free, **options,
        )  # fmt: skip
        return problem, (1.0 + nu * p / E, 1.0 - p / E)

    def finite(self, law, q=300.0, E=1000.0, nu=0.4, thickness=around, **options):
        """The same at finite deformation, W = mu/2 (I1 - 3) - mu ln J + lambda/2 ln² J; ``load`` is
        a list of Constants of the pressure, still 0."""
        mu, lam = lame(E, nu)
        forms, u = [], [fem.Function(V) for V in self.spaces]
        for w in u:
            V = w.function_space
            r = ufl.SpatialCoordinate(V.mesh)[0]
            F = ufl.Identity(3) + gradient(w, r)
            J = ufl.det(F)
            W = mu / 2 * (ufl.tr(F.T * F) - 3) - mu * ufl.ln(J) + lam / 2 * ufl.ln(J) ** 2
            form = W * 2 * np.pi * r * ufl.dx(degree=6)
            forms.append(ufl.derivative(form, w, ufl.TestFunction(V)))
        self.load = [fem.Constant(V.mesh, 0.0) for V in self.spaces]
        covered = {"covered_by": (self.tags[1], UPPER), "thickness": thickness}
        loads = [
            llm.FreeSurfacePressure(self.tags[0], LOWER, self.load[0], **covered),
            llm.FreeSurfacePressure(self.tags[1], TOP, self.load[1], thickness=thickness),
        ]
        problem = llm.NonlinearContactProblem(
            forms, u, bcs=self.bcs, interfaces=[self.interface(law, thickness)], loads=loads,
            **options,
        )  # fmt: skip

        def stresses(s):
            a, c = s
            log = lam * np.log(a * a * c)
            return mu * (a * a - 1) + log, (mu * (c * c - 1) + log) / (a * a * c) + q

        return problem, fsolve(stresses, [1.1, 0.8], xtol=1e-14)


def shell(comm, inner, outer, size, order):
    """Space and facet tags, 1 inside and 2 outside, of the quarter of a shell, or of a ball."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ = gmsh.model.occ
    tools = [(2, occ.addRectangle(-3, -3, 0, *sides)) for sides in ((3, 6), (6, 3))]
    tools += [(2, occ.addDisk(0, 0, 0, inner, inner))] if inner else []
    left, _ = occ.cut([(2, occ.addDisk(0, 0, 0, outer, outer))], tools)
    occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [tag for _, tag in left], 9)
    for dim, curve in gmsh.model.getEntities(1):
        low, high = (end[0] for end in gmsh.model.getParametrizationBounds(dim, curve))
        far = np.linalg.norm(gmsh.model.getValue(dim, curve, [0.5 * (low + high)]))
        for tag, radius in ((1, inner), (2, outer)):
            if radius and abs(far - radius) < 1e-6:
                gmsh.model.addPhysicalGroup(1, [curve], tag)
    for name in ("Min", "Max"):
        gmsh.option.setNumber(f"Mesh.MeshSize{name}", size)
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.setOrder(order)
    domain, _, tags = compat.model_to_mesh(gmsh.model, comm, 0, gdim=2)
    gmsh.finalize()
    return compat.function_space(domain, degree=order, shape=(2,)), tags


def ball_in_shell(comm, sizes, law, order=1, E=1000.0, nu=0.3):
    """A ball in a shell of the same material under a pressure of 1: all is pressed evenly. Errors
    of the displacement, over the largest, and of the contact pressure."""
    mu, lam = lame(E, nu)
    built = [shell(comm, *ends, h, order) for ends, h in zip(((0, 1), (1, 2)), sizes, strict=True)]
    forms, loads, bcs = [], [], []
    for (V, tags), p in zip(built, (0.0, 1.0), strict=True):
        r = ufl.SpatialCoordinate(V.mesh)[0]
        e, d = (ufl.sym(gradient(f(V), r)) for f in (ufl.TrialFunction, ufl.TestFunction))
        sigma = 2 * mu * e + lam * ufl.tr(e) * ufl.Identity(3)
        forms.append(ufl.inner(sigma, d) * 2 * np.pi * r * ufl.dx(degree=6))
        ds = ufl.Measure("ds", domain=V.mesh, subdomain_data=tags)
        out = ufl.inner(ufl.FacetNormal(V.mesh), ufl.TestFunction(V))
        loads.append(-fem.Constant(V.mesh, p) * out * 2 * np.pi * r * ds(2, degree=6))
        bcs += [held(V, k, lambda x, k=k: np.isclose(x[k], 0.0)) for k in (0, 1)]
    sides = (built[0][1], 2), (built[1][1], 1)
    interface = llm.Interface(None, sides, law=law, thickness=around)
    with llm.ContactProblem(forms, loads, bcs=bcs, interfaces=[interface]) as problem:
        u, shrinks = problem.solve(), -(1.0 - 2.0 * nu) / E
        off = [v.x.array - shrinks * v.function_space.tabulate_dof_coordinates()[:, :2].ravel()
               for v in u]  # fmt: skip
        most = max(np.abs(a).max() for a in off) / (2.0 * abs(shrinks))
        return most, np.abs(problem.results[0].pressure - 1.0).max()
