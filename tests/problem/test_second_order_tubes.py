"""Short closed tubes of second order, pressed to one side until they part on the other."""

import bent_rings
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

NU = 0.3
PARTS = ((1.0, 1.5, 0.0, 2, 1), (1.5, 2.0, 0.13, 2, 5))


class Tubes:
    """A tube in a tube, or a ring in a ring, whose inner circle is moved along a direction and
    pressed, with the outer one held, in plane strain or with free ends; lobes on the inner one are
    drawn with a gap, or both overlap. All in units of length and of stress."""

    def __init__(self, counts, layers, motion, law, hexahedra=True, height=1.0, held=True,
                 press=0.0, gap=0.0, overlap=0.0):  # fmt: skip
        parts = PARTS[0], (PARTS[1][0] - overlap, *PARTS[1][1:])
        every = zip(counts, parts, layers or (0, 0), strict=True)
        meshes = [bent_rings.ring(n, *part, k, height, hexahedra) for n, part, k in every]
        self.gdim, self.height = 3 if layers else 2, height if layers else 1.0
        x = meshes[0][0].geometry.x
        r, angle = np.hypot(x[:, 0], x[:, 1]), np.arctan2(x[:, 1], x[:, 0])
        x[:, :2] *= (1.0 - gap * (1.0 - np.cos(3.0 * angle)) * (r - 1.0) / r)[:, None]
        self.spaces = [
            compat.function_space(domain, degree=2, shape=(self.gdim,)) for domain, _ in meshes
        ]
        known = [fem.Function(V) for V in self.spaces]
        along = np.array([*motion, 0.0])[: self.gdim, None]
        known[0].interpolate(
            lambda x: press * x[: self.gdim] * [[1], [1], [0]][: self.gdim] + along
        )
        self.bcs = []
        for u, (_, tags), tag in zip(known, meshes, (1, 6), strict=True):
            V, levels = u.function_space, (0.0, height) if layers and held else ()
            dofs = fem.locate_dofs_topological(V, self.gdim - 1, tags.find(tag))
            self.bcs.append(fem.dirichletbc(u, dofs))
            for level in levels:
                at = lambda x, level=level: np.isclose(x[2], level)  # noqa: E731
                facets = mesh.locate_entities_boundary(V.mesh, 2, at)
                dofs = fem.locate_dofs_topological(V.sub(2), 2, facets)
                self.bcs.append(fem.dirichletbc(0.0, dofs, V.sub(2)))
        sides = ((meshes[0][1], 2), (meshes[1][1], 5))
        self.interfaces = [llm.Interface(None, sides, law=law)]

    def form(self, k, u):
        eps = ufl.sym(ufl.grad(u))
        stress = (eps + NU / (1 - 2 * NU) * ufl.tr(eps) * ufl.Identity(self.gdim)) / (1 + NU)
        return ufl.inner(stress, ufl.grad(ufl.TestFunction(self.spaces[k]))) * ufl.dx

    def posed(self, solver):
        a = [self.form(k, ufl.TrialFunction(V)) for k, V in enumerate(self.spaces)]
        L = [ufl.inner(fem.Function(V), ufl.TestFunction(V)) * ufl.dx for V in self.spaces]
        chosen = {"bcs": self.bcs, "interfaces": self.interfaces, "solver": solver}
        return llm.ContactProblem(a, L, **chosen)

    def linear(self, solver="saddle"):
        return self.solved(self.posed(solver))

    def nonlinear(self):
        us = [fem.Function(V) for V in self.spaces]
        F = [self.form(k, u) for k, u in enumerate(us)]
        chosen = {"bcs": self.bcs, "interfaces": self.interfaces}
        return self.solved(llm.NonlinearContactProblem(F, us, **chosen))

    def solved(self, problem):
        """Iterations, and per height the resultant's length and the sum of normal forces."""
        problem.solve()
        (result,) = problem.results
        forces = result.sides[0].normal_force.sum()
        found = np.array([np.linalg.norm(result.resultant), forces]) / self.height
        return len(problem.history), found


FREE, RUBS = llm.Frictionless(), llm.Coulomb(0.3)
LARGER = (8, (2, 3)), (16, (2, 3)), (20, (1, 2))


@pytest.mark.parametrize(("counts", "layers", "motion", "more", "most"), [
    longer((16, 24), (1, 2), (0.01, 0.0), {"height": 0.5}, 2e-3),
    longer((16, 24), (2, 3), (0.01, 0.0), {"hexahedra": True}, 2e-3),
    ((16, 24), (2, 3), (0.0, 0.003), {"hexahedra": False}, 2e-3),
    longer((16, 24), (2, 3), (0.002, 0.002), {"hexahedra": True}, 2e-3),
    longer((16, 24), (7, 10), (0.006, 0.008), {"height": 4.0}, 2e-3),
    longer((32, 48), (2, 3), (0.01, 0.0), {"height": 0.5}, 2e-3),
    longer((32, 48), (1, 2), (0.006, 0.008), {"height": 0.2}, 2e-3),
    longer((32, 48), (1, 2), (0.008, 0.006), {"height": 0.2, "press": 0.02, "gap": 0.05}, 7e-3),
])  # fmt: skip
def test_plane_strain(counts, layers, motion, more, most):
    """Forces of tubes are those of rings. Of tubes shorter than about twice their radius the design
    was singular: they failed in every increment."""
    drawn = {name: more[name] for name in ("press", "gap") if name in more}
    iterations, found = Tubes(counts, layers, motion, FREE, **more).nonlinear()
    known = Tubes(counts, None, motion, FREE, **drawn).nonlinear()[1]
    assert found == pytest.approx(known, rel=most)
    assert iterations <= 5


@pytest.mark.parametrize(
    ("counts", "layers"),
    [((8, 12), (1, 2)), *(longer((n, 3 * n // 2), layers) for n, layers in LARGER)],
)
def test_condensed(counts, layers):
    """The saddle form's forces, in its iterations of the law. Along the axis open pairs of ends
    that are held move by what rounding leaves of their rows at free dofs, and these were eliminated
    by it: forces were off by 1e-3, and contact did not come to rest. From 16:24 cells on multigrid
    was taken, by which pairs are foretold in the place of asked for: 10 iterations for 4."""
    tubes = Tubes(counts, layers, (0.01, 0.0), FREE, height=0.5 * layers[0])
    known, by = tubes.linear(), tubes.linear("condensed")
    assert by[1] == pytest.approx(known[1], rel=1e-8)
    assert by[0] == known[0]


@pytest.mark.parametrize("overlap", [0.003, 0.01])
def test_overlap_is_told_as_drawn(overlap):
    """To what facets leave of circles. Rows had corrections that lowered no residual, around tubes
    that are closed, and overlaps of 0.003 and 0.01 were 0.0042 and 0.0119 at places."""
    drawn = {"hexahedra": False, "held": False, "overlap": overlap}
    tubes = Tubes((16, 24), (2, 3), (0.0, 0.0), llm.Tied(close_gap=True), **drawn)
    for pairs, known in zip(tubes.posed("saddle").geometries[0].pairs, (0.0, overlap), strict=True):
        assert np.abs(np.einsum("ni,ni->n", pairs.gap, pairs.normal) - known).max() < 3e-4


def test_no_multigrid():
    """What is chosen: with 20:30 cells multigrid took 220 s, the factorised form 19."""
    tubes = Tubes((8, 12), (2, 3), (0.01, 0.0), FREE)
    assert "no multigrid: contact along curved surfaces" in str(tubes.posed("auto"))


@pytest.mark.long
@pytest.mark.parametrize("law", [FREE, RUBS], ids=str)
@pytest.mark.parametrize("hexahedra", [True, False])
@pytest.mark.parametrize(("held", "motion", "most"), [(True, 0.01, 0.015), (False, 0.003, 0.03)])
def test_finite_deformation_agrees(held, motion, most, hexahedra, law):
    """With the linear problem, also with ends that are free. Nodes of the moving side lie on edges
    of the frame, and did on one facet or the other as Newton's iteration came to rest: with
    friction it went to and fro."""
    tubes = Tubes((16, 24), (2, 3), (motion, 0.0), law, hexahedra, held=held)
    iterations, found = tubes.nonlinear()
    assert found[0] == pytest.approx(tubes.linear()[1][0], rel=most)
    assert iterations <= (4 if law is FREE else 16)
