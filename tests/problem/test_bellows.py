"""A bellows pressed together until its folds touch, on a facet at first."""

import gmsh
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

SKIN, LOW, TOP = 1, 2, 3
FOLDS, PITCH, RADIUS, WALL, SIZE = 3, 1.0, 3.0, 0.2, 0.12


def bellows():
    """Mesh and facet tags of the wall, whose middle is a wave."""
    y = np.linspace(0.0, FOLDS * PITCH, 16 * FOLDS + 1)
    turn = 2.0 * np.pi / PITCH
    middle = np.column_stack([RADIUS + 0.5 * np.cos(turn * y), y])
    normal = np.column_stack([np.ones(len(y)), -np.gradient(middle[:, 0], y)])
    normal *= 0.5 * WALL / np.linalg.norm(normal, axis=1)[:, None]
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    geo = gmsh.model.geo
    ends = [[geo.addPoint(*p, 0.0, SIZE) for p in middle + way * normal] for way in (1.0, -1.0)]
    out, within = (geo.addSpline(points) for points in ends)
    low, top = (geo.addLine(ends[1][k], ends[0][k]) for k in (0, -1))
    geo.addPlaneSurface([geo.addCurveLoop([low, out, -top, -within])], 1)
    geo.synchronize()
    gmsh.model.addPhysicalGroup(2, [1], 1)
    for tag, curves in ((SKIN, [out, within]), (LOW, [low]), (TOP, [top])):
        gmsh.model.addPhysicalGroup(1, curves, tag)
    gmsh.model.mesh.generate(2)
    domain, _, tags, *_ = compat.model_to_mesh(gmsh.model, MPI.COMM_SELF, 0, gdim=2)
    gmsh.finalize()
    return domain, tags


def test_folds_meet():
    """Two places of a frame bend, and no row connects them: rounding told the corrections of rows
    there to 1e-9, and increments were halved in vain."""
    domain, tags = bellows()
    V = compat.function_space(domain, shape=(2,))
    u, r = fem.Function(V), ufl.SpatialCoordinate(domain)[0]
    F, around = ufl.Identity(2) + ufl.grad(u), 1.0 + u[0] / r
    J, mu, lam = ufl.det(F) * around, 38.5, 57.7
    psi = 0.5 * mu * (ufl.inner(F, F) + around**2 - 3.0) - mu * ufl.ln(J)
    psi = (psi + 0.5 * lam * ufl.ln(J) ** 2) * 2.0 * np.pi * r
    pressed, zero = (fem.Constant(domain, 0.0) for _ in range(2))
    bcs = []
    for tag, k, value in ((LOW, 0, zero), (LOW, 1, zero), (TOP, 0, zero), (TOP, 1, pressed)):
        dofs = fem.locate_dofs_topological(V.sub(k), 1, tags.find(tag))
        bcs.append(fem.dirichletbc(value, dofs, V.sub(k)))
    thickness = lambda x: 2.0 * np.pi * x[:, 0]  # noqa: E731
    contact = llm.SelfContact(tags, SKIN, llm.Frictionless(), thickness=thickness)
    form = ufl.derivative(psi * ufl.dx(degree=4), u, ufl.TestFunction(V))
    problem = llm.NonlinearContactProblem(form, u, bcs=bcs, interfaces=[contact])
    for way in np.linspace(0.0, 1.575, 8)[1:]:
        pressed.value = -way
        problem.solve()
    one, other = (side.force for side in problem.results[0].sides)
    assert (problem.results[0].sides[0].status > 0).sum() >= 3
    assert np.abs(one.sum(axis=0) + other.sum(axis=0)).max() <= 1e-10 * np.abs(one).max()
