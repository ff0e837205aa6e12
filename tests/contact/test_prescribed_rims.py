"""Two plates with a hole, pressed on each other around it: friction where supports hold both of
their rims."""

import gmsh
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

pytestmark = pytest.mark.quick
HALF, HIGH, HOLE, PRESSED, MU, PRESSURE = 15.0, 8.0, 5.5, 8.0, 0.15, 100.0


def plates():
    """Space and facet tags: 1 and 2 where the plates touch, 3 below and 4 above, 5 their rims."""
    gmsh.initialize()
    for option, value in (
        ("General.Terminal", 0), ("Mesh.RandomSeed", 3), ("Mesh.MeshSizeMax", 5.0)
    ):  # fmt: skip
        gmsh.option.setNumber(option, value)
    occ, tags, bodies = gmsh.model.occ, {1: [], 2: [], 3: [], 4: [], 5: []}, []
    for low in (-HIGH, 0.0):
        box = occ.addBox(-HALF, -HALF, low, 2 * HALF, 2 * HALF, HIGH)
        hole = occ.addCylinder(0, 0, low - 1, 0, 0, HIGH + 2, HOLE)
        bodies += occ.cut([(3, box)], [(3, hole)])[0]
    occ.synchronize()
    for body, levels in zip(bodies, ({0.0: 1, -HIGH: 3}, {0.0: 2, HIGH: 4}), strict=True):
        for _, face in gmsh.model.getBoundary([body], oriented=False):
            box = np.reshape(gmsh.model.getBoundingBox(2, face), (2, 3))
            if np.ptp(box[:, 2]) < 1e-3:
                tags[levels[float(box[:, 2].mean().round(3)) + 0.0]].append(face)
            elif np.abs(box.mean(axis=0)[:2]).max() > HALF - 1e-3:
                tags[5].append(face)
    for tag, faces in tags.items():
        gmsh.model.addPhysicalGroup(2, faces, tag)
    gmsh.model.addPhysicalGroup(3, [body for _, body in bodies], 1)
    gmsh.model.mesh.generate(3)
    domain, _, facet_tags = compat.model_to_mesh(gmsh.model, MPI.COMM_SELF, 0, gdim=3)
    gmsh.finalize()
    return compat.function_space(domain, shape=(3,)), facet_tags


@pytest.mark.parametrize("tags", [(1, 2), longer((2, 1))])
def test_frame_nodes_between_rims_that_supports_hold(tags):
    """Frame nodes there move with the supports. They drifted by 50,000 times the bodies' motion,
    since corrected rows alone told it, in 17 iterations."""
    V, facets = plates()
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    strain = ufl.sym(ufl.grad(u))
    sigma = 210e3 / 1.3 * (strain + 0.75 * ufl.tr(strain) * ufl.Identity(3))
    x, ds = ufl.SpatialCoordinate(V.mesh), ufl.Measure("ds", subdomain_data=facets)
    load = PRESSURE * ufl.conditional(ufl.lt(x[0] ** 2 + x[1] ** 2, PRESSED**2), 1.0, 0.0) * v[2]
    below = V.tabulate_dof_coordinates()[:, 2] < -1e-9
    zero, bcs = fem.Constant(V.mesh, 0.0), []
    for k in range(3):
        rim = fem.locate_dofs_topological(V.sub(k), 2, facets.find(5))
        if k == 2:
            rim = rim[below[rim // 3]]
        bcs.append(fem.dirichletbc(zero, rim, V.sub(k)))
    interface = llm.Interface(facets, tags, law=llm.Coulomb(MU))
    a, L = ufl.inner(sigma, ufl.grad(v)) * ufl.dx, load * ds(3) - load * ds(4)
    with llm.ContactProblem(a, L, bcs=bcs, interfaces=[interface]) as problem:
        motion, result = problem.solve(), problem.results[0]
        assert len(problem.history) <= 12
    at_rim = np.abs(result.frame.x[:, :2]).max(axis=1) > HALF - 1e-9
    moved = np.abs(motion.x.array).max()
    assert np.abs(result.frame.v).max() <= 2.0 * moved
    assert np.abs(result.frame.v[at_rim, :2]).max() <= 0.1 * moved
    forces = [s.force.sum(axis=0) for s in result.sides]
    normal = fem.assemble_scalar(fem.form(ufl.replace(load, {v: ufl.as_vector((0, 0, 1))}) * ds(4)))
    assert np.abs(np.add(*forces)).max() <= 1e-9 * normal
    assert abs(abs(forces[0][2]) / normal - 1.0) < 1e-9
    for s in result.sides:
        assert s.normal_force.min() >= -1e-9 * normal
        assert np.linalg.norm(s.tangential_force.sum(axis=0)) <= MU * normal
