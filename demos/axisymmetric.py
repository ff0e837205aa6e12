"""Axisymmetric bodies: forms over 2 pi r, and interfaces whose areas know it.

Hertz's point contact of two balls in their half sections, r = x[0] and z = x[1], meshes that do not
match, pressed by a uniform pressure on their equators. Peak pressure and radius are read as in
hertz2d. Without ``thickness`` areas would count by length, and a constant pressure would not pass:
``--patch`` presses two cylinders on each other, which must be stressed evenly, both ways.

    mpirun -n 2 python demos/axisymmetric.py [--elements 16 23] [--patch] [--plot DIR]
"""

import argparse
import json
from pathlib import Path

import gmsh
import numpy as np
import ufl
from dolfinx import fem, mesh
from hertz2d import CONTACT, DIAMETER, NU, REACH, E, R, fit, graded, hold
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

LOAD = 2.0  # force between the balls
RADIUS = (0.75 * LOAD * (R / 2) * 2 * (1 - NU**2) / E) ** (1 / 3)  # Hertz
PEAK = 1.5 * LOAD / (np.pi * RADIUS**2)


def around(x):
    """Thickness at positions (n, 2)."""
    return 2.0 * np.pi * x[:, 0]


def elasticity(V):
    """Form a of an axisymmetric body, and what multiplies tractions and loads: 2 pi r."""
    r = ufl.SpatialCoordinate(V.mesh)[0]
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)

    def strain(v):
        e = ufl.sym(ufl.grad(v))
        return ufl.as_tensor([[e[0, 0], e[0, 1], 0], [e[1, 0], e[1, 1], 0], [0, 0, v[0] / r]])

    e = strain(u)
    stress = E / (1 + NU) * (e + NU / (1 - 2 * NU) * ufl.tr(e) * ufl.Identity(3))
    return ufl.inner(stress, strain(w)) * 2 * np.pi * r * ufl.dx(degree=4), 2 * np.pi * r


# ## Half of a half ball that touches (0, 0) from above (up = 1) or below (-1)
def quarter(comm, n, up, growth=0.06):
    """Mesh and facet tags; n elements over the radius of contact, growing with the distance."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    if comm.rank == 0:
        geo, own = gmsh.model.geo, gmsh.model.mesh
        at = [(np.sin(t) * R, up * R * (1 - np.cos(t))) for t in (REACH * RADIUS / R, np.pi / 2)]
        near, far, pole, centre = (geo.addPoint(*x, 0) for x in (*at, (0, 0), (0, up * R)))
        contact, rest = geo.addCircleArc(pole, centre, near), geo.addCircleArc(near, centre, far)
        equator, axis = geo.addLine(far, centre), geo.addLine(centre, pole)
        face = geo.addPlaneSurface([geo.addCurveLoop([contact, rest, equator, axis])])
        geo.synchronize()
        own.setTransfiniteCurve(contact, round(REACH * n) + 1)
        graded([contact], RADIUS / n, growth)
        for curve, tag in ((contact, CONTACT), (equator, DIAMETER)):
            gmsh.model.addPhysicalGroup(1, [curve], tag)
        gmsh.model.addPhysicalGroup(2, [face], 3)
        own.generate(2)
    domain, _, tags = compat.model_to_mesh(gmsh.model, comm, 0, gdim=2)
    gmsh.finalize()
    return domain, tags


def cylinder(comm, n, up):
    """The same of a cylinder of radius and height 1."""
    ends = np.sort([[0.0, 0.0], [1.0, float(up)]], axis=0)
    domain = mesh.create_rectangle(comm, list(ends), [n, n])
    of = [(mesh.locate_entities_boundary(domain, 1, lambda x, z=z: np.isclose(x[1], z)), tag)
          for z, tag in ((0.0, CONTACT), (float(up), DIAMETER))]  # fmt: skip
    facets = np.concatenate([f for f, _ in of])
    values = np.concatenate([np.full(len(f), tag, dtype=np.int32) for f, tag in of])
    order = np.argsort(facets)
    return domain, mesh.meshtags(domain, 1, facets[order], values[order])


def pressed(make, elements, pressure, height, thickness=around, comm=MPI.COMM_WORLD):
    """Two bodies that touch at z = 0; the lower one stands on z = -height."""
    forms, loads, bcs, sides = [], [], [], []
    for n, up in zip(elements, (1, -1), strict=True):
        domain, tags = make(comm, n, up)
        V = compat.function_space(domain, shape=(2,))
        a, t = elasticity(V)
        ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
        q = fem.Constant(domain, pressure if up > 0 else 0.0)
        forms.append(a)
        loads.append(-q * ufl.TestFunction(V)[1] * t * ds(DIAMETER))
        bcs.append(hold(V, 0, lambda x: np.isclose(x[0], 0.0)))
        if up < 0:
            bcs.append(hold(V, 1, lambda x: np.isclose(x[1], -height)))
        sides.append((tags, CONTACT))
    interface = llm.Interface(None, tuple(sides), law=llm.Frictionless(), thickness=thickness)
    return llm.ContactProblem(forms, loads, bcs=bcs, interfaces=[interface])


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--elements", type=int, nargs=2, default=(16, 23), metavar="N")
    parser.add_argument("--patch", action="store_true", help="cylinders in the place of balls")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    found = {}
    if args.patch:
        for name, thickness in (("2 pi r", around), ("none", 1.0)):
            contact = pressed(cylinder, args.elements, 1.0, 1.0, thickness)
            contact.solve()
            result = contact.results[0]
            off = result.x[:, 0] > 0.0  # where forces per length of the section tell a pressure
            density = result.pressure / (1.0 if callable(thickness) else around(result.x) + ~off)
            found[name] = float(np.abs(density - 1.0)[off].max())
    else:
        contact = pressed(quarter, args.elements, LOAD / (np.pi * R**2), R)
        contact.solve()
        result = contact.results[0]
        peak, radius = fit(result.x[:, 0], result.pressure)
        found = {"peak": peak / PEAK, "radius": radius / RADIUS}
    if MPI.COMM_WORLD.rank == 0:
        what = "thickness; error of the contact pressure" if args.patch else "over Hertz"
        print(f"{contact}\n\n{what}", *(f"{k:10} {v:.5g}" for k, v in found.items()), sep="\n")
        if args.json:
            args.json.write_text(json.dumps(found) + "\n")
    if args.plot and not args.patch:
        s = np.linspace(0, 1, 400)
        lines = [("Hertz", "k-", s, np.sqrt(1 - s**2)),
                 ("frame", "C0.", result.x[:, 0] / RADIUS, result.pressure / PEAK)]  # fmt: skip
        plot.curves(lines, args.plot / "axisymmetric.png", xlabel="r / a", ylabel="p / p0")
    return contact, found


if __name__ == "__main__":
    main()
