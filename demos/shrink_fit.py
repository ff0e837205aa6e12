"""Shrink fit of two rings from a gmsh CAD model, against Lamé.

The inner ring is too large for the outer one by the interference δ. Both are drawn as they are
before assembly, so that they overlap; ``Tied(close_gap=True)`` closes the (negative) gap. Their
meshes do not match, and the facets of both are chords of different lengths: the chordal gaps,
h² / 8R, are of the size of δ.

    mpirun -n 2 python demos/shrink_fit.py [--refine N] [--dim 3] [--plot DIR]
"""

import argparse
from pathlib import Path

import gmsh
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat, post

# ## Two rings
# Millimetres and newtons; 2D: plane stress; 3D: a tube between rigid smooth plates, plane strain.
A, B, C, LENGTH = 50.0, 80.0, 120.0, 10.0
E, NU, DELTA = 210000.0, 0.3, 0.05
INNER, OUTER, BORE, INNER_FACE, OUTER_FACE = 1, 2, 11, 12, 13


def rings(comm, refine=1, dim=2, delta=DELTA, around=(16, 11), radial=(5, 6)):
    """Quarter of two rings that overlap by delta: mesh, cell tags, facet tags."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    if comm.rank == 0:
        occ = gmsh.model.occ
        radii = ((A, B + delta / 2), (B - delta / 2, C))
        counts = [(refine * n, refine * k) for n, k in zip(around, radial, strict=True)]
        for (low, high), (n, k) in zip(radii, counts, strict=True):
            points = [occ.addPoint(*p, 0) for p in ((low, 0), (high, 0), (0, high), (0, low))]
            centre = occ.addPoint(0, 0, 0)
            curves = [
                occ.addLine(points[0], points[1]),
                occ.addCircleArc(points[1], centre, points[2]),
                occ.addLine(points[2], points[3]),
                occ.addCircleArc(points[3], centre, points[0]),
            ]
            surface = occ.addPlaneSurface([occ.addCurveLoop(curves)])
            if dim == 3:
                layers = [refine * (3 if n == counts[0][0] else 2)]
                occ.extrude([(2, surface)], 0, 0, LENGTH, layers, recombine=True)
            occ.remove([(0, centre)])
            occ.synchronize()
            for curve, number in zip(curves, (k, n, k, n), strict=True):
                gmsh.model.mesh.setTransfiniteCurve(curve, number + 1)
            gmsh.model.mesh.setTransfiniteSurface(surface)
            gmsh.model.mesh.setRecombine(2, surface)
        tag_groups(dim, radii)
        gmsh.model.mesh.generate(dim)
    mesh = compat.model_to_mesh(gmsh.model, comm, 0, gdim=dim)
    gmsh.finalize()
    return mesh


def tag_groups(dim, radii):
    """Physical groups: bodies in the order they were made, arcs by the radius of a point."""
    model = gmsh.model
    faces = {INNER: {BORE: A, INNER_FACE: radii[0][1]}, OUTER: {OUTER_FACE: radii[1][0]}}
    for group, (_, body) in zip(faces, model.getEntities(dim), strict=True):
        model.addPhysicalGroup(dim, [body], group)
        for d, entity in model.getBoundary([(dim, body)], oriented=False):
            low, high = model.getParametrizationBounds(d, entity)
            points = [model.getValue(d, entity, p) for p in (low, (low + high) / 2)]
            x, y, _ = np.transpose(points)
            for tag, radius in faces[group].items():
                if np.allclose(np.hypot(x, y), radius, atol=1e-6):
                    model.addPhysicalGroup(d, [entity], tag)


# ## The problem
def stress(u):
    """Hooke's law: plane stress in 2D."""
    mu, lam = E / (2 * (1 + NU)), E * NU / (1 + NU) / (1 - (1 if len(u) == 2 else 2) * NU)
    eps = ufl.sym(ufl.grad(u))
    return 2 * mu * eps + lam * ufl.tr(eps) * ufl.Identity(len(u))


def von_mises(u):
    s, n = stress(u), len(u)
    rows = [[s[i, j] if max(i, j) < n else 0 for j in range(3)] for i in range(3)]
    return post.von_mises(ufl.as_tensor(rows))


def symmetry(V):
    """Sliding on the planes x = 0 and y = 0, and in 3D on both ends."""
    gdim = V.mesh.geometry.dim
    planes = [(0, 0.0), (1, 0.0), (2, 0.0), (2, LENGTH)][: 2 * gdim - 2]
    bcs = []
    for k, level in planes:
        Vk, _ = V.sub(k).collapse()
        where = (V.sub(k), Vk)
        dofs = fem.locate_dofs_geometrical(where, lambda p, k=k, x=level: np.isclose(p[k], x))
        bcs.append(fem.dirichletbc(fem.Function(Vk), dofs, V.sub(k)))
    return bcs


def problem(mesh, tags, close_gap=True, bore_pressure=0.0):
    V = compat.function_space(mesh, shape=(mesh.geometry.dim,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    law = llm.Tied(close_gap=close_gap)
    return llm.ContactProblem(
        ufl.inner(stress(u), ufl.sym(ufl.grad(w))) * ufl.dx,
        ufl.inner(fem.Constant(mesh, np.zeros(mesh.geometry.dim)), w) * ufl.dx,
        bcs=symmetry(V),
        interfaces=[llm.Interface(tags, (INNER_FACE, OUTER_FACE), law=law)],
        nodal_loads=[llm.free_surface_load(V, tags, BORE, bore_pressure)],
    )


# ## Contact pressure against Lamé's
def lame(dim=2):
    p = E * DELTA * (B**2 - A**2) * (C**2 - B**2) / (2 * B**3 * (C**2 - A**2))
    return p if dim == 2 else p / (1 - NU**2)


def pressures(contact):
    """Pressure at the frame's nodes, (L_bᵀ λ)_J / a_J, and at the nodes of both sides."""
    found = {}
    for k, (side, pairs) in enumerate(
        zip(contact.results[0].sides, contact.geometries[0].pairs, strict=True)
    ):
        found[f"frame, from side {k}"] = (pairs.N.T @ side.normal_force) / (pairs.N.T @ side.area)
        found[f"nodes of side {k}"] = side.normal_force / side.area
    return found


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--refine", type=int, default=1, metavar="N")
    parser.add_argument("--dim", type=int, choices=(2, 3), default=2)
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    comm = MPI.COMM_WORLD
    mesh, _, tags = rings(comm, args.refine, args.dim)
    contact = problem(mesh, tags)
    u, exact = contact.solve(), lame(args.dim)
    found = pressures(contact)
    if comm.rank == 0:
        print(f"{contact}\n\ncontact pressure, Lamé: {exact:.4f}\n{'':<22}mean     off    off, max")
        for name, p in found.items():
            off, most = p.mean() / exact - 1, np.abs(p / exact - 1).max()
            print(f"{name:<18}{p.mean():8.4f} {off:8.3%} {most:8.3%}")
    if args.plot:
        from dolfinx_llm import plot

        path = args.plot / "shrink_fit.png"
        plot.bodies(u, von_mises(u), path, label="von Mises", scale=1.0)
    return {"exact": exact, "pressures": found, "certificate": contact.geometries[0].certificate}


if __name__ == "__main__":
    main()
