"""Nodes in a corner, of two interfaces with friction: what one holds along itself the other holds
across, so that the same row is there twice, and what each bears is not unique."""

import finite_patch
import numpy as np
import pytest
from dolfinx import fem, mesh
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

MU = 0.3
FLOOR, WALL, REST = 1, 2, 3


class Body:
    """A square, its facets at x = low and y = low tagged, or what is left around a corner at 0;
    turned by R about 0. Its outer nodes are held."""

    def __init__(self, low, high, n, R, degree, held, corner=False):
        axes = [np.linspace(low, high, k + 1) for k in n]
        x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        node = np.arange(len(x)).reshape([k + 1 for k in n])
        cells = [node[i : n[0] + i, j : n[1] + j].ravel() for j in (0, 1) for i in (0, 1)]
        cells, at = np.stack(cells, axis=1), 0.0 if corner else low
        if corner:
            cells = cells[~(x[cells].mean(axis=1) > 0.0).all(axis=1)]
            used, cells = np.unique(cells, return_inverse=True)
            x, cells = x[used], cells.reshape(-1, 4)
        domain = compat.create_mesh(MPI.COMM_SELF, cells, x, "quadrilateral")
        facets = mesh.locate_entities_boundary(domain, 1, lambda x: np.full(x.shape[1], True))
        middle = mesh.compute_midpoints(domain, 1, facets)[:, :2]
        values = np.where(np.isclose(middle[:, 1], at), FLOOR, REST)
        values[np.isclose(middle[:, 0], at)] = WALL
        self.tags = mesh.meshtags(domain, 1, facets, values.astype(np.int32))
        V = compat.function_space(domain, degree=degree, shape=(2,))
        dofs = fem.locate_dofs_geometrical(V, held)
        domain.geometry.x[:, :2] = domain.geometry.x[:, :2] @ R.T
        self.u, self.end = fem.Function(V), fem.Constant(domain, np.zeros(2))
        self.bc = fem.dirichletbc(self.end, dofs, V)
        self.F = finite_patch.residual(self.u, *finite_patch.lame(1.0, 0.3), degree)


class Corner:
    """A block whose far half is moved into the corner of two planes, or of another body."""

    def __init__(self, rigid, angle=0.0, degree=1):
        c, s = np.cos(angle), np.sin(angle)
        self.R = np.array([[c, -s], [s, c]])
        low, high, n, far = (0.003, 1.0, (4, 5), 1.69) if rigid else (0.0, 0.8, (7, 8), 1.38)
        own = self.R, degree
        self.bodies = [Body(low, high, n, *own, lambda x: x[0] + x[1] > far)]
        if not rigid:
            below = lambda x: np.minimum(x[0], x[1]) < -0.59  # noqa: E731
            self.bodies.append(Body(-0.6, 1.2, (12, 12), *own, below, corner=True))
        tags = [b.tags for b in self.bodies]
        sides = [
            (tag, llm.RigidPlane((0.0, 0.0), self.R[:, 2 - tag]))
            if rigid
            else ((tags[0], tag), (tags[1], tag))
            for tag in (FLOOR, WALL)
        ]
        self.problem = llm.NonlinearContactProblem(
            [b.F for b in self.bodies],
            [b.u for b in self.bodies],
            bcs=[b.bc for b in self.bodies],
            interfaces=[llm.Interface(tags[0], pair, law=llm.Coulomb(MU)) for pair in sides],
        )

    def to(self, along, down):
        """Forces (n, 2) of the block on floor and wall, not turned, from the corner on."""
        self.bodies[0].end.value[:] = self.R @ (-along, -down)
        self.problem.solve(increments=2)
        sides = [result.sides[0] for result in self.problem.results]
        return [(s.force @ self.R)[np.linalg.norm(s.X, axis=1).argsort()] for s in sides]

    def load(self):
        """(2,) of the block's residual at its node in the corner, not turned."""
        V, b = self.bodies[0].u.function_space, fem.petsc.assemble_vector
        own = b(fem.form(self.bodies[0].F)).array.reshape(-1, 2)
        return own[np.linalg.norm(V.tabulate_dof_coordinates(), axis=1).argmin()] @ self.R


@pytest.mark.parametrize("angle", [4.0, longer(-1.2)])
def test_planes(angle):
    """Forces are the same in any pose: rounding told what of the corner's force which plane bears,
    by 2 to 6 % of the largest."""
    first, other = Corner(True), Corner(True, angle)
    for way in (0.02, 0.02), (0.05, 0.03), (0.05, 0.08), (0.02, 0.02):
        forces = first.to(*way)
        largest = max(np.abs(f).max() for f in forces)
        assert np.abs(forces[0][0] + forces[1][0] + first.load()).max() < 1e-9 * largest
        for k, f in enumerate(forces):
            assert f[:, 1 - k].max() < 1e-9 * largest
            assert (np.abs(f[:, k]) <= -MU * f[:, 1 - k] + 1e-9 * largest).all()
        gap = max(np.abs(a - b).max() for a, b in zip(forces, other.to(*way), strict=True))
        assert gap < 1e-8 * largest


WAY = (0.01, 0.01), (0.03, 0.05), (0.0, 0.05), (0.03, 0.02), (0.03, 0.03)


@pytest.mark.parametrize(("degree", "steps"), [(1, 2), longer(1, 5), longer(2, 5)])
def test_bodies(degree, steps):
    """Newton's iteration finds what sticks and slips in a few iterations: 10 were needed in a step,
    25 at second order."""
    corner = Corner(False, degree=degree)
    for way in WAY[:steps]:
        forces = corner.to(*way)
        largest = max(np.abs(f).max() for f in forces)
        assert len(corner.problem.history) <= (9 if degree == 1 else 16)
        assert np.abs(forces[0][0] + forces[1][0] + corner.load()).max() < 1e-9 * largest
