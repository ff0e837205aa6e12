"""One tag for several bodies: two feet on a plate, at any distance of each other."""

import numpy as np
import pytest
import ufl
import wall_scenes as walls
from dolfinx import fem, mesh
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM = MPI.COMM_SELF
PLATE, FEET, TOP = 3, 7, 5


class Feet:
    """Two feet of height 1/2 on a plate of width 3 and n cells, ``gap`` facets of it apart, under a
    pressure of 1 on all that faces up."""

    def __init__(self, gdim, gap, n, cells=(2, 3), kind=None, comm=COMM, order=1):
        x = 0.37 + np.array([0.0, 1.0, 1.0 + 3.0 * gap / n, 2.0 + 3.0 * gap / n])
        low = np.array([[0.0, 0.0], [x[0], 1.0], [x[2], 1.0]])
        high = np.array([[3.0, 1.0], [x[1], 1.5], [x[3], 1.5]])
        counts = np.array([[n, 3], [cells[0], 2], [cells[1], 2]])
        if gdim == 3:
            low, high = (np.insert(a, 1, b, axis=1) for a, b in ((low, 0.0), (high, 1.0)))
            low[1:, 1], high[1:, 1] = 0.1, 0.8
            counts = np.insert(counts, 1, [4, cells[0], cells[1]], axis=1)
        kind = kind or ("quadrilateral", "hexahedron")[gdim - 2]
        points, made, first = [], [], 0
        for a, b, k in zip(low, high, counts, strict=True):
            p, c = walls.bricks(a, b, k, kind, first)
            points, made, first = [*points, p], [*made, c], first + len(p)
        p, c = (np.concatenate(a)[: None if comm.rank == 0 else 0] for a in (points, made))
        self.domain = domain = compat.create_mesh(comm, c, p, kind)
        self.V = compat.function_space(domain, degree=order, shape=(gdim,))
        self.gdim, up = gdim, gdim - 1
        domain.topology.create_connectivity(up, gdim)
        above = mesh.locate_entities_boundary(domain, up, lambda q: q[up] > 1.5 - 1e-9)
        at = mesh.locate_entities_boundary(domain, up, lambda q: np.abs(q[up] - 1.0) < 1e-9)
        to_cell = domain.topology.connectivity(up, gdim)
        cell = to_cell.array[to_cell.offsets[at]]
        plate = mesh.compute_midpoints(domain, gdim, cell)[:, up] < 1.0
        facets = np.concatenate([above, at])
        values = np.concatenate([np.full(len(above), TOP), np.where(plate, PLATE, FEET)])
        order = np.argsort(facets)
        self.tags = mesh.meshtags(domain, up, facets[order], values[order].astype(np.int32))
        # Plane strain in 2D.
        across = walls.NU * (1.0 + walls.NU * (gdim == 2)) / walls.E
        along = -(1.0 - walls.NU**2 * (gdim == 2)) / walls.E
        self.exact = np.append(np.full(up, across), along)

    def problem(self, law, swap=False):
        V, up = self.V, self.gdim - 1
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        ds = ufl.Measure("ds", self.domain, subdomain_data=self.tags)
        L = -fem.Constant(self.domain, 1.0) * w[up] * ds(TOP)
        sides = (FEET, PLATE) if swap else (PLATE, FEET)
        load = llm.free_surface_load(V, self.tags, PLATE, 1.0, covered_by=(self.tags, FEET))
        return llm.ContactProblem(
            ufl.inner(walls.hooke(u), ufl.grad(w)) * ufl.dx, L, bcs=self.supports(),
            nodal_loads=[load], interfaces=llm.Interface(self.tags, sides, law=law),
        )  # fmt: skip

    def supports(self):
        """All components at base and tops: any law, any shape of the feet."""
        exact, up = fem.Function(self.V), self.gdim - 1
        exact.interpolate(lambda q: self.exact[:, None] * q[: self.gdim])
        dofs = fem.locate_dofs_geometrical(self.V, lambda q: q[up] < 1e-9)
        bcs = [fem.dirichletbc(exact, dofs)]
        for k in range(up):  # feet are held along the plate at their tops
            own, _ = self.V.sub(k).collapse()
            value = fem.Function(own)
            value.interpolate(lambda q, k=k: self.exact[k] * q[k])
            dofs = fem.locate_dofs_geometrical((self.V.sub(k), own), lambda q: q[up] > 1.5 - 1e-9)
            bcs.append(fem.dirichletbc(value, dofs, self.V.sub(k)))
        return bcs

    def stress_error(self, u):
        return np.abs(walls.stresses(u) + np.diag(np.eye(self.gdim)[-1])).max()


LAWS = [llm.Tied(), llm.Frictionless(), llm.Coulomb(0.3)]


@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize(
    ("gap", "n"), [(0.3, 12), *map(longer, (0.0, 0.1, 0.6, 1.0, 1.5, 0.3), (12,) * 5 + (5,))]
)
def test_two_feet_in_2d(law, gap, n):
    """Pressed by a constant pressure, with less than a facet of the plate between them."""
    feet = Feet(2, gap, n)
    with feet.problem(law) as problem:
        assert feet.stress_error(problem.solve()) <= 1e-11
        assert np.abs(problem.results[0].pressure - 1.0).max() <= 1e-10
        total = problem.results[0].resultant
        assert np.abs(np.abs(total) - [0.0, 2.0]).max() <= 1e-10


@pytest.mark.parametrize(
    ("law", "gap", "kind"),
    [
        (llm.Frictionless(), 0.4, "hexahedron"),
        longer(llm.Tied(), 0.4, "hexahedron"),
        longer(llm.Coulomb(0.3), 0.7, "hexahedron"),
        longer(llm.Frictionless(), 0.0, "hexahedron"),
        longer(llm.Tied(), 0.7, "tetrahedron"),
        longer(llm.Frictionless(), 0.2, "tetrahedron"),
    ],
)
def test_two_feet_in_3d(law, gap, kind):
    feet = Feet(3, gap, 7, cells=(2, 3), kind=kind)
    with feet.problem(law, swap=True) as problem:
        assert feet.stress_error(problem.solve()) <= 1e-11


@pytest.mark.parametrize(
    ("law", "order", "gap"),
    [
        (LAWS[2], 1, 0.4),
        longer(LAWS[0], 1, 0.4),
        longer(LAWS[1], 1, 0.4),
        (LAWS[2], 2, 2.0),
        (LAWS[1], 2, 2.0),
        (LAWS[2], 2, 0.4),
        (LAWS[1], 2, 0.4),
        longer(LAWS[0], 2, 0.4),
    ],
)
def test_one_tag_is_as_good_as_two(law, order, gap):
    """Feet that are pulled and pushed: an interface of both, and one for each. Of second order the
    finer side carried the frames of all feet but the first, in the order in which they came, and
    feet on the same facet ended in an error of SciPy's."""
    feet, found = Feet(2, gap, 12, order=order), []
    a = ufl.inner(walls.hooke(ufl.TrialFunction(feet.V)), ufl.grad(ufl.TestFunction(feet.V)))
    x, w = ufl.SpatialCoordinate(feet.domain), ufl.TestFunction(feet.V)
    L = ufl.inner(ufl.as_vector((0.1 * x[1], -1.0 - x[0])), w) * ufl.dx
    one = [llm.Interface(feet.tags, (PLATE, FEET), law=law)]
    for interfaces in (one, llm.find_interfaces(feet.tags, feet.V, law=law)):
        with llm.ContactProblem(
            a * ufl.dx, L, bcs=feet.supports(), interfaces=interfaces
        ) as problem:
            found.append(problem.solve().x.array.copy())
            found.append(sum(result.resultant for result in problem.results))
    assert np.abs(found[0] - found[2]).max() <= 1e-9 * np.abs(found[0]).max()
    assert np.abs(np.abs(found[1]) - np.abs(found[3])).max() <= 1e-9 * np.abs(found[1]).max()
