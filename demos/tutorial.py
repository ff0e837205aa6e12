"""Tutorial: from a gmsh model to a picture of the contact pressure, in nine steps.

A pad is pressed onto a block and dragged over it, with friction. Millimetres and newtons; on any
number of ranks: mpirun -n 2 python demos/tutorial.py
"""

import gmsh
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

PAD, BLOCK, UNDERSIDE, SEAT, TOP, BOTTOM = 1, 2, 3, 4, 5, 6  # tags of two bodies, four surfaces
E, NU, MU, PRESSURE = {PAD: 200.0, BLOCK: 1000.0}, 0.3, 0.3, 5.0  # of the pad 1 x 1 x 0.2 mm


def model():
    """1. Geometry: two bodies that share no node, with a tag for all that is named later on."""
    occ, group = gmsh.model.occ, gmsh.model.addPhysicalGroup
    occ.addBox(-0.5, -0.5, 0.0, 1.0, 1.0, 0.2, PAD)
    occ.addBox(-0.9, -0.9, -1.0, 1.8, 1.8, 1.0, BLOCK)
    occ.synchronize()
    for body, tag, z in (PAD, UNDERSIDE, 0), (PAD, TOP, 0.2), (BLOCK, SEAT, 0), (BLOCK, BOTTOM, -1):
        sides = [side for _, side in gmsh.model.getBoundary([(3, body)], oriented=False)]
        flat = [s for s in sides if abs(occ.getCenterOfMass(2, s)[2] - z) < 1e-6]
        group(2, flat, tag)
    group(3, [PAD], PAD), group(3, [BLOCK], BLOCK)
    # 2. Tetrahedra of 0.15 mm. Nothing makes the nodes of the two bodies match.
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.15)
    gmsh.model.mesh.generate(3)


def main(folder="out/tutorial", comm=MPI.COMM_WORLD):
    # 3. From gmsh, on rank 0, to dolfinx. compat hides what differs between dolfinx's versions.
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    if comm.rank == 0:
        model()
    mesh, bodies, tags = compat.model_to_mesh(gmsh.model, comm, 0, gdim=3)
    gmsh.finalize()
    # 4. Elasticity as in any dolfinx script: first order, each body with its own modulus.
    V = compat.function_space(mesh, shape=(3,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    dx, ds = ufl.dx(subdomain_data=bodies), ufl.ds(subdomain_data=tags)
    eps = ufl.sym(ufl.grad(u))
    stress = (eps + NU / (1 - 2 * NU) * ufl.tr(eps) * ufl.Identity(3)) / (1 + NU)  # for E = 1
    a = sum(E[body] * ufl.inner(stress, ufl.grad(w)) * dx(body) for body in E)
    # 5. Load and supports: the pad's top is pressed and moved by `drag`, the bottom is held.
    L = -fem.Constant(mesh, PRESSURE) * w[2] * ds(TOP)
    drag, held, bcs = fem.Constant(mesh, 0.0), fem.Constant(mesh, 0.0), []
    for tag, k, value in (TOP, 0, drag), (TOP, 1, held), *((BOTTOM, k, held) for k in range(3)):
        dofs = fem.locate_dofs_topological(V.sub(k), 2, tags.find(tag))
        bcs.append(fem.dirichletbc(value, dofs, V.sub(k)))
    # 6. Contact: two tags and a law. Neither surface is master; their order does not matter.
    contact = llm.Interface(tags, (UNDERSIDE, SEAT), law=llm.Coulomb(MU))
    problem, shares = llm.ContactProblem(a, L, bcs=bcs, interfaces=[contact]), []
    # 7. Load steps: press, then drag until all slips. Each goes on from the one before.
    for drag.value in (0.0, 0.001, 0.004, 0.02):
        displacement = problem.solve()
        result = problem.results[0]  # forces at the contact frame's nodes, the same on every rank
        friction = np.linalg.norm(result.frame_friction, axis=1).sum()
        shares.append(friction / (MU * result.frame_force.sum()))
    # 8. Pictures of bodies and pressure as PNG, and files for ParaView.
    problem.plot(folder)
    llm.post.write_bodies(f"{folder}/bodies.pvd", displacement)
    if comm.rank == 0:
        llm.post.write_interface(folder, result)
        # 9. Against theory: the pad carries PRESSURE times 1 mm²; when all slips, the share is 1.
        force, pressure = -result.resultant[2], result.pressure.max()
        print(f"{problem}\n\nnormal force {force:.12g} N, pressure up to {pressure:.4g} N/mm²")
        print(f"friction over MU times normal force, by steps: {np.round(shares, 9).tolist()}")
    return result, shares


if __name__ == "__main__":
    main()
