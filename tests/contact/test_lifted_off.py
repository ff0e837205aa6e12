"""A block that is pressed eccentrically on another, in 3D: half of the surface and more lifts off.

Nodes of the frame out there are touched by small entries of corrected rows alone: forces that each
are some 1e-3 of the last go on outwards, and rounding must not tell who bears them.
"""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

LOW, HIGH = 1, 2
STEPS = 0.1, 0.3, 0.35, 0.2  # eccentricity over the width: opens from 1/6 on, then closes in part


class Tower:
    """Two halves of cubes, n elements wide, one on the other, and the ``order`` of the sides."""

    def __init__(self, elements, order=(0, 1), **options):
        self.eccentricity, forms, loads, bcs, sides = [], [], [], [], []
        for k, n in enumerate(elements):
            z, box = -0.5 * k, mesh.CellType.hexahedron
            corners = np.array([[-0.5, -0.5, z], [0.5, 0.5, z + 0.5]])
            domain = mesh.create_box(MPI.COMM_WORLD, corners, [n, n, n // 4], box)
            faces = [
                mesh.locate_entities_boundary(domain, 2, lambda x, z=z: np.isclose(x[2], z))
                for z in (z, z + 0.5)
            ]
            found, tag = np.concatenate(faces), np.repeat([LOW, HIGH], [len(f) for f in faces])
            first = np.argsort(found)
            tags = mesh.meshtags(domain, 2, found[first], tag[first].astype(np.int32))
            V = compat.function_space(domain, shape=(3,))
            u, w, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(domain)
            e, p = fem.Constant(domain, 0.0), fem.Constant(domain, 1.0 - k)
            strain, ds = ufl.sym(ufl.grad(u)), ufl.Measure("ds", domain, subdomain_data=tags)
            stress = 800.0 * strain + 600.0 * ufl.tr(strain) * ufl.Identity(3)
            forms.append(ufl.inner(stress, ufl.grad(w)) * ufl.dx)
            loads.append(-p * (1.0 + 12.0 * e * x[0]) * w[2] * ds(HIGH))
            held, which = (faces[0], range(3)) if k else (faces[1], range(2))
            for i in which:
                dofs = fem.locate_dofs_topological(V.sub(i), 2, held)
                bcs.append(fem.dirichletbc(fem.Constant(domain, 0.0), dofs, V.sub(i)))
            self.eccentricity.append(e)
            sides.append((tags, HIGH if k else LOW))
        sides = tuple(sides[i] for i in order)
        interface = llm.Interface(None, sides, law=llm.Frictionless())
        self.problem = llm.ContactProblem(forms, loads, bcs=bcs, interfaces=[interface], **options)

    def step(self, e):
        """Normal forces of the nodes of the upper block and of the lower one."""
        for constant in self.eccentricity:
            constant.value = e
        self.problem.solve()
        result = self.problem.results[0]
        above = int(result.sides[0].x.shape[0] < result.sides[1].x.shape[0])
        return [result.sides[i] for i in (above, 1 - above)]


def checked(sides, e):
    """Nothing pulls; forces balance the load and its moment on both sides; no side overlaps."""
    for side in sides:
        force = side.normal_force
        assert force.min() >= -1e-10 * force.max() and side.gap.min() >= -1e-10
        assert abs(force.sum() - 1.0) <= 1e-10 and abs(force @ side.x[:, 0] - e) <= 1e-10
        assert np.abs(force[side.status == 0]).max(initial=0.0) <= 1e-8 * force.max()


@pytest.mark.parametrize("elements", [(16, 12), longer((20, 15))])
def test_lifts_off(elements):
    """In few iterations, in either order of sides: 9 and more, and no end, before."""
    towers = [Tower(elements), Tower(elements, (1, 0))]
    for e in STEPS:
        found = [tower.step(e) for tower in towers]
        for tower, sides in zip(towers, found, strict=True):
            checked(sides, e)
            assert len(tower.problem.history) <= 8
            assert "flexibility" in str(tower.problem)
        for one, other in zip(*found, strict=True):
            close = 1e-8 * one.normal_force.max()
            assert np.abs(one.normal_force - other.normal_force).max() <= close
    for tower in towers:
        tower.problem.destroy()


MORE = "20 iterations since 0.3 of the springs that hold the block hold frames, 15 with 0.1"


@pytest.mark.long
@pytest.mark.parametrize("elements", [
    (12, 9), pytest.param((16, 12), marks=pytest.mark.xfail(strict=False, reason=MORE))
])  # fmt: skip
def test_by_multigrid(elements):
    """It came to no rest; and where small entries alone touch frame nodes 400 iterations of CG did
    not do. Forces are those of the other form but for what small entries pass on."""
    towers = [Tower(elements), Tower(elements, solver="condensed")]
    for e in STEPS:
        found = [tower.step(e) for tower in towers]
        for tower, sides in zip(towers, found, strict=True):
            checked(sides, e)
            assert len(tower.problem.history) <= 15
        assert "CG + GAMG" in str(towers[1].problem) and "Cholesky" not in str(towers[1].problem)
        for one, other in zip(*found, strict=True):
            close = 1e-8 * one.normal_force.max()
            assert np.abs(one.normal_force - other.normal_force).max() <= close
