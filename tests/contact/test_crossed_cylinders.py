"""A quarter of two crossed cylinders of second order, between two planes of symmetry, by gmsh."""

import gmsh
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

TOP, BOTTOM, PLANES, UPPER, LOWER = 1, 2, (3, 4), 5, 6
E, NU, RADII = 100.0, 0.3, (0.8, 1.0)
FREE = llm.Frictionless()


def cylinders():
    """Space and facet tags; the upper one lies along y, the lower one along x."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ, (upper, lower) = gmsh.model.occ, RADII
    corner = occ.addBox(0, 0, -lower, 1.2, 1.2, upper + lower)
    whole = (
        occ.addCylinder(0, -1, upper, 0, 3, 0, upper),
        occ.addCylinder(-1, 0, -lower, 3, 0, 0, lower),
    )
    bodies = [occ.intersect([(3, one)], [(3, corner)], removeTool=False)[0][0] for one in whole]
    occ.remove([(3, corner)], True)
    occ.synchronize()
    groups = {tag: [] for tag in (TOP, BOTTOM, *PLANES, UPPER, LOWER)}
    for body, skin, h in zip(bodies, (UPPER, LOWER), (0.3, 0.25), strict=True):
        gmsh.model.mesh.setSize(gmsh.model.getBoundary([body], recursive=True), h)
        for dim, face in gmsh.model.getBoundary([body], oriented=False):
            box = np.reshape(gmsh.model.getBoundingBox(dim, face), (2, 3))
            thin, level = np.ptp(box, axis=0) < 1e-5, box[0].round(5)
            if not thin.any():
                groups[skin].append(face)
            elif thin[2]:
                groups[TOP if level[2] > 0.5 else BOTTOM].append(face)
            elif not level[thin].any():
                groups[PLANES[int(thin.argmax())]].append(face)
    for tag, faces in groups.items():
        gmsh.model.addPhysicalGroup(2, faces, tag)
    gmsh.model.addPhysicalGroup(3, [tag for _, tag in bodies], 1)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.setOrder(2)
    domain, _, tags, *_ = compat.model_to_mesh(gmsh.model, MPI.COMM_SELF, 0, gdim=3)
    gmsh.finalize()
    return compat.function_space(domain, degree=2, shape=(3,)), tags


@pytest.mark.long
def test_forms():
    """The condensed form without friction swung for ever in the second load step, since what
    presses next is forecast."""
    V, tags = cylinders()
    u, w, zero = ufl.TrialFunction(V), ufl.TestFunction(V), fem.Constant(V.mesh, 0.0)
    strain = ufl.sym(ufl.grad(u))
    stress = E / (1 + NU) * (strain + NU / (1 - 2 * NU) * ufl.tr(strain) * ufl.Identity(3))
    a, L = ufl.inner(stress, ufl.grad(w)) * ufl.dx, zero * w[0] * ufl.dx
    down = fem.Constant(V.mesh, 0.0)
    held = [(TOP, 2, down), *((tag, k, zero) for k, tag in enumerate(PLANES))]
    held += [(TOP, k, zero) for k in range(2)] + [(BOTTOM, k, zero) for k in range(3)]
    bcs = [
        fem.dirichletbc(value, fem.locate_dofs_topological(V.sub(k), 2, tags.find(tag)), V.sub(k))
        for tag, k, value in held
    ]
    found = {}
    for law, solver in (FREE, "saddle"), (FREE, "condensed"), (llm.Coulomb(0.3), "saddle"):
        interface = llm.Interface(tags, (UPPER, LOWER), law=law)
        with llm.ContactProblem(a, L, bcs=bcs, interfaces=[interface], solver=solver) as problem:
            for depth in (0.02, 0.05):
                down.value = -depth
                problem.solve()
                found[law, solver, depth] = problem.results[0].sides[0].force
                assert len(problem.history) <= (45 if law is FREE else 60)
                assert problem.results[0].pressure.min() >= 0.0
    for depth in (0.02, 0.05):
        one, other = found[FREE, "saddle", depth], found[FREE, "condensed", depth]
        assert np.abs(one - other).max() <= 1e-8 * np.abs(one).max()
