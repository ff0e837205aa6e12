"""The lower half of a disc of radius 1, all of which supports move, on a block; by gmsh."""

import gmsh
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

TOOL, BLOCK, SKIN, TOP = 1, 2, 3, 4
E, NU = 100.0, 0.3


def drawn(tool, block, order):
    """Mesh, cell tags and facet tags of triangles of these sizes, the block's next to the disc."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ, field = gmsh.model.occ, gmsh.model.mesh.field
    whole, below = occ.addDisk(0, 1, 0, 1, 1), occ.addRectangle(-2, -1, 0, 4, 2)
    disc = occ.intersect([(2, whole)], [(2, below)])[0][0][1]
    low = occ.addRectangle(-2, -1, 0, 4, 1)
    occ.synchronize()
    groups = {SKIN: [], TOP: []}
    for body, tag in ((disc, SKIN), (low, TOP)):
        for _, line in gmsh.model.getBoundary([(2, body)], oriented=False):
            box = np.reshape(gmsh.model.getBoundingBox(1, line), (2, 3))
            flat = np.ptp(box[:, 1]) < 1e-5
            if (tag == SKIN and not flat) or (tag == TOP and flat and abs(box[0, 1]) < 1e-5):
                groups[tag].append(line)
    for tag, lines in groups.items():
        gmsh.model.addPhysicalGroup(1, lines, tag)
    for tag, body in ((TOOL, disc), (BLOCK, low)):
        gmsh.model.addPhysicalGroup(2, [body], tag)
    field.add("MathEval", 1)
    field.setString(1, "F", f"{block}+0.15*Sqrt(x*x+y*y)")
    field.add("Box", 2)
    for name, value in (("VIn", tool), ("VOut", 9.0), ("XMin", -9.0), ("XMax", 9.0)):
        field.setNumber(2, name, value)
    field.setNumber(2, "YMin", 1e-3)
    field.setNumber(2, "YMax", 9.0)
    field.add("Min", 3)
    field.setNumbers(3, "FieldsList", [1, 2])
    field.setAsBackgroundMesh(3)
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.setOrder(order)
    domain, cells, tags, *_ = compat.model_to_mesh(gmsh.model, MPI.COMM_SELF, 0, gdim=2)
    gmsh.finalize()
    return domain, cells, tags


def solved(meshed, order, law, rigid, steps, form="auto", finite=False):
    """Problems' histories and forces (2,) on the block after steps (down, along), of the disc, or
    of a rigid one in its place."""
    domain, cells, tags = meshed
    V = compat.function_space(domain, degree=order, shape=(2,))
    domain.topology.create_connectivity(2, 2)
    moved = fem.Function(V)
    tool = fem.locate_dofs_topological(V, 2, cells.find(TOOL))
    bottom = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], -1.0))
    bcs = [fem.dirichletbc(moved, tool), fem.dirichletbc(fem.Function(V), bottom)]
    obstacle = llm.RigidSphere((0.0, 1.0), 1.0)
    sides = (TOP, obstacle) if rigid else (SKIN, TOP)
    interface = llm.Interface(tags, sides, law=law)
    w, mu, lam = ufl.TestFunction(V), E / 2 / (1 + NU), E * NU / (1 + NU) / (1 - 2 * NU)
    if finite:
        u = fem.Function(V)
        F = ufl.Identity(2) + ufl.grad(u)
        J = ufl.det(F)
        energy = mu / 2 * (ufl.tr(F.T * F) - 2) - mu * ufl.ln(J) + lam / 2 * ufl.ln(J) ** 2
        form_ = ufl.derivative(energy * ufl.dx(degree=4), u, w)
        problem = llm.NonlinearContactProblem(form_, u, bcs=bcs, interfaces=[interface])
    else:
        u = ufl.TrialFunction(V)
        e = ufl.sym(ufl.grad(u))
        stress = 2 * mu * e + lam * ufl.tr(e) * ufl.Identity(2)
        a, L = ufl.inner(stress, ufl.grad(w)) * ufl.dx, ufl.inner(fem.Function(V), w) * ufl.dx
        problem = llm.ContactProblem(a, L, bcs=bcs, interfaces=[interface], solver=form)
    found = []
    for down, along in steps:
        moved.interpolate(lambda x, d=down, s=along: np.stack([0 * x[0] + s, 0 * x[0] - d]))
        obstacle.displacement = (along, -down)
        problem.solve()
        (result,) = problem.results
        found.append((len(problem.history), result.sides[0 if rigid else 1].force.sum(axis=0)))
    return problem, found
