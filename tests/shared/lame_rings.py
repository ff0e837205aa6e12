"""Pressed rings and tubes of first order, whose pressures are known."""

import bent_rings
import numpy as np
import ufl
from dolfinx import fem, mesh

import dolfinx_llm as llm
from dolfinx_llm import compat


class Lame:
    """A ring in a ring of first order, alike, pressed from inside by what moves its inner circle;
    the outer circle moves as in one piece. Or quarters of them, or of tubes, in plane strain."""

    degree = 1
    along = 0.0  # displacement of the outer body's ends along the tubes
    E, NU, PRESSURE, RADII = 1.0, 0.3, 1e-2, (1.0, 1.5, 2.0)

    def __init__(self):
        self.lam = self.E * self.NU / (1 + self.NU) / (1 - 2 * self.NU)
        self.mu, (low, _, high) = self.E / 2 / (1 + self.NU), self.RADII
        bulk = 2 * (self.lam + self.mu)
        rows = [[bulk, -2 * self.mu / r**2] for r in (low, high)]
        self.bulk, self.c = bulk, np.linalg.solve(rows, [-self.PRESSURE, 0.0])

    def radial(self, r):
        return self.c[0] * r + self.c[1] / r

    def pressure(self, r):
        return 2 * self.mu * self.c[1] / r**2 - self.bulk * self.c[0]

    def displacement(self, x):
        r = np.hypot(*x[:2])
        return np.concatenate([x[:2] / r * self.radial(r), 0.0 * x[2:]])

    def given(self, meshes):
        """Forms, displacements, conditions, and the sides of an interface."""
        F, us, bcs = [], [], []
        for (domain, tags), tag in zip(meshes, (1, 6)):
            gdim = domain.geometry.dim
            V = compat.function_space(domain, degree=self.degree, shape=(gdim,))
            u, w, known = fem.Function(V), ufl.TestFunction(V), fem.Function(V)
            known.interpolate(lambda x, gdim=gdim: self.displacement(x)[:gdim])
            e = ufl.sym(ufl.grad(u))
            stress = self.lam * ufl.tr(e) * ufl.Identity(gdim) + 2 * self.mu * e
            F.append(ufl.inner(stress, ufl.grad(w)) * ufl.dx)
            us.append(u)
            dofs = fem.locate_dofs_topological(V, gdim - 1, tags.find(tag))
            bcs.append(fem.dirichletbc(known, dofs))
            for i, level in ((0, 0.0), (1, 0.0), (2, 0.0), (2, 1.0))[: 2 * gdim - 2]:
                on = lambda x, i=i, level=level: np.isclose(x[i], level)  # noqa: E731
                facets = mesh.locate_entities_boundary(domain, gdim - 1, on)
                dofs = fem.locate_dofs_topological(V.sub(i), gdim - 1, facets)
                value = self.along if (tag, i) == (6, 2) else 0.0
                bcs.append(fem.dirichletbc(value, dofs, V.sub(i)))
        return F, us, bcs, ((meshes[0][1], 2), (meshes[-1][1], 5))

    def nonlinear(self, meshes, law, obstacle=None):
        F, us, bcs, sides = self.given(meshes)
        interfaces = [llm.Interface(None, (sides[0], obstacle or sides[1]), law=law)]
        return llm.NonlinearContactProblem(F, us, bcs=bcs, interfaces=interfaces)

    def linear(self, meshes, law, solver, obstacle=None, **more):
        F, us, bcs, sides = self.given(meshes)
        tests = [
            (ufl.TrialFunction(u.function_space), ufl.TestFunction(u.function_space)) for u in us
        ]
        a = [ufl.replace(f, {u: v}) for f, u, (v, _) in zip(F, us, tests, strict=True)]
        L = [
            ufl.inner(fem.Function(u.function_space), w) * ufl.dx
            for u, (_, w) in zip(us, tests, strict=True)
        ]
        sides = sides[0], obstacle or sides[1]
        interfaces = [llm.Interface(None, sides, law=law, **more)]
        return llm.ContactProblem(a, L, bcs=bcs, interfaces=interfaces, solver=solver)


class Mixed(Lame):
    """Bodies of such orders, the inner one's first."""

    def __init__(self, orders):
        super().__init__()
        self.orders = list(orders)

    @property
    def degree(self):
        return self.orders.pop(0)


def quarters(kind, sizes, order=1):
    """Meshes of an order, or of one each, of quarters of rings ("quad") or tubes, of cells of these
    sizes."""
    orders = order if isinstance(order, tuple) else (order, order)
    parts = zip(sizes, Lame.RADII[:-1], Lame.RADII[1:], (1, 5), orders, strict=True)
    make = bent_rings.shell if kind == "tet" else bent_rings.bricks
    more = {"gdim": 2} if kind == "quad" else {}
    return [make(h, *radii, tag, order=n, **more) for h, *radii, tag, n in parts]
