"""The contact patch test at finite deformation: exact in the deformed state.

Two neo-Hookean bodies whose meshes do not match, a punch on a wider foundation, in plane strain, or
in 3D held along y. A pressure follows all that looks up and is free, whatever the foundation shows
beside the punch. Both bodies must then stretch alike, by two numbers that solve two equations,
while the foundation's surface slides along under the punch.

    mpirun -n 2 python demos/finite_patch.py [--cells tri|hex|tet] [--degree 2] [--plot DIR] ...
"""

import argparse
import json
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from patch2d import CELLS, FOUNDATION, FOUNDATION_TOP, PUNCH, PUNCH_BOTTOM, PUNCH_TOP, bodies
from scipy.optimize import brentq

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

E, NU, PRESSURE = 1000.0, 0.4, 300.0
BOXES = {  # lower corner, size and cells of foundation and punch, which in 3D are held along y
    2: (FOUNDATION, PUNCH),
    3: (
        ((0.0, 0.0, 0.0), (3.0, 1.0, 1.0), (5, 3, 2)),
        ((1.1, 0.2, 1.0), (1.2, 0.6, 1.0), (3, 2, 2)),
    ),
}


def lame(young, poisson):
    return young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))


def energy(u, mu, lam):
    """Neo-Hookean body, in 2D in plane strain: mu/2 (I1 - 3) - mu ln J + lam/2 ln² J."""
    F = ufl.Identity(len(u)) + ufl.grad(u)
    J = ufl.det(F)
    return mu / 2 * (ufl.inner(F, F) - len(u)) - mu * ufl.ln(J) + lam / 2 * ufl.ln(J) ** 2


def residual(u, mu, lam, order=1):
    """Form of the body, of elements of an order. Moduli are Constants and points few: other values
    take the same kernels, which are compiled once."""
    moduli = (fem.Constant(u.function_space.mesh, float(m)) for m in (mu, lam))
    density = energy(u, *moduli) * ufl.dx(degree=3 if order == 1 else 4)
    return ufl.derivative(density, u, ufl.TestFunction(u.function_space))


def stretches(q, young=E, poisson=NU):
    """Stretches along x and y under a pressure q along y: sigma_xx = 0, sigma_yy = -q.

    mu (a² - 1) + lam ln(a b) = 0 and mu (b² - 1) + lam ln(a b) = -q a b; the first gives b.
    """
    mu, lam = lame(young, poisson)
    along_y = lambda a: np.exp(-mu / lam * (a * a - 1.0)) / a  # noqa: E731
    left = lambda a, b: mu * (b * b - a * a) + q * a * b  # noqa: E731
    a = brentq(lambda a: left(a, along_y(a)), 1.0, 3.0, xtol=1e-15)
    return float(a), float(along_y(a))


def supports(spaces, boxes):
    """The bottom slides; the bodies' left ends stay where they are, and in 3D both their y."""
    up = len(boxes[0][0]) - 1
    held, bcs = [(spaces[0], up, [0.0], 0.0, 0.0)], []
    for V, (corner, size, _), z in zip(spaces, boxes, (0.0, 1.0), strict=True):
        held.append((V, 0, [corner[0]], z, z + 1.0))
        held += [(V, 1, [corner[1], corner[1] + size[1]], z, z + 1.0)] * (up - 1)
    for V, k, at, low, high in held:
        Vk, _ = V.sub(k).collapse()
        where = lambda p: (  # noqa: E731
            np.isclose(p[k], np.c_[at]).any(axis=0) & (low - 1e-9 < p[up]) & (p[up] < high + 1e-9)  # noqa: B023
        )
        dofs = fem.locate_dofs_geometrical((V.sub(k), Vk), where)
        bcs.append(fem.dirichletbc(fem.Function(Vk), dofs, V.sub(k)))
    return bcs


def problem(
    scene, law=None, order=(0, 1), pressure=PRESSURE, young=E, poisson=NU, design="auto", **more
):
    """The problem, for bodies on one mesh or on two; ``order`` of the interface's sides; ``boxes``
    if they are others, ``beyond`` if the punch's bottom is pressed as well where it is free; two
    numbers of ``young`` and ``poisson`` for two bodies on two meshes."""
    dim = scene[0][0].geometry.dim
    degree = more.get("degree", 1)
    spaces = [compat.function_space(domain, degree=degree, shape=(dim,)) for domain, _ in scene]
    functions, forms = [fem.Function(V, name="u") for V in spaces], []
    low_tags, high_tags = scene[0][1], scene[-1][1]
    bcs = supports([spaces[0], spaces[-1]], more.get("boxes", BOXES[dim]))
    materials = [np.broadcast_to(value, len(spaces)).tolist() for value in (young, poisson)]
    for u, *material in zip(functions, *materials, strict=True):
        forms.append(residual(u, *lame(*material), degree))
    p = fem.Constant(spaces[0].mesh, float(pressure))
    loads = [
        llm.FreeSurfacePressure(high_tags, PUNCH_TOP, p),
        llm.FreeSurfacePressure(low_tags, FOUNDATION_TOP, p, covered_by=(high_tags, PUNCH_BOTTOM)),
    ]
    sides = ((low_tags, FOUNDATION_TOP), (high_tags, PUNCH_BOTTOM))
    if more.get("beyond"):
        loads.append(llm.FreeSurfacePressure(*sides[1], p, covered_by=sides[0]))
    chosen = {"law": law or llm.Frictionless(), "design": design}
    interface = llm.Interface(None, tuple(sides[i] for i in order), **chosen)
    return llm.NonlinearContactProblem(forms, functions, bcs=bcs, interfaces=interface, loads=loads)


def errors(contact, known, boxes=None):
    """Largest errors of stretches and of the contact pressure, relative to the applied one."""
    result, p, worst = contact.results[0], contact.loads[0].value(), 0.0
    dim = contact.spaces[0].mesh.geometry.dim
    left = [corner[0] for corner, _, _ in boxes or BOXES[dim]]
    for u in contact.u:
        x = u.function_space.tabulate_dof_coordinates()[:, :dim]
        end = np.where((x[:, -1] > 1.0 + 1e-9) & (x[:, 0] > left[1] - 1e-9), *left[::-1])
        exact = np.zeros_like(x)
        exact[:, 0], exact[:, -1] = (known[0] - 1.0) * (x[:, 0] - end), (known[1] - 1.0) * x[:, -1]
        off = np.abs(u.x.array.reshape(exact.shape) - exact)
        off[np.isclose(x[:, -1], 1.0), 0] = 0.0  # nodes of either body
        worst = max(worst, off.max(initial=0.0))
    area = result.frame_area
    off = np.abs(result.pressure[area > 1e-9 * area.max()] / p - 1.0).max()
    off = max(off, np.abs(result.frame_force / p - area).max() / area.max())
    return contact.comm.allreduce(worst, op=MPI.MAX), float(off)


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", choices=[*CELLS, "tet on hex"], default="quad")
    parser.add_argument("--refine", type=int, default=1, metavar="N")
    parser.add_argument("--pressure", type=float, default=PRESSURE)
    parser.add_argument("--degree", type=int, choices=(1, 2), default=1, help="of the elements")
    parser.add_argument("--separate", action="store_true", help="one dolfinx mesh per body")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    dim = 2 if args.cells in ("tri", "quad") else 3
    kinds = ("hex", "tet") if args.cells == "tet on hex" else args.cells
    separate = args.separate or args.cells == "tet on hex"
    scene = bodies(MPI.COMM_WORLD, kinds, args.refine, separate, boxes=BOXES[dim])
    contact = problem(scene, pressure=args.pressure, degree=args.degree)
    contact.solve(increments=4)
    known = stretches(args.pressure)
    found = dict(zip(("stretch", "pressure"), errors(contact, known), strict=True))
    found["iterations"] = [h["iteration"] for h in contact.history if h["residual"] < 1e-11]
    if contact.comm.rank == 0:
        print(contact)
        print(f"stretches {known[0]:.12f}, {known[1]:.12f}")
        print(f"errors: stretches {found['stretch']:.1e}, pressure {found['pressure']:.1e}")
        print(f"Newton iterations of each increment: {found['iterations']}")
        if args.json:
            args.json.write_text(json.dumps(found) + "\n")
    if args.plot:
        for k, u in enumerate(contact.u):
            path = args.plot / f"finite_patch_{k}.png"
            plot.bodies(u, ufl.sqrt(ufl.dot(u, u)), path, label="length of u", scale=1.0)
    return found


if __name__ == "__main__":
    main()
