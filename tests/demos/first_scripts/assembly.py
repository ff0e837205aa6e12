"""Three blocks on two meshes, tied and with friction, as one writes it at first."""

import dataclasses

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as meshes
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

E, NU, COMM = 1000.0, 0.3, MPI.COMM_WORLD


def box(low, high, n):
    corners = [np.array(low, dtype=float), np.array(high, dtype=float)]
    return meshes.create_box(COMM, corners, n, meshes.CellType.hexahedron)


base = box((0, 0, 0), (3, 3, 1), (9, 9, 3))
column = box((0.5, 0.5, 1), (2.5, 2.5, 3.2), (7, 7, 11))  # of which a layer is cut out
lower = meshes.locate_entities(column, 3, lambda x: x[2] < 1.81)
upper = meshes.locate_entities(column, 3, lambda x: x[2] > 1.99)
pair = meshes.create_submesh(column, 3, np.sort(np.concatenate([lower, upper])))[0]
x = pair.geometry.x
x[x[:, 2] > 1.9, 2] -= 0.2  # the upper block comes down onto the lower one

a, L, spaces = [], [], []
for mesh, end, force in (base, 0.0, (0.0, 0.0, 0.0)), (pair, 3.0, (1.0, 0.0, -10.0)):
    at = meshes.locate_entities_boundary(mesh, 2, lambda x, z=end: np.isclose(x[2], z))
    tags = meshes.meshtags(mesh, 2, np.sort(at), np.full(len(at), 1, dtype=np.int32))
    V = compat.function_space(mesh, shape=(3,))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    eps = ufl.sym(ufl.grad(u))
    stress = E / (1 + NU) * (eps + NU / (1 - 2 * NU) * ufl.tr(eps) * ufl.Identity(3))
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    a.append(ufl.inner(stress, ufl.grad(v)) * ufl.dx)
    L.append(ufl.inner(fem.Constant(mesh, force), v) * ds(1))
    spaces.append(V)
held = fem.locate_dofs_geometrical(spaces[0], lambda x: np.isclose(x[2], 0.0))
bcs = [fem.dirichletbc(np.zeros(3), held, spaces[0])]

found = llm.find_interfaces([None, None], spaces, law=llm.Tied())
seat, joint = sorted(found, key=lambda i: i.name)
interfaces = [dataclasses.replace(seat, law=llm.Coulomb(0.4)), joint]
problem = llm.ContactProblem(a, L, bcs=bcs, interfaces=interfaces)
solved = problem.solve()
problem.plot("out")
llm.post.write_bodies("out/bodies.pvd", solved)
if COMM.rank == 0:
    print([result.resultant.tolist() for result in problem.results])
