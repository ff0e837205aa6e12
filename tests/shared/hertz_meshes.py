"""Hertz's contacts on other meshes than the demos': discs of quads, and a quarter of a body with a
spherical end of tetrahedra, all by gmsh and curved where they are of second order."""

import gmsh
import hertz2d
import hertz3d
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from scipy.optimize import brentq

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM, BOX, REACH = MPI.COMM_SELF, 10.0, 1.3  # BOX: the ball's width and height over a


def _graded(first, length, growth):
    """Number of steps from a first one to a length, and the factor between them."""
    n = int(np.ceil(np.log(1.0 + length * (growth - 1.0) / first) / np.log(growth)))
    return n, brentq(lambda q: first * (q**n - 1.0) / (q - 1.0) - length, 1.0001, 3.0)


def disc_of_quads(comm, a, n, up, growth=1.2, degree=2):
    """As ``hertz2d.half_disc``, in patches of quads; n along a, larger by the factor ``growth``."""
    R, t = hertz2d.R, hertz2d.REACH * a / hertz2d.R
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    geo, mesh = gmsh.model.geo, gmsh.model.mesh

    def on(angle):
        return geo.addPoint(np.sin(angle) * R, up * R * (1.0 - np.cos(angle)), 0)

    bottom, centre = on(0.0), geo.addPoint(0, up * R, 0)
    axis, across = geo.addLine(bottom, centre), _graded(a / n, R, growth)
    away = _graded(a / n, R * (np.pi / 4 - t), growth)
    contact, diameter, faces, counts = [], [], [], [(axis, *across)]
    for s in (-1, 1):
        end, half, far = on(s * t), on(s * np.pi / 4), on(s * np.pi / 2)
        top = geo.addPoint(s * R / 2, up * R, 0)
        ends = (bottom, end), (end, half), (half, far)
        arcs = [geo.addCircleArc(p, centre, q) for p, q in ends]
        lines = [geo.addLine(p, q) for p, q in ((end, top), (centre, top), (top, far))]
        for loop in ([arcs[0], lines[0], -lines[1], -axis], [*arcs[1:], -lines[2], -lines[0]]):
            faces.append(geo.addPlaneSurface([geo.addCurveLoop(loop)]))
        contact.append(arcs[0])
        diameter += lines[1:]
        width = round(hertz2d.REACH * n)
        counts += [(arcs[0], width, 1.0), (lines[1], width, 1.0), (lines[0], *across)]
        counts += [(arcs[1], *away), (lines[2], away[0], 1.1), (arcs[2], across[0], 1.0)]
    geo.synchronize()
    for curve, k, factor in counts:
        mesh.setTransfiniteCurve(curve, k + 1, "Progression", factor)
    for face in faces:
        mesh.setTransfiniteSurface(face)
        mesh.setRecombine(2, face)
    for tag, curves in ((hertz2d.CONTACT, contact), (hertz2d.DIAMETER, diameter)):
        gmsh.model.addPhysicalGroup(1, curves, tag)
    gmsh.model.addPhysicalGroup(2, faces, 3)
    return _read(2, degree, comm)


def ball(n, degree, growth):
    """Quarter of a block with a spherical end at the origin, on z > 0; n cells over a, larger by
    ``growth`` times the distance. The end has the tag 1, the top 2."""
    R, _, _, a = hertz3d.SCENES["plane"]
    W = BOX * a
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ, mesh = gmsh.model.occ, gmsh.model.mesh
    body = [(3, occ.addBox(0, 0, -1, W, W, W + 1))]
    body, _ = occ.intersect(body, [(3, occ.addSphere(0, 0, R, R))])
    core = [(3, occ.addCylinder(0, 0, -0.5, 0, 0, 0.5 + 0.5 * a, REACH * a, angle=np.pi / 2))]
    core, _ = occ.intersect(core, body, removeTool=False)
    occ.fragment(body, core)
    occ.synchronize()
    end, top = [], []
    for dim, face in gmsh.model.getEntities(2):
        box = np.array(gmsh.model.getBoundingBox(dim, face)).reshape(2, 3)
        if box[1, :2].max() < 1.01 * REACH * a and box[1, 2] < 0.02 * a * REACH**2:
            end.append(face)
        if box[0, 2] > 0.99 * W:
            top.append(face)
    assert len(end) == len(top) == 1
    for tag, faces in ((hertz3d.CONTACT, end), (hertz3d.FAR, top)):
        gmsh.model.addPhysicalGroup(2, faces, tag)
    gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)], 3)
    for name in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
        gmsh.option.setNumber(f"Mesh.MeshSize{name}", 0)
    size, away = mesh.field.add("MathEval"), f"(sqrt(x*x+y*y+z*z)-{REACH * a})"
    mesh.field.setString(size, "F", f"{a / n}+{0.5 * growth}*({away}+fabs({away}))")
    mesh.field.setAsBackgroundMesh(size)
    return _read(3, degree, COMM)


def _read(gdim, degree, comm):
    gmsh.model.mesh.generate(gdim)
    gmsh.model.mesh.setOrder(degree)
    domain, _, tags = compat.model_to_mesh(gmsh.model, comm, 0, gdim=gdim)
    gmsh.finalize()
    return domain, tags


def ball_on_plane(n, degree, growth):
    """The ball pressed on a rigid plane."""
    _, E, nu, a = hertz3d.SCENES["plane"]
    domain, tags = ball(n, degree, growth)
    V = compat.function_space(domain, degree=degree, shape=(3,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
    p = fem.Constant(domain, hertz3d.hertz("plane")[1] / (2.0 * BOX * a) ** 2)
    bcs = [hertz2d.hold(V, k, lambda x, k=k: np.isclose(x[k], 0.0, atol=1e-9)) for k in (0, 1)]
    plane = llm.RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    interface = llm.Interface(tags, (hertz3d.CONTACT, plane), law=llm.Frictionless())
    a = ufl.inner(hertz3d.stress(u, E, nu), ufl.grad(w)) * ufl.dx
    return llm.ContactProblem(a, -p * w[2] * ds(hertz3d.FAR), bcs=bcs, interfaces=[interface])


def ball_errors(problem):
    """Of peak and radius, by ``fit`` inside 0.9 a, and of the pressure in L2 over its facets."""
    a, p0 = hertz3d.SCENES["plane"][3], hertz3d.hertz("plane")[2]
    (side,), (pairs,) = problem.results[0].sides, problem.geometries[0].pairs
    p = side.normal_force / side.area
    if side.density is not None:
        p = np.einsum("ni,ni->n", side.density, side.normal)
    p, x = p / p0, side.x / a
    r = np.hypot(x[:, 0], x[:, 1])
    peak, radius = hertz2d.fit(r[r < 0.9], p[r < 0.9])
    s = np.arange(0.5, 12.0) / 12.0
    xi = np.stack(np.meshgrid(s, s), axis=-1).reshape(-1, 2)
    N, _ = pairs.surface.element.shape(xi[xi.sum(axis=1) < 1.0])
    corners = x[pairs.facets]
    area = np.linalg.norm(np.cross(*(corners[:, 1:] - corners[:, :1]).transpose(1, 0, 2)), axis=1)
    at = np.einsum("gk,mki->mgi", N, x[pairs.cells])
    exact = np.sqrt(np.maximum(1.0 - (at[..., :2] ** 2).sum(axis=2), 0.0))
    off = area @ ((p[pairs.cells] @ N.T - exact) ** 2).sum(axis=1)
    return abs(peak - 1.0), abs(radius - 1.0), np.sqrt(off / (area @ (exact**2).sum(axis=1)))
