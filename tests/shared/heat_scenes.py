"""Two blocks of unlike materials that conduct heat into each other, with a known temperature."""

import bent_rings
import numpy as np
import pairs
import ufl
from contact_scenes import ABOVE, BELOW, rectangle
from dolfinx import fem, mesh

import dolfinx_llm as llm
from dolfinx_llm import compat

K, FLUX, ALONG = (2.0, 0.3), 1.7, (0.4, -0.7)  # conductivities; upwards; gradient along the surface
THROUGH = np.array([1.1, -0.7])  # flux through the interfaces of a cross
KINDS = {2: ("quadrilateral", "triangle"), 3: ("hexahedron", "tetrahedron")}


def blocks(comm, gdim, n=None, narrow=0.0):
    """(mesh, tags) of a lower and an upper block that meet at height 1, where their meshes do not
    match; the upper one ends that much from the lower one's sides."""
    rng, found = np.random.default_rng(2001), []
    for i, (kind, k) in enumerate(zip(KINDS[gdim], n or {2: (4, 7), 3: (3, 4)}[gdim], strict=True)):
        low, high = np.full(gdim, i * narrow), np.full(gdim, 1.0 - i * narrow)
        low[-1], high[-1] = i, i + 1
        if gdim == 2:
            found.append(rectangle(comm, (k, 2), low, high, kind, 0.2, rng))
        else:
            found.append(pairs.block(comm, (k, k, 2), low, high, kind, jitter=0.2, rng=rng))
    return found


class Linear:
    """300 + a·x - q (z - 1) / k, less a jump that grows along the surface."""

    def __init__(self, gdim, jump=0.0, slope=0.0):
        self.a = [np.array(ALONG[: gdim - 1]), np.array(ALONG[: gdim - 1])]
        self.a[1][0] -= slope
        self.jump, self.slope = jump, slope

    def __call__(self, i, p):
        """Temperature of body i at coordinates p (gdim or more, n)."""
        z = p[len(self.a[i])] - 1.0
        return 300.0 + self.a[i] @ p[: len(self.a[i])] - FLUX / K[i] * z - i * self.jump

    def conductance(self, x):
        """(k,) at positions x (k, gdim), with which that is so."""
        return FLUX / (self.jump + self.slope * x[:, 0])

    def flux(self, i, domain):
        """Flux of body i, a UFL vector."""
        return fem.Constant(domain, np.array([*(-K[i] * self.a[i]), FLUX]))


class Quadratic:
    """x² + q x (z - 1) / k: the flux across the interface is linear along it."""

    def __call__(self, i, p):
        return p[0] ** 2 - FLUX / K[i] * p[0] * (p[1] - 1.0)

    def flux(self, i, domain):
        x = ufl.SpatialCoordinate(domain)
        return ufl.as_vector([-2.0 * K[i] * x[0] + FLUX * (x[1] - 1.0), FLUX * x[0]])


class Ends:
    """1 at the bottom and 0 at the top; all else is insulated."""

    def __call__(self, i, p):
        return 1.0 - 0.5 * p[1]

    flux = None


class Conducting:
    """The temperature is prescribed at bottom and top, its flux at all other sides.

    Args:
        bodies: of ``blocks``.
        law: of the interface.
        field: the temperature.
        sides: it is prescribed there as well, at the interface's rim on both sides.
        held: which bodies' temperatures are prescribed.
        degree: of the function spaces.
        order: of the interface's sides.
        chosen: for the problem.
    """

    def __init__(
        self, bodies, law, field, sides=False, degree=1, order=(0, 1), held=(0, 1), **chosen
    ):
        self.spaces = [compat.function_space(d, degree=degree) for d, _ in bodies]
        forms, loads, bcs, last = [], [], [], bodies[0][0].geometry.dim - 1
        self.field, self.sources = field, []  # heat per volume of each body, beside the field's
        for i, V in enumerate(self.spaces):
            u, v, n = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.FacetNormal(V.mesh)
            k = fem.Constant(V.mesh, K[i])
            forms.append(k * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
            dx = ufl.Measure("dx", domain=V.mesh)
            self.sources.append(fem.Constant(V.mesh, 0.0))
            loads.append(self.sources[i] * v * dx)
            if field.flux is not None:
                flux = field.flux(i, V.mesh)
                along = ufl.as_vector([*[flux[k] for k in range(last)], 0.0])
                loads[i] += ufl.div(flux) * v * dx - ufl.inner(along, n) * v * ufl.ds

            def where(p, end=2.0 * i):
                edge = np.isclose(p[last], end)
                if sides:
                    edge |= (np.isclose(p[:last], 0.0) | np.isclose(p[:last], 1.0)).any(axis=0)
                return edge

            value = fem.Function(V)
            value.interpolate(lambda p, i=i: field(i, p))
            if i in held:
                bcs.append(fem.dirichletbc(value, fem.locate_dofs_geometrical(V, where)))
        tags = (bodies[0][1], ABOVE), (bodies[1][1], BELOW)
        self.interface = llm.Interface(None, tuple(tags[i] for i in order), law=law)
        self.forms, self.loads = forms, loads
        self.problem = llm.ContactProblem(
            forms, loads, bcs=bcs, interfaces=self.interface, **chosen
        )
        self.bcs = bcs

    def error(self):
        """Largest error of the temperature, over the largest value."""
        worst, size = 0.0, 0.0
        for i, u in enumerate(self.problem.u):
            known = fem.Function(u.function_space)
            known.interpolate(lambda p, i=i: self.field(i, p))
            worst = max(worst, np.abs(u.x.array - known.x.array).max(initial=0.0))
            size = max(size, np.abs(known.x.array).max(initial=0.0))
        comm = self.problem.comm
        return max(comm.allgather(worst)) / max(comm.allgather(size))


def cross(comm, law, h, degree, solver):
    """Four blocks of one material round (1, 1), whose meshes do not match, and an interface of
    conductance h between each two: the problem, interfaces along y first, and temperatures by
    coordinates (3, n)."""
    forms, loads, bcs, tags, known = [], [], [], {}, []
    for n, kind, at in zip((3, 4, 5, 3), 2 * KINDS[2], ((0, 0), (1, 0), (0, 1), (1, 1))):
        low = np.array(at, dtype=float)
        block = mesh.create_rectangle(comm, [low, low + 1], [n, n], getattr(mesh.CellType, kind))
        edges = [mesh.locate_entities_boundary(block, 1, lambda p, k=k: np.isclose(p[k], 1.0))
                 for k in (0, 1)]  # fmt: skip
        facets, values = np.concatenate(edges), np.repeat([1, 2], [len(edge) for edge in edges])
        order = np.argsort(facets)
        tags[at] = mesh.meshtags(block, 1, facets[order], values[order].astype(np.int32))
        V = compat.function_space(block, degree=degree)
        u, v, value = ufl.TrialFunction(V), ufl.TestFunction(V), fem.Function(V)
        forms.append(fem.Constant(block, K[0]) * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        loads.append(fem.Constant(block, 0.0) * v * ufl.dx)
        known.append(lambda p, low=low: -THROUGH @ p[:2] / K[0] - THROUGH @ low / h)
        value.interpolate(known[-1])
        ends = fem.locate_dofs_geometrical(
            V, lambda p, low=low: np.isclose(p[:2], 2.0 * low[:, None]).any(axis=0)
        )
        bcs.append(fem.dirichletbc(value, ends))
    sides = [(((0, k), 1), ((1, k), 1)) for k in (0, 1)] + [
        (((k, 0), 2), ((k, 1), 2)) for k in (0, 1)
    ]
    interfaces = [
        llm.Interface(None, tuple((tags[at], tag) for at, tag in pair), law=law) for pair in sides
    ]
    return llm.ContactProblem(forms, loads, bcs=bcs, interfaces=interfaces, solver=solver), known


def tubes(n, h):
    """Of a tube in a tube of second order, n and 3 n / 2 cells around: relative errors of the heat
    that flows in all, and of the flux at the frame's nodes."""
    parts = [bent_rings.ring(n, 1.0, 2.0, 0.0), bent_rings.ring(n * 3 // 2, 2.0, 3.0, 0.1)]
    forms, loads, bcs = [], [], []
    for k, (domain, tags), held, warm in zip(K, parts, (1, 2), (1.0, 0.0), strict=True):
        V = compat.function_space(domain, degree=2)
        u, v, value = ufl.TrialFunction(V), ufl.TestFunction(V), fem.Function(V)
        value.x.array[:] = warm
        forms.append(k * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
        loads.append(fem.Constant(domain, 0.0) * v * ufl.dx)
        dofs = fem.locate_dofs_topological(V, 1, tags.find(held))
        bcs.append(fem.dirichletbc(value, dofs))
    sides = tuple((tags, tag) for (_, tags), tag in zip(parts, (2, 1), strict=True))
    interface = llm.Interface(None, sides, law=llm.Conductance(h))
    problem = llm.ContactProblem(forms, loads, bcs=bcs, interfaces=interface)
    problem.solve()
    heat = 1.0 / (np.log(2.0) / K[0] + 0.5 / h + np.log(1.5) / K[1])  # per angle
    result = problem.results[0]
    total = abs(result.resultant[0] / (2.0 * np.pi * heat) - 1.0)
    return total, np.abs(result.flux / (0.5 * heat) - 1.0).max()
