"""A nearly incompressible block under a stiff one: Taylor and Hood's (u, p) against plain elements.

A soft block, ν = 0.4999 or 0.5, clamped below, is pressed down by a stiff one, which lies on it
without friction on a mesh that does not match. Plain elements are too stiff where volume hardly
changes: Q1 locks, Q2 does less. In a mixed space one block is the displacement, which the interface
touches; nothing else changes, and ν may be 0.5. Forces are compared with that of a mesh twice as
fine as the finest, in (u, p).

    mpirun -n 2 python demos/incompressible.py [--nu 0.4999] [--elements 8 16 32] [--plot DIR]
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from friction_block import BOTTOM, TOP, body, stress
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

MU, STIFF, DOWN = 1.0, 1000.0, 0.02  # shear modulus below; Young's above; way of the top
METHODS = ("Q1", "Q2", "(u, p)")


def taylor_hood(mesh):
    """(u, p) of second and first order; the name of mixed spaces differs between versions."""
    gdim, cell = mesh.geometry.dim, mesh.ufl_cell()
    try:
        from basix.ufl import element, mixed_element
    except ImportError:
        u = ufl.VectorElement("Lagrange", cell, 2)
        both = ufl.MixedElement(u, ufl.FiniteElement("Lagrange", cell, 1))
        return fem.FunctionSpace(mesh, both)
    u = element("Lagrange", mesh.basix_cell(), 2, shape=(gdim,))
    return fem.functionspace(mesh, mixed_element([u, element("Lagrange", mesh.basix_cell(), 1)]))


def held(V, tags, tag, value):
    """V, or the displacement's block of it, is a constant vector on a tagged side."""
    space = V.sub(0).collapse()[0] if V.dofmap.index_map_bs == 1 else V
    known = fem.Function(space)
    known.interpolate(lambda x: np.outer(value, np.ones(x.shape[1])))
    facets = tags.find(tag)
    if space is V:
        return fem.dirichletbc(known, fem.locate_dofs_topological(V, 1, facets))
    pair = V.sub(0), space
    return fem.dirichletbc(known, fem.locate_dofs_topological(pair, 1, facets), V.sub(0))


def soft(W, nu):
    """Stiffness of the lower block: p = -λ div u as an unknown, or put in."""
    if W.dofmap.index_map_bs > 1:
        u, w = ufl.TrialFunction(W), ufl.TestFunction(W)
        lame = 2 * MU * nu / (1 - 2 * nu)
        return 2 * MU * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) + lame * ufl.div(u) * ufl.div(
            w
        )
    (u, p), (w, q) = ufl.TrialFunctions(W), ufl.TestFunctions(W)
    shear = 2 * MU * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w))
    return shear - p * ufl.div(w) - q * ufl.div(u) - (1 - 2 * nu) / (2 * MU * nu) * p * q


def problem(method, n, nu, comm=MPI.COMM_WORLD):
    """n cells along half of the lower block's width, 0.7 n along half of the upper one's."""
    low, below = body(comm, (-1.0, 0.0), (2.0, 1.0), (2 * n, n))
    high, above = body(comm, (-1.0, 1.0), (2.0, 0.5), (round(1.4 * n), n // 2))
    degree = 1 if method == "Q1" else 2
    V = compat.function_space(high, degree=degree, shape=(2,))
    W = taylor_hood(low)
    if method != "(u, p)":
        W = compat.function_space(low, degree=degree, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    forms = [soft(W, nu) * ufl.dx, ufl.inner(stress(u, STIFF, 0.3), ufl.grad(w)) * ufl.dx]
    parts = ufl.split(ufl.TestFunction(W))[0] if method == "(u, p)" else ufl.TestFunction(W)
    loads = [
        ufl.inner(fem.Constant(mesh, np.zeros(2)), v) * ufl.dx
        for mesh, v in ((low, parts), (high, w))
    ]
    bcs = [held(W, below, BOTTOM, (0.0, 0.0)), held(V, above, TOP, (0.0, -DOWN))]
    interface = llm.Interface(None, ((below, TOP), (above, BOTTOM)), law=llm.Frictionless())
    return llm.ContactProblem(forms, loads, bcs=bcs, interfaces=[interface])


def solved(method, n, nu):
    """Figures of one mesh; positions and pressures at the interface."""
    start = time.perf_counter()
    with problem(method, n, nu) as contact:
        contact.solve()
        result = contact.results[0]
        force, unknowns = float(-result.resultant[1]), sum(contact.unknowns.values())
    seconds = time.perf_counter() - start
    row = {"method": method, "n": n, "unknowns": unknowns, "seconds": seconds, "force": abs(force)}
    order = np.argsort(result.x[:, 0])
    return row, (result.x[order, 0], result.pressure[order])


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--nu", type=float, default=0.4999)
    parser.add_argument("--elements", type=int, nargs="+", default=(4, 8, 16), metavar="N")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    methods = METHODS if args.nu < 0.5 else METHODS[-1:]
    found = {(m, n): solved(m, n, args.nu) for m in methods for n in args.elements}
    exact = solved("(u, p)", 2 * max(args.elements), args.nu)[0]["force"]
    rows = [row | {"error": row["force"] / exact - 1.0} for row, _ in found.values()]
    if MPI.COMM_WORLD.rank == 0:
        print("".join(f"{name:>12}" for name in rows[0]))
        for row in rows:
            method, n, unknowns, *values = row.values()
            print(f"{method:>12}{n:12}{unknowns:12}" + "".join(f"{v:12.4g}" for v in values))
        if args.json:
            args.json.write_text(json.dumps(rows) + "\n")
    if args.plot:
        n = max(args.elements)
        lines = [(m, f"C{k}.-", *found[m, n][1]) for k, m in enumerate(methods)]
        plot.curves(lines, args.plot / "incompressible.png", xlabel="x", ylabel="pressure")
    return rows


if __name__ == "__main__":
    main()
