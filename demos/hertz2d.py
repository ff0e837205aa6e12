"""Hertz's line contact: two cylinders, or one on a rigid plane.

Half discs in plane strain, pressed by a uniform pressure on their diameters. Peak pressure and
half-width are read from a fit of p² = p0² - (p0 / a)² x² where the pressure is high: it uses all
nodes there, where an edge found by "the last node that presses" is known to one element only.

Hertz takes the bodies for half-spaces. What discs differ by goes with the load: ``--load 0.25``
tells it from the error of the mesh. At full load it is -0.15 % of the peak and +0.19 % of the
half-width, on the rigid plane a fifth of that (32 elements, ``--growth 0.03``).

    mpirun -n 2 python demos/hertz2d.py [--scene plane] [--elements 32 47] [--plot DIR] ...
"""

import argparse
import json
from pathlib import Path

import gmsh
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

R, E, NU = 8.0, 200.0, 0.3
LOAD = {"cylinders": 10.0, "plane": 3.2032}  # per unit of thickness
CONTACT, DIAMETER = 1, 2
REACH = 1.3  # half-widths: how far from the middle the surfaces may touch


def hertz(scene, load=1.0):
    """Half-width a and peak pressure p0 of a line contact."""
    bodies = 2 if scene == "cylinders" else 1
    P, modulus, radius = load * LOAD[scene], E / (1 - NU**2) / bodies, R / bodies
    a = np.sqrt(4 * P * radius / (np.pi * modulus))
    return a, 2 * P / (np.pi * a)


def graded(curves, finest, growth):
    """Sizes of elements of the gmsh model: finest at curves, larger by growth times distance."""
    field = gmsh.model.mesh.field
    near, size = field.add("Distance"), field.add("Threshold")
    field.setNumbers(near, "EdgesList", curves)
    field.setNumber(near, "NNodesByEdge", 200)
    for name, value in {
        "IField": near, "LcMin": finest, "LcMax": finest + growth * R, "DistMin": 0.0, "DistMax": R,
    }.items():  # fmt: skip
        field.setNumber(size, name, value)
    field.setAsBackgroundMesh(size)
    gmsh.option.setNumber("Mesh.CharacteristicLengthExtendFromBoundary", 0)


# ## A half disc that touches (0, 0) from above (up = 1) or below (-1)
def half_disc(comm, a, n, up, growth=0.06, degree=1):
    """Mesh of first or second order and facet tags; n elements over the half-width a, larger by
    growth times distance."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    if comm.rank == 0:
        geo, mesh = gmsh.model.geo, gmsh.model.mesh
        at = [(s * np.sin(t) * R, up * R * (1 - np.cos(t))) for s in (-1, 1)
              for t in (REACH * a / R, np.pi / 2)]  # fmt: skip
        left, far_left, right, far_right = (geo.addPoint(x, y, 0) for x, y in at)
        bottom, centre = geo.addPoint(0, 0, 0), geo.addPoint(0, up * R, 0)
        contact = [geo.addCircleArc(bottom, centre, end) for end in (left, right)]
        sides = [geo.addCircleArc(*arc) for arc in
                 ((left, centre, far_left), (right, centre, far_right))]  # fmt: skip
        diameter = [geo.addLine(end, centre) for end in (far_left, far_right)]
        axis = geo.addLine(centre, bottom)
        loops = [[contact[k], sides[k], diameter[k], axis] for k in (0, 1)]
        surfaces = [geo.addPlaneSurface([geo.addCurveLoop(loop)]) for loop in loops]
        geo.synchronize()
        for arc in contact:
            mesh.setTransfiniteCurve(arc, round(REACH * n) + 1)
        graded(contact, a / n, growth)
        for curves, tag in ((contact, CONTACT), (diameter, DIAMETER)):
            gmsh.model.addPhysicalGroup(1, curves, tag)
        gmsh.model.addPhysicalGroup(2, surfaces, 3)
        mesh.generate(2)
        mesh.setOrder(degree)
    domain, _, tags = compat.model_to_mesh(gmsh.model, comm, 0, gdim=2)
    gmsh.finalize()
    return domain, tags


# ## The problem
def stress(u):
    """Hooke's law in plane strain."""
    eps = ufl.sym(ufl.grad(u))
    return E / (1 + NU) * (eps + NU / (1 - 2 * NU) * ufl.tr(eps) * ufl.Identity(2))


def hold(V, k, where):
    """Component k is zero where ``where`` holds."""
    Vk, _ = V.sub(k).collapse()
    dofs = fem.locate_dofs_geometrical((V.sub(k), Vk), where)
    return fem.dirichletbc(fem.Function(Vk), dofs, V.sub(k))


def problem(scene, elements=(16, 23), load=1.0, growth=0.06, order=(0, 1), comm=MPI.COMM_WORLD,
            design="auto", degree=1, **options):  # fmt: skip
    """The contact problem; ``order`` of the sides, (0, 1): the upper disc first; ``degree`` of
    meshes and displacements."""
    a, _ = hertz(scene, load)
    ups = (1, -1) if scene == "cylinders" else (1,)
    discs = [half_disc(comm, a, n, up, growth, degree) for n, up in zip(elements, ups)]
    forms, loads, bcs = [], [], []
    for (domain, tags), up in zip(discs, ups):
        V = compat.function_space(domain, degree=degree, shape=(2,))
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
        p = fem.Constant(domain, load * LOAD[scene] / (2 * R))
        forms.append(ufl.inner(stress(u), ufl.grad(w)) * ufl.dx)
        loads.append(-up * p * w[1] * ds(DIAMETER))
        bcs.append(hold(V, 0, lambda x: np.isclose(x[0], 0.0)))
        if up < 0:  # both discs carry the load alike: this only stops them from floating away
            bcs.append(hold(V, 1, lambda x: np.isclose(x[0], 0.0) & np.isclose(x[1], -R)))
    sides = [(tags, CONTACT) for _, tags in discs]
    if scene == "plane":
        sides.append(llm.RigidPlane((0.0, 0.0), (0.0, 1.0)))
    sides = tuple(sides[i] for i in order)
    interface = llm.Interface(None, sides, law=llm.Frictionless(), design=design)
    return llm.ContactProblem(forms, loads, bcs=bcs, interfaces=[interface], **options)


# ## Peak pressure and half-width
def fit(x, p):
    """p0 and a by least squares of p² = p0² - (p0 / a)² x² where p > 0.4 p0, |x| < 0.9 a."""
    inner = p > 0.4 * p.max()
    top, slope = np.linalg.lstsq(
        np.column_stack([np.ones(inner.sum()), -(x[inner] ** 2)]), p[inner] ** 2, rcond=None
    )[0]
    return np.sqrt(top), np.sqrt(top / slope)


def averages(x, function, points=20001):
    """What nodal forces over areas hold: averages of a function over the nodes' hats at x (n,)."""
    s, order = np.linspace(x.min(), x.max(), points), np.argsort(x)
    value, k = function(s), np.clip(np.searchsorted(x[order], s, "right") - 1, 0, len(x) - 2)
    t = (s - x[order][k]) / np.diff(x[order])[k]
    found = np.empty(len(x))
    total, weight = (
        np.bincount(k, f * (1 - t), len(x)) + np.bincount(k + 1, f * t, len(x))
        for f in (value, np.ones(points))
    )
    found[order] = total / weight
    return found


def figures(contact, a, p0):
    """Pressure at the frame and at each side's nodes against Hertz: ratios to theory."""
    result = contact.results[0]
    at = {"frame": (result.x[:, 0], result.pressure)}
    for k, side in enumerate(result.sides):
        at[f"nodes of side {k}"] = (side.x[:, 0], side.normal_force / side.area)
    rows = {}
    for name, (x, p) in at.items():
        exact = averages(x, lambda s: p0 * np.sqrt(np.maximum(1 - (s / a) ** 2, 0.0)))
        peak, width = fit(x, p)
        rows[name] = {
            "peak": peak / p0, "half-width": width / a, "largest": p.max() / p0,
            "L2 error": np.linalg.norm(p - exact) / np.linalg.norm(exact),
        }  # fmt: skip
    return rows


def picture(contact, a, p0, path):
    result, x = contact.results[0], np.linspace(-1, 1, 400)
    lines = [("Hertz", "k-", x, np.sqrt(1 - x**2))]
    for k, side in enumerate(result.sides):
        p = side.normal_force / side.area
        lines.append((f"nodes of side {k}", f"C{k}.", side.x[:, 0] / a, p / p0))
    lines.append(("frame", "k+", result.x[:, 0] / a, result.pressure / p0))
    plot.curves(lines, path, xlabel="x / a", ylabel="p / p0")


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", choices=list(LOAD), default="cylinders")
    parser.add_argument("--elements", type=int, nargs=2, default=(16, 23), metavar="N")
    parser.add_argument("--load", type=float, default=1.0, help="factor on the load")
    parser.add_argument("--growth", type=float, default=0.06, help="of the elements' size")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    a, p0 = hertz(args.scene, args.load)
    contact = problem(args.scene, args.elements, args.load, args.growth)
    contact.solve()
    rows = figures(contact, a, p0)
    if MPI.COMM_WORLD.rank == 0:
        print(f"{contact}\n\n{len(contact.history)} iterations; a = {a:.5f}, p0 = {p0:.4f} (Hertz)")
        print(f"{'over Hertz':18}" + "".join(f"{name:>12}" for name in rows["frame"]))
        for name, row in rows.items():
            print(f"{name:18}" + "".join(f"{value:12.5f}" for value in row.values()))
        if args.json:
            args.json.write_text(json.dumps({"a": a, "p0": p0, "rows": rows}) + "\n")
    if args.plot:
        picture(contact, a, p0, args.plot / f"hertz2d_{args.scene}.png")
    return contact, rows


if __name__ == "__main__":
    main()
