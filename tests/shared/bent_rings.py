"""A ring in a ring, of second order on curved second-order meshes, with a smooth answer."""

import gmsh
import numpy as np
import second_order_blocks as so
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM = MPI.COMM_SELF


def ring(n, low, high, first, order=2, tag=1, layers=0, height=1.0, hexahedra=True):
    """A mesh, at second order a curved one, of a closed ring, n cells around from an angle on; its
    inner circle has the tag given, the outer one the next. With layers it is a closed tube of a
    height, of hexahedra or of tetrahedra."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    geo, make, around = gmsh.model.geo, gmsh.model.mesh, range(4)
    centre, angles = geo.addPoint(0, 0, 0), first + np.arange(4) * np.pi / 2
    x = [[geo.addPoint(r * np.cos(t), r * np.sin(t), 0) for t in angles] for r in (low, high)]
    arcs = [[geo.addCircleArc(p[i], centre, p[(i + 1) % 4]) for i in around] for p in x]
    lines = [geo.addLine(*ends) for ends in zip(*x, strict=True)]
    loops = [
        geo.addCurveLoop([arcs[0][i], lines[(i + 1) % 4], -arcs[1][i], -lines[i]]) for i in around
    ]
    bodies = [geo.addPlaneSurface([loop]) for loop in loops]
    for curves, k in ((sum(arcs, []), n // 4), (lines, n // 8)):
        for curve in curves:
            geo.mesh.setTransfiniteCurve(curve, k + 1)
    for face in bodies:
        geo.mesh.setTransfiniteSurface(face)
    gdim, sides = 2, arcs
    if layers:
        for face in bodies if hexahedra else ():
            geo.mesh.setRecombine(2, face)
        made = [
            geo.extrude([(2, face)], 0, 0, height, numElements=[layers], recombine=hexahedra)
            for face in bodies
        ]
        bodies = [of[1][1] for of in made]
        gdim, sides = 3, [[of[i][1] for of in made] for i in (2, 4)]
    geo.synchronize()
    for k, entities in enumerate(sides, tag):
        gmsh.model.addPhysicalGroup(gdim - 1, entities, k)
    gmsh.model.addPhysicalGroup(gdim, bodies, 3)
    make.generate(gdim)
    make.setOrder(order)
    domain, _, tags = compat.model_to_mesh(gmsh.model, COMM, 0, gdim=gdim)
    gmsh.finalize()
    return domain, tags


def shell(h, low, high, tag=1, order=2):
    """A mesh, at second order a curved one, of tetrahedra of size h of a quarter of a tube; its
    inner surface has the tag given, the outer one the next, all others 9."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ, model = gmsh.model.occ, gmsh.model
    tubes = [(3, occ.addCylinder(0, 0, 0, 0, 0, 1, r, angle=np.pi / 2)) for r in (low, high)]
    occ.cut(tubes[1:], tubes[:1])
    occ.synchronize()
    faces = [tag for _, tag in model.getEntities(2)]
    round_ones = [tag for tag in faces if model.getType(2, tag) == "Cylinder"]
    round_ones.sort(key=lambda tag: model.getBoundingBox(2, tag)[3])
    for k, face in enumerate(round_ones, tag):
        model.addPhysicalGroup(2, [face], k)
    model.addPhysicalGroup(2, [face for face in faces if face not in round_ones], so.LATERAL)
    model.addPhysicalGroup(3, [tag for _, tag in model.getEntities(3)], 3)
    for name in ("Min", "Max"):
        gmsh.option.setNumber(f"Mesh.MeshSize{name}", h)
    model.mesh.generate(3)
    model.mesh.setOrder(order)
    domain, _, tags = compat.model_to_mesh(model, COMM, 0, gdim=3)
    gmsh.finalize()
    return domain, tags


def bricks(h, low, high, tag=1, order=2, gdim=3):
    """The same of hexahedra, in regular layers; or of quadrilaterals, of a quarter of a ring."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    geo, make = gmsh.model.geo, gmsh.model.mesh
    n = [round(length / h) for length in (high * np.pi / 2, high - low, 1.0)]
    centre = geo.addPoint(0, 0, 0)
    at = [geo.addPoint(*p, 0) for p in ((low, 0), (high, 0), (0, high), (0, low))]
    lines = [geo.addLine(at[0], at[1]), geo.addCircleArc(at[1], centre, at[2]),
             geo.addLine(at[2], at[3]), geo.addCircleArc(at[3], centre, at[0])]  # fmt: skip
    face = geo.addPlaneSurface([geo.addCurveLoop(lines)])
    for k, line in enumerate(lines):
        geo.mesh.setTransfiniteCurve(line, n[1 - k % 2] + 1)
    geo.mesh.setTransfiniteSurface(face)
    geo.mesh.setRecombine(2, face)
    body, around, ends = face, lines, []
    if gdim == 3:
        made = geo.extrude([(2, face)], 0, 0, 1, numElements=[n[2]], recombine=True)
        top, body, *around = [tag for _, tag in made]
        ends = [face, top]
    geo.synchronize()
    for k, faces in enumerate(([around[3]], [around[1]]), tag):
        gmsh.model.addPhysicalGroup(gdim - 1, faces, k)
    gmsh.model.addPhysicalGroup(gdim - 1, [*ends, around[0], around[2]], so.LATERAL)
    gmsh.model.addPhysicalGroup(gdim, [body], 3)
    make.generate(gdim)
    make.setOrder(order)
    domain, _, tags = compat.model_to_mesh(gmsh.model, COMM, 0, gdim=gdim)
    gmsh.finalize()
    return domain, tags


def tied(counts, first, make=llm.ContactProblem, degrees=(2, 2), close_gap=False, **chosen):
    """Two rings of so many cells around, the outer one turned by an angle, see ``joined``."""
    parts = zip(counts, degrees, ((1.0, 1.5, 0.0), (1.5, 2.0, first)), so.BOTTOM, strict=True)
    meshes = [ring(n, *low_high, degree, tag) for n, degree, low_high, tag in parts]
    return joined(meshes, degrees, make, close_gap, **chosen)


def tied_shells(sizes, make_mesh=shell, **chosen):
    """The same of two quarters of tubes, of cells of these sizes."""
    parts = zip(sizes, ((1.0, 1.5), (1.5, 2.0)), so.BOTTOM, strict=True)
    meshes = [make_mesh(h, *radii, tag) for h, radii, tag in parts]
    return joined(meshes, **chosen)


def joined(meshes, degrees=(2, 2), make=llm.ContactProblem, close_gap=False, **chosen):
    """Two bodies with the answer ``Waves``, prescribed on the inner- and outermost surface. More
    arguments are the interface's."""
    gdim = meshes[0][0].geometry.dim
    spaces = [
        compat.function_space(domain, degree=degree, shape=(gdim,))
        for degree, (domain, _) in zip(degrees, meshes, strict=True)
    ]
    interface = {"law": llm.Tied(close_gap=close_gap), **chosen}
    tags = [own for _, own in meshes]
    return so.manufactured_problem(spaces, tags, so.Waves(gdim), interface, 6, make=make)


def errors(problem, plain=False):
    """Relative errors in L2 and in the gradient, and of the tractions read, if any are; ``plain``:
    by nothing but the integrals of the shape functions' products."""
    u = problem.solve()
    field = so.Waves(u[0].function_space.mesh.geometry.dim)
    found, result = so.errors(u, field), problem.results[0]
    read = all(getattr(side, "density", None) is not None for side in result.sides)
    geometry = problem.geometries[0] if plain else None
    return np.array([*found, *(so.traction_errors(result, field, geometry) if read else [])])
