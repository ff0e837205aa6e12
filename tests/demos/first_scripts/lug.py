"""A pin pulled in the hole of a lug, with friction and a rounded end, as one writes it at first."""

import gmsh
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

E, NU, MU, R, SIZE, COMM = 210000.0, 0.3, 0.2, 10.0, 4.0, MPI.COMM_WORLD
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
if COMM.rank == 0:
    occ, group = gmsh.model.occ, gmsh.model.addPhysicalGroup
    box, end = occ.addBox(-50, -20, 0, 50, 40, 8), occ.addCylinder(0, 0, 0, 0, 0, 8, 20)
    (lug,), _ = occ.fuse([(3, box)], [(3, end)])
    (lug,), _ = occ.cut([lug], [(3, occ.addCylinder(0, 0, 0, 0, 0, 8, R))])
    pin = occ.addCylinder(0, 0, -4, 0, 0, 16, R)
    occ.synchronize()

    def faces(body):
        return [tag for _, tag in gmsh.model.getBoundary([body], oriented=False)]

    def inside(tag):
        low = gmsh.model.getBoundingBox(2, tag)
        return max(abs(low[0]), abs(low[1]), abs(low[3]), abs(low[4])) < R + 0.1

    bore = [t for t in faces(lug) if inside(t)]
    flat = [t for t in faces((3, pin)) if abs(occ.getCenterOfMass(2, t)[2] - 4) > 5]
    shaft = [t for t in faces((3, pin)) if t not in flat]
    held = [t for t in faces(lug) if abs(occ.getCenterOfMass(2, t)[0] + 50) < 1e-6]
    for tag, found in enumerate((bore, shaft, flat, held), start=1):
        group(2, found, tag)
    group(3, [lug[1]], 10), group(3, [pin], 11)
    gmsh.option.setNumber("Mesh.MeshSizeMax", SIZE)
    gmsh.model.mesh.generate(3)
mesh, cells, tags = compat.model_to_mesh(gmsh.model, COMM, 0, gdim=3)
gmsh.finalize()

V = compat.function_space(mesh, shape=(3,))
u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
eps = ufl.sym(ufl.grad(u))
stress = E / (1 + NU) * (eps + NU / (1 - 2 * NU) * ufl.tr(eps) * ufl.Identity(3))
ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
pull = fem.Constant(mesh, (8.0, 0.0, 0.0))
a, L = ufl.inner(stress, ufl.grad(v)) * ufl.dx, ufl.inner(pull, v) * ds(3)
wall = fem.locate_dofs_topological(V, 2, tags.find(4))
bcs = [fem.dirichletbc(np.zeros(3), wall, V)]
ends = [fem.locate_dofs_topological(V.sub(k), 2, tags.find(3)) for k in (1, 2)]
bcs += [fem.dirichletbc(fem.Constant(mesh, 0.0), at, V.sub(k)) for k, at in zip((1, 2), ends)]
contact = llm.Interface(tags, (2, 1), law=llm.Coulomb(MU))
problem = llm.ContactProblem(a, L, bcs=bcs, interfaces=[contact])
solved = problem.solve()
problem.plot("out")
llm.post.write_bodies("out/bodies.pvd", solved)
total = COMM.allreduce(fem.assemble_scalar(fem.form(pull[0] * ds(3))))
if COMM.rank == 0:
    print([[total, 0.0, 0.0]] + [result.resultant.tolist() for result in problem.results])
