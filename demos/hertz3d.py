"""Hertz's point contact in 3D: a spherical end on a rigid plane or on an elastic block, and a rigid
sphere on a block.

Quarters of blocks, bricks graded towards the contact. Peak pressure and radius are read from a fit
of p² = p0² - (p0 / a)² r², as in ``hertz2d.py``. Blocks are 10 a wide and high: what they differ
from half-spaces by falls with (a / width)³ where the load is given. Where the depth is given, as
for the rigid sphere, it falls with a / width only: there Boussinesq's displacements hold the block.
The rigid sphere's load is 2.3 % above Hertz's at a / R = 0.1, 0.8 % at 0.025: contact is found
along the sphere's own normals, Hertz leaves the slope of the surface out.

    mpirun -n 2 python demos/hertz3d.py [--scene block] [--elements 9 13] [--plot DIR] ...
"""

import argparse
import json
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from hertz2d import fit, hold
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

CONTACT, FAR = 1, 2
# Radius, E, nu, contact radius a; "sphere" is the rigid one on a block, pressed in by a² / R.
SCENES = {
    "plane": (8.0, 200.0, 0.3, 0.2), "block": (8.0, 200.0, 0.3, 0.2),
    "sphere": (1.0, 1.40625e7, 0.25, 0.1),
}  # fmt: skip


def hertz(scene):
    """E*, load P and peak pressure p0."""
    R, E, nu, a = SCENES[scene]
    modulus = E / (1 - nu**2) / (2 if scene == "block" else 1)
    P = 4 * modulus * a**3 / (3 * R)
    return modulus, P, 3 * P / (2 * np.pi * a**2)


# ## Quarter of a block with a flat or spherical end at z = 0
def axis(h, uniform, length, growth):
    """Nodes from 0 to length: steps of h up to ``uniform``, then growing."""
    steps = np.full(round(uniform / h), uniform / round(uniform / h))
    k = np.arange(1, 100)
    far = h * np.cumsum(growth**k)
    far = far[: np.searchsorted(far, length - uniform) + 1]
    return np.concatenate([[0.0], np.cumsum(steps), uniform + far / far[-1] * (length - uniform)])


def block(comm, a, n, up, radius=None, width=10.0, growth=1.25):
    """Mesh and facet tags; n elements over a, ``width`` in a; up: +1 above z = 0, -1 below."""
    x = axis(a / n, 1.3 * a, width * a, growth)
    z = axis(a / n, 0.3 * a, width * a, growth)
    points = np.stack(np.meshgrid(x, x, z, indexing="ij"), axis=-1).reshape(-1, 3)
    node = np.arange(len(points)).reshape(len(x), len(x), len(z))
    corner = [slice(0, -1), slice(1, None)]
    cells = [node[i, j, k].ravel() for k in corner for j in corner for i in corner]
    if up < 0:  # mirrored: the other order keeps the volumes positive
        cells = cells[4:] + cells[:4]
    points[:, 2] *= up
    rank0 = None if comm.rank == 0 else 0
    domain = compat.create_mesh(comm, np.stack(cells, 1)[:rank0], points[:rank0], "hexahedron")
    flat = mesh.locate_entities_boundary(
        domain, 2, lambda p: np.isclose(p[2], 0) & (p[:2].max(axis=0) < 1.3001 * a)
    )
    far = mesh.locate_entities_boundary(domain, 2, lambda p: np.isclose(p[2], up * width * a))
    values = np.repeat([CONTACT, FAR], [len(flat), len(far)]).astype(np.int32)
    facets = np.concatenate([flat, far])
    order = np.argsort(facets)
    tags = mesh.meshtags(domain, 2, facets[order], values[order])
    if radius:
        p = domain.geometry.x
        lift = radius - np.sqrt(radius**2 - np.minimum(p[:, 0] ** 2 + p[:, 1] ** 2, radius**2 / 4))
        p[:, 2] += up * lift * (1 - np.abs(p[:, 2]) / (width * a))
    return domain, tags


# ## The problem
def stress(u, E, nu):
    eps = ufl.sym(ufl.grad(u))
    return E / (1 + nu) * (eps + nu / (1 - 2 * nu) * ufl.tr(eps) * ufl.Identity(3))


def boussinesq(x, P, E, nu):
    """Displacement (3, n) of the half-space z < 0 under the force P along -z at the origin."""
    rho, depth = np.linalg.norm(x, axis=0), -x[2]
    c = (1 + nu) * P / (2 * np.pi * E)
    side = c * (depth / rho**3 - (1 - 2 * nu) / (rho * (rho + depth)))
    return np.stack([side * x[0], side * x[1], -c * (2 * (1 - nu) / rho + depth**2 / rho**3)])


def problem(
    scene, elements=(4, 6), order=(0, 1), width=10.0, growth=1.25, comm=MPI.COMM_WORLD, **options
):
    """The contact problem, with ``options`` of ``ContactProblem``; ``order`` of the sides, (0, 1):
    the upper one first."""
    R, E, nu, a = SCENES[scene]
    _, P, _ = hertz(scene)
    ups = {"plane": (1,), "block": (1, -1), "sphere": (-1,)}[scene]
    forms, loads, bcs, sides = [], [], [], []
    for up, n in zip(ups, elements):
        domain, tags = block(comm, a, n, up, R if up > 0 else None, width, growth)
        V = compat.function_space(domain, shape=(3,))
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
        p = fem.Constant(domain, P / (2 * width * a) ** 2 if up > 0 else 0.0)
        forms.append(ufl.inner(stress(u, E, nu), ufl.grad(w)) * ufl.dx)
        loads.append(-p * w[2] * ds(FAR))
        bcs += [hold(V, k, lambda x, k=k: np.isclose(x[k], 0.0)) for k in (0, 1)]
        if scene == "sphere":
            far = fem.Function(V)
            far.interpolate(lambda x: boussinesq(x + 1e-30, P, E, nu) if x.size else 0.0 * x)
            at = lambda x: np.abs(x).max(axis=0) > 0.9999 * width * a  # noqa: E731
            bcs.append(fem.dirichletbc(far, fem.locate_dofs_geometrical(V, at)))
        elif up < 0:
            bcs.append(hold(V, 2, lambda x: np.isclose(x[2], -width * a)))
        sides.append((tags, CONTACT))
    if scene == "plane":
        sides.append(llm.RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    if scene == "sphere":
        sides.insert(0, llm.RigidSphere((0.0, 0.0, R - a**2 / R), R))
    interface = llm.Interface(None, tuple(sides[i] for i in order), law=llm.Frictionless())
    return llm.ContactProblem(forms, loads, bcs=bcs, interfaces=[interface], **options)


def figures(contact, scene):
    """Peak pressure, radius and load over Hertz's, from the frame and from each side's nodes."""
    a, (_, P, p0) = SCENES[scene][3], hertz(scene)
    result = contact.results[0]
    at = {"frame": (result.x, result.pressure)}
    for k, side in enumerate(result.sides):
        at[f"nodes of side {k}"] = (side.x, side.normal_force / side.area)
    rows = {}
    for name, (x, p) in at.items():
        peak, radius = fit(np.hypot(x[:, 0], x[:, 1]), p)
        rows[name] = {
            "peak": peak / p0, "radius": radius / a, "largest": p.max() / p0,
            "load": 4 * abs(result.resultant[2]) / P,
        }  # fmt: skip
    return rows


def picture(contact, scene, path):
    a, (_, _, p0) = SCENES[scene][3], hertz(scene)
    result, r = contact.results[0], np.linspace(0, 1, 300)
    lines = [("Hertz", "k-", r, np.sqrt(1 - r**2))]
    for k, side in enumerate(result.sides):
        p = side.normal_force / side.area / p0
        lines.append((f"nodes of side {k}", f"C{k}.", np.hypot(*side.x[:, :2].T) / a, p))
    lines.append(("frame", "k+", np.hypot(*result.x[:, :2].T) / a, result.pressure / p0))
    plot.curves(lines, path, xlabel="r / a", ylabel="p / p0")


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", choices=list(SCENES), default="plane")
    parser.add_argument("--elements", type=int, nargs=2, default=(4, 6), metavar="N")
    parser.add_argument("--width", type=float, default=10.0, help="of the blocks, in a")
    parser.add_argument("--growth", type=float, default=1.25, help="of the elements")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    contact = problem(args.scene, args.elements, width=args.width, growth=args.growth)
    contact.solve()
    rows = figures(contact, args.scene)
    if MPI.COMM_WORLD.rank == 0:
        print(f"{contact}\n\n{len(contact.history)} iterations")
        print(f"{'over Hertz':18}" + "".join(f"{name:>12}" for name in rows["frame"]))
        for name, row in rows.items():
            print(f"{name:18}" + "".join(f"{value:12.5f}" for value in row.values()))
        if args.json:
            args.json.write_text(json.dumps({"rows": rows, "unknowns": contact.unknowns}) + "\n")
    if args.plot:
        picture(contact, args.scene, args.plot / f"hertz3d_{args.scene}.png")
    return contact, rows


if __name__ == "__main__":
    main()
