"""Error against run time of first and second order, tied and opening, side by side.

Tied: two unit squares on meshes 2:3 that do not match, with a smooth answer; the error of stresses
(H1) falls with h at first order and with h² at second. Opening: Hertz's two cylinders, 2:3 as well;
the pressure at the frame's nodes inside 0.8 half-widths against the ellipse, root mean square over
the peak, under a tenth of that demo's load, where discs differ less from half-spaces. These bodies
are curved, and so are their meshes of second order. Times are without meshes and the compilation of
forms.

    python demos/second_order.py [--cells 8 16 32] [--elements 4 8 16] [--plot DIR]
"""

import argparse
import json
from pathlib import Path

import hertz2d
import numpy as np
import ufl
from dolfinx import fem
from friction_block import BOTTOM, TOP, body, stress
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

E, NU, INSIDE, LOAD = 1000.0, 0.3, 0.8, 0.1
COMM = MPI.COMM_WORLD


def answer(x, sin=ufl.sin):
    """Displacement at x, in UFL or NumPy."""
    return 0.01 * sin(1.3 * x[0] + 0.7 * x[1]), 0.01 * sin(0.9 * x[0] - 1.1 * x[1] + 0.3)


def squares(n, degree):
    """Two squares, one on the other, and what they are loaded and held by."""
    forms, loads, bcs, sides = [], [], [], []
    for y, k, own, outer in ((0.0, n, TOP, BOTTOM), (1.0, 3 * n // 2, BOTTOM, TOP)):
        domain, tags = body(COMM, (0.0, y), (1.0, 1.0), (k, k))
        V = compat.function_space(domain, degree=degree, shape=(2,))
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        exact = stress(ufl.as_vector(answer(ufl.SpatialCoordinate(domain))), E, NU)
        ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
        traction = ufl.inner(exact * ufl.FacetNormal(domain), w)
        forms.append(ufl.inner(stress(u, E, NU), ufl.grad(w)) * ufl.dx)
        loads.append(-ufl.inner(ufl.div(exact), w) * ufl.dx + traction * ds - traction * ds(own))
        known = fem.Function(V)
        known.interpolate(lambda x: np.array(answer(x, np.sin)))
        at = fem.locate_dofs_topological(V, 1, tags.find(outer))
        bcs.append(fem.dirichletbc(known, at))
        sides.append((tags, own))
    return forms, loads, bcs, llm.Interface(None, tuple(sides))


def gradient_error(found):
    """Relative error of the gradient, in L2."""
    sums = np.zeros(2)
    for u in found:
        domain = u.function_space.mesh
        exact = ufl.as_vector(answer(ufl.SpatialCoordinate(domain)))
        for k, e in enumerate((u - exact, exact)):
            form = ufl.inner(ufl.grad(e), ufl.grad(e)) * ufl.dx(metadata={"quadrature_degree": 6})
            sums[k] += COMM.allreduce(fem.assemble_scalar(fem.form(form)))
    return float(np.sqrt(sums[0] / sums[1]))


def cost(problem):
    """Seconds of all but the compilation of forms, and unknowns."""
    seconds = sum(problem.times.values()) - problem.times["form compilation"]
    return seconds, sum(problem.unknowns.values())


def tied(n, degree):
    """Seconds, unknowns and error of the tied squares."""
    forms, loads, bcs, interface = squares(n, degree)
    with llm.ContactProblem(forms, loads, bcs=bcs, interfaces=[interface]) as problem:
        u = problem.solve()
        return *cost(problem), gradient_error(u)


def opening(n, degree):
    """Seconds, unknowns and error of Hertz's cylinders, n elements over the half-width."""
    a, p0 = hertz2d.hertz("cylinders", LOAD)
    with hertz2d.problem("cylinders", (n, 3 * n // 2), LOAD, degree=degree) as problem:
        problem.solve()
        x, pressure = problem.results[0].x[:, 0] / a, problem.results[0].pressure / p0
        inner = np.abs(x) < INSIDE
        off = pressure[inner] - np.sqrt(1.0 - x[inner] ** 2)
        return *cost(problem), float(np.sqrt(np.mean(off**2)))


def picture(rows, path):
    """Both scenes: errors over seconds."""
    diagrams = []
    for scene in ("tied", "opening"):
        lines = []
        for k, degree in enumerate((1, 2)):
            own = [row for row in rows if (row["scene"], row["order"]) == (scene, degree)]
            values = np.log10([[row["seconds"], row["error"]] for row in own]).T
            lines.append((f"{scene}, order {degree}", f"C{k}.-", *values))
        diagrams.append(lines)
    plot.curves(diagrams, path, xlabel="log10 of seconds", ylabel="log10 of error")


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, nargs="+", default=(8, 16, 32, 64), metavar="N")
    parser.add_argument("--elements", type=int, nargs="+", default=(4, 8, 16), metavar="N")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    rows = []
    for scene, run, sizes in (("tied", tied, args.cells), ("opening", opening, args.elements)):
        for degree in (1, 2):
            for n in sizes:
                found = zip(("seconds", "unknowns", "error"), run(n, degree))
                rows.append({"scene": scene, "order": degree, "n": n, **dict(found)})
    if COMM.rank == 0:
        print("".join(f"{name:>12}" for name in rows[0]))
        for row in rows:
            print(
                "".join(f"{v:12.4g}" if isinstance(v, float) else f"{v:>12}" for v in row.values())
            )
        if args.json:
            args.json.write_text(json.dumps(rows) + "\n")
    if args.plot:
        picture(rows, args.plot / "second_order.png")
    return rows


if __name__ == "__main__":
    main()
