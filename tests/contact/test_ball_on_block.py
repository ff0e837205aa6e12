"""A quarter of a ball pressed onto a block, between two planes of symmetry: slips on the
planes, where supports hold both sides; of second order, by gmsh."""

import warnings

import bowls
import gmsh
import numpy as np
import pytest
import scenes
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.laws.rows import OPEN

pytestmark = pytest.mark.quick
DOWN = 0.03  # motion of the ball


def pressed(law, caplog):
    """Result of the ball, side 1, pressed by DOWN, and the warnings that came with it."""
    V, tags, _ = bowls.bowl_on_block(scenes.grid(7, 6), scenes.grid(5, 7))
    bcs = scenes.hold(V, bowls.HELD)
    bcs += scenes.hold(V, [(2, scenes.on(2, 2.0))], lambda p: np.full_like(p, -DOWN))
    problem = scenes.block_problem(V, tags, bcs=bcs, loads=[], law=law)
    with warnings.catch_warnings():
        problem.solve()
    return problem.results[0], [record.getMessage() for record in caplog.records]


def test_slips_on_planes_of_symmetry(caplog):
    """There supports hold both bodies across, and nothing slips; it did by up to the ball's radius,
    and a warning said that nodes slide by more than a facet."""
    result, said = pressed(llm.Coulomb(0.3), caplog)
    on_planes = 0
    for side in result.sides:
        assert np.linalg.norm(side.slip, axis=1).max() < 0.2 * DOWN
        for k in range(2):
            at = (np.abs(side.x[:, k]) < 1e-9) & (side.status != OPEN)
            on_planes += at.sum()
            assert np.abs(side.slip[at, k]).max() < 1e-12
    assert on_planes >= 8 and not [text for text in said if "slide by" in text]


@pytest.mark.parametrize("law", [llm.Frictionless(), llm.Coulomb(0.3)], ids=str)
def test_a_ball_whose_motion_is_prescribed(law):
    """All of it, as of a rigid tool, with smaller facets than the block's: supports hold one side
    of what may touch, which parts as any other, and nothing pulls."""
    sections = scenes.grid(4, 4, high=(1.5, 1.5)), scenes.grid(7, 7)
    found = []
    for solver in ("saddle", "condensed"):
        problem = bowls.moved_down(*sections, DOWN, law=law, options={"solver": solver})
        problem.solve()
        (result,) = problem.results
        force = np.concatenate([side.normal_force for side in result.sides])
        assert force.max() > 0.0 and force.min() >= -1e-9 * force.max()
        assert all(0 < (side.status == OPEN).sum() < len(side.x) for side in result.sides)
        found.append(result.sides[0].force.sum(axis=0))
    assert np.abs(found[0] - found[1]).max() <= 1e-8 * np.abs(found[0]).max()


def second_order_ball(fine, coarse):
    """Space and facet tags of a quarter ball on a block: 3 on top of the ball, 4 below the block, 6
    at y = 0, 7 and 8 the ball's skin and the block's top."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ, field = gmsh.model.occ, gmsh.model.mesh.field
    whole, part = occ.addSphere(0, 0, 1, 1), occ.addBox(0, 0, -1, 3, 3, 2)
    ball = occ.intersect([(3, whole)], [(3, part)])[0][0][1]
    block, pole = occ.addBox(0, 0, -1, 1.5, 1.5, 1), occ.addPoint(0, 0, 0)
    occ.synchronize()
    groups = {3: [], 4: [], 6: [], 7: [], 8: []}
    for body, flat in ((ball, {(2, 1.0): 3}), (block, {(2, -1.0): 4, (2, 0.0): 8})):
        for _, face in gmsh.model.getBoundary([(3, body)], oriented=False):
            box = np.reshape(gmsh.model.getBoundingBox(2, face), (2, 3))
            thin, level = np.ptp(box, axis=0) < 1e-5, box.mean(axis=0)
            if not thin.any():
                groups[7].append(face)
            elif thin[2]:
                groups[flat[2, float(level[2].round(3)) + 0.0]].append(face)
            elif thin[1] and abs(level[1]) < 1e-5:
                groups[6].append(face)
    for tag, faces in groups.items():
        gmsh.model.addPhysicalGroup(2, faces, tag)
    gmsh.model.addPhysicalGroup(3, [ball, block], 1)
    field.add("Distance", 1)
    field.setNumbers(1, "PointsList", [pole])
    field.add("Threshold", 2)
    sizes = {"InField": 1, "SizeMin": fine, "SizeMax": coarse, "DistMin": 0.35, "DistMax": 1.2}
    for name, value in sizes.items():
        field.setNumber(2, name, value)
    field.setAsBackgroundMesh(2)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.setOrder(2)
    domain, _, tags = compat.model_to_mesh(gmsh.model, MPI.COMM_SELF, 0, gdim=3)
    gmsh.finalize()
    return compat.function_space(domain, degree=2, shape=(3,)), tags


@pytest.mark.long
@pytest.mark.parametrize(
    ("fine", "coarse", "most", "even"), [(1 / 6, 0.5, 25, 1e-9), (0.105, 0.36, 35, 3e-8)]
)
def test_a_ball_of_second_order_with_friction(fine, coarse, most, even):
    """Frame nodes far from contact, that forces of corrected rows hardly reach, drift along the
    surface for ever: the law comes to rest, soon. What they leave in all is ``even`` at most."""
    V, tags = second_order_ball(fine, coarse)
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    strain = ufl.sym(ufl.grad(u))
    sigma = 100 / 1.3 * (strain + 0.75 * ufl.tr(strain) * ufl.Identity(3))
    down, side = (fem.Constant(V.mesh, 0.0) for _ in range(2))
    bcs = [
        fem.dirichletbc(value, fem.locate_dofs_topological(V.sub(k), 2, tags.find(tag)), V.sub(k))
        for tag, k, value in ((3, 2, down), (3, 0, side), *((t, k, fem.Constant(V.mesh, 0.0))
        for t, k in ((3, 1), (4, 0), (4, 1), (4, 2), (6, 1))))
    ]  # fmt: skip
    zero = fem.Constant(V.mesh, (0.0, 0.0, 0.0))
    interface = llm.Interface(tags, (7, 8), law=llm.Coulomb(0.3))
    a, L = ufl.inner(sigma, ufl.grad(w)) * ufl.dx, ufl.inner(zero, w) * ufl.dx
    with llm.ContactProblem(a, L, bcs=bcs, interfaces=[interface]) as problem:
        for depth, way in ((0.02, 0.0), (0.05, 0.0), (0.05, 0.02)):
            down.value, side.value = -depth, way
            problem.solve()
            result = problem.results[0]
            forces = [s.force.sum(axis=0) for s in result.sides]
            assert np.abs(np.add(*forces)).max() <= even * np.abs(forces[0]).max()
            assert problem.history[-1]["residual"] <= 1e-9
            assert len(problem.history) <= most
            drag = np.linalg.norm(result.frame_friction.sum(axis=0))
            assert drag <= 0.3 * result.frame_force.sum() * (1.0 + 1e-9)
    assert drag > 0.5 * 0.3 * result.frame_force.sum()
