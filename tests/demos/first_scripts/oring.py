"""An O-ring of rubber between two plates, its whole circle tagged, as one writes it at first."""

import gmsh
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

R, SIZE, COMM = 2.5, 0.25, MPI.COMM_WORLD
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
if COMM.rank == 0:
    occ, group = gmsh.model.occ, gmsh.model.addPhysicalGroup
    ring = occ.addDisk(0, 0, 0, R, R)
    low, high = occ.addRectangle(-4, -R - 1, 0, 8, 1), occ.addRectangle(-4, R, 0, 8, 1)
    occ.synchronize()

    def edges(body, y=None):
        found = [tag for _, tag in gmsh.model.getBoundary([(2, body)], oriented=False)]
        return [t for t in found if y is None or abs(occ.getCenterOfMass(1, t)[1] - y) < 1e-6]

    tagged = edges(ring), edges(low, -R), edges(high, R), edges(low, -R - 1), edges(high, R + 1)
    for tag, found in enumerate(tagged, start=1):
        group(1, found, tag)
    for tag, body in enumerate((ring, low, high), start=10):
        group(2, [body], tag)
    gmsh.option.setNumber("Mesh.MeshSizeMax", SIZE)
    gmsh.model.mesh.generate(2)
mesh, cells, tags = compat.model_to_mesh(gmsh.model, COMM, 0, gdim=2)
gmsh.finalize()

V = compat.function_space(mesh, shape=(2,))
u, v = fem.Function(V), ufl.TestFunction(V)
dx = ufl.Measure("dx", domain=mesh, subdomain_data=cells)


def energy(E, nu):
    mu, lam = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
    F = ufl.Identity(2) + ufl.grad(u)
    J = ufl.det(F)
    return mu / 2 * (ufl.inner(F, F) - 2 - 2 * ufl.ln(J)) + lam / 2 * ufl.ln(J) ** 2


F = ufl.derivative(energy(6.0, 0.45) * dx(10) + energy(2000.0, 0.3) * (dx(11) + dx(12)), u, v)
down = fem.Constant(mesh, np.zeros(2))
bottom, top = (fem.locate_dofs_topological(V, 1, tags.find(tag)) for tag in (4, 5))
bcs = [fem.dirichletbc(np.zeros(2), bottom, V), fem.dirichletbc(down, top, V)]
interfaces = [llm.Interface(tags, (1, plate), law=llm.Coulomb(0.2)) for plate in (2, 3)]
problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=interfaces)
with llm.plot.Film(problem, "out/squeeze.gif") as film:
    for squeeze in np.linspace(0.1, 0.8, 8):
        down.value = (0.0, -squeeze)
        problem.solve()
        film.add()
problem.plot("out")
llm.post.write_bodies("out/bodies.pvd", u)
if COMM.rank == 0:
    print([result.resultant.tolist() for result in problem.results])
