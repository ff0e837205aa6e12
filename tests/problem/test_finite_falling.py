"""Bodies at finite deformation that a load brings across a gap, and that fall until then."""

import finite_patch
import numpy as np
import pytest
import scenes
import ufl
import wall_scenes as walls
from dolfinx import fem, mesh
from dolfinx.fem.petsc import assemble_vector
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

GAP, LOAD = 0.02, 2.0
BASE, LOWER = ((-0.5, -1.0), (2.5, -GAP)), ((0.0, 0.0), (2.0, 1.0))
UPPER = ((0.0, 1.0), (2.0, 1.7))
LEVER, BELOW_ITS_END = ((-1.5, 0.0), (2.5, 1.0)), ((-2.0, -1.0), (0.5, -GAP))
LAWS = {"tied": llm.Tied(), "free": llm.Frictionless(), "friction": llm.Coulomb(0.3)}


def scene(blocks, below, degree=1):
    """Blocks above a base that is held; the joint above it."""
    counts = [(8, 3), (13, 3), (9, 3)][: len(blocks)]
    faces = [(k, 1, k + 1) for k in range(len(blocks) - 1)]
    wall = walls.Wall(MPI.COMM_SELF, np.array(blocks), counts, faces=faces, degree=degree)
    u = fem.Function(wall.V)
    F = finite_patch.residual(u, *finite_patch.lame(100.0, 0.3), degree)
    base = fem.locate_dofs_geometrical(wall.V, lambda p: p[1] < -1.0 + 1e-9)
    bcs = [fem.dirichletbc(np.zeros(2), base, wall.V)]
    sides = wall.tag(0, 1, 1), wall.tag(1, 1, 0)
    return wall, u, F, bcs, llm.Interface(wall.tags, sides, law=below)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("between", LAWS)
def test_two_blocks_on_a_base(between, degree):
    """They touch each other, or are tied, which held them: "a body flies away, by 1.3e+10"."""
    below = LAWS["free" if between == "tied" else between]
    wall, u, F, bcs, joint = scene((BASE, LOWER, UPPER), below, degree)
    load = fem.Constant(wall.domain, (0.0, -LOAD / 2.0))
    on_top = ufl.ds(subdomain_data=wall.tags)(walls.OUTER)
    x = ufl.SpatialCoordinate(wall.domain)
    high = ufl.conditional(x[1] > UPPER[1][1] - 1e-6, 1.0, 0.0)
    F -= high * ufl.inner(load, ufl.TestFunction(wall.V)) * on_top
    V0, _ = wall.V.sub(0).collapse()
    left = fem.locate_dofs_geometrical(
        (wall.V.sub(0), V0), lambda p: (np.abs(p[0]) < 1e-9) & (p[1] > -1e-9)
    )
    bcs.append(fem.dirichletbc(fem.Function(V0), left, wall.V.sub(0)))
    sides = wall.tag(1, 1, 1), wall.tag(2, 1, 0)
    interfaces = [joint, llm.Interface(wall.tags, sides, law=LAWS[between])]
    problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=interfaces)
    problem.solve()
    for result in problem.results:
        assert np.isclose(np.abs(result.resultant[1]), LOAD, rtol=1e-8)
    assert problem.results[0].sides[0].normal_force.sum() > 0.0 and len(problem.history) <= 12
    problem.destroy()


@pytest.mark.parametrize("law", ["free", "friction"])
@pytest.mark.parametrize("moment", [False, True], ids=["force", "moment"])
def test_a_lever_on_a_rigid_end(moment, law):
    """The end held it as well, though it goes where forces and moments move it."""
    wall, u, F, bcs, joint = scene((BELOW_ITS_END, LEVER), LAWS[law])
    pivot = np.array((-1.5, 0.5))
    loads = {"moment": -LOAD, "pivot": pivot} if moment else {"force": (None, -LOAD)}
    end = llm.RigidPlane(pivot, (1.0, 0.0), **loads)
    held = llm.Interface(wall.tags, (wall.tag(1, 0, 0), end), law=llm.Tied())
    problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=[joint, held])
    problem.solve()
    below, at_end = problem.results[0].sides[1], problem.results[1].sides[0]
    left = below.force.sum(axis=0) + at_end.force.sum(axis=0)
    assert np.abs(left).max() < 1e-8 * LOAD
    arm = below.x - pivot
    turning = (arm[:, 0] * below.force[:, 1] - arm[:, 1] * below.force[:, 0]).sum()
    assert np.isclose(np.abs(turning if moment else below.force[:, 1].sum()), LOAD, rtol=1e-8)
    problem.destroy()


@pytest.mark.parametrize("solver", ["saddle", "condensed"])
@pytest.mark.parametrize("gdim", [2, 3])
def test_a_block_that_is_pressed_beside_its_middle(gdim, solver):
    """It meets a plane with one corner first, which does not hold it, and turns about it until it
    meets others: "a body flies away, by 1.5e+14"."""
    size, counts = np.array([2.0, 1.5, 1.0])[3 - gdim :], np.array([5, 4, 2])[3 - gdim :]
    ends, cell = (np.zeros(gdim), size), ("triangle", "tetrahedron")[gdim - 2]
    create = (mesh.create_rectangle, mesh.create_box)[gdim - 2]
    domain = create(MPI.COMM_SELF, ends, counts.tolist(), getattr(mesh.CellType, cell))
    top, bottom = (
        mesh.locate_entities_boundary(domain, gdim - 1, scenes.on(gdim - 1, level))
        for level in (size[-1], 0.0)
    )
    values = [np.full(len(on), k, np.int32) for k, on in ((1, top), (2, bottom))]
    tags = scenes.tags_from(domain, (top, bottom), values, gdim - 1)
    V = compat.function_space(domain, shape=(gdim,))
    u, x = fem.Function(V), ufl.SpatialCoordinate(domain)
    p = 0.5 * (1.0 + sum(0.3 * (x[i] / size[i] - 0.5) for i in range(gdim - 1)))
    F = finite_patch.residual(u, *finite_patch.lame(100.0, 0.3))
    pressed = p * ufl.TestFunction(V)[gdim - 1] * ufl.ds(subdomain_data=tags)(1)
    F += pressed
    plane = llm.RigidPlane((*np.zeros(gdim - 1), -GAP), np.eye(gdim)[-1])
    interface = llm.Interface(tags, (2, plane), law=llm.Coulomb(0.3))
    problem = llm.NonlinearContactProblem(F, u, interfaces=[interface], solver=solver)
    problem.solve()
    side = problem.results[0].sides[0]
    load = assemble_vector(fem.form(pressed)).array.reshape(-1, gdim)[:, -1]
    assert np.isclose(side.normal_force.sum(), load.sum(), rtol=1e-9)
    moved = V.tabulate_dof_coordinates()[:, :gdim] + u.x.array.reshape(-1, gdim)
    assert np.allclose((side.normal_force @ side.x)[:-1], (load @ moved)[:-1], rtol=1e-9)
    assert (side.normal_force > 0.0).all() and np.abs(side.gap).max() < 1e-9
    problem.destroy()
