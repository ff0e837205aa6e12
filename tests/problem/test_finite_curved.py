"""Curved surfaces of first order at finite deformation, against known pressures."""

import bent_rings
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat


class Lame:
    """A ring in a ring of first order, alike, pressed from inside by what moves its inner circle;
    the outer circle moves as in one piece. Or quarters of them, or of tubes, in plane strain."""

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

    def problem(self, meshes, law):
        F, us, bcs = [], [], []
        for (domain, tags), tag in zip(meshes, (1, 6), strict=True):
            gdim = domain.geometry.dim
            V = compat.function_space(domain, shape=(gdim,))
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
                bcs.append(fem.dirichletbc(0.0, dofs, V.sub(i)))
        sides = (meshes[0][1], 2), (meshes[1][1], 5)
        interfaces = [llm.Interface(None, sides, law=law)]
        return llm.NonlinearContactProblem(F, us, bcs=bcs, interfaces=interfaces)


@pytest.mark.parametrize("law", [llm.Frictionless(), llm.Coulomb(0.3)], ids=str)
@pytest.mark.parametrize(("counts", "most"), [
    ((16, 24), 0.06), ((32, 48), 0.02), longer((64, 96), 0.006),
])  # fmt: skip
def test_pressed_rings(counts, most, law):
    """Gaps are to the curved frame, not to where designed rows have it: pressures at nodes were off
    by 40 to 50 %, on all meshes."""
    parts = zip(counts, Lame.RADII[:-1], Lame.RADII[1:], (0.0, 0.13), (1, 5), strict=True)
    check_pressure([bent_rings.ring(n, *radii, 1, tag) for n, *radii, tag in parts], law, most)


@pytest.mark.parametrize(("kind", "sizes", "most"), [
    ("quad", (0.2, 0.13), 0.02),
    ("hex", (0.3, 0.2), 0.02), longer("hex", (0.12, 0.09), 0.01),
    ("tet", (0.2, 0.13), 0.45), longer("tet", (0.1, 0.065), 0.35),
])  # fmt: skip
def test_pressed_quarters(kind, sizes, most):
    """Up to where a surface ends, beyond which facets have no neighbours to tell their normals:
    there pressures were off by 12 to 44 %; on tetrahedra, whose own stresses are rough, by 100 to
    320 %."""
    parts = zip(sizes, Lame.RADII[:-1], Lame.RADII[1:], (1, 5), strict=True)
    make = bent_rings.shell if kind == "tet" else bent_rings.bricks
    more = {"gdim": 2} if kind == "quad" else {}
    meshes = [make(h, *radii, tag, order=1, **more) for h, *radii, tag in parts]
    check_pressure(meshes, llm.Frictionless(), most)


def check_pressure(meshes, law, most):
    exact = Lame()
    problem = exact.problem(meshes, law)
    problem.solve()
    (result,), p = problem.results, exact.pressure(1.5)
    assert np.abs(result.pressure - p).max() <= most * p
    assert len(problem.history) <= 4
