"""A block pressed onto a foundation and dragged: full stick, partial slip, full slip.

Plane strain, meshes that do not match. The block is pressed by a uniform pressure on its top, which
is then moved sideways in equal steps. In full slip the friction is mu N whatever the meshes; the
paper's switch between stick and slip runs beside the semismooth Newton iteration. The second part
is the benchmark SSNV128: a plate pressed onto a rigid plane and pushed from the side.

    mpirun -n 2 python demos/friction_block.py [--mu MU] [--elements 16 23] [--plot DIR] ...
"""

import argparse
import json
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from hertz2d import hold
from mpi4py import MPI
from patch2d import brick

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

BOTTOM, TOP, LEFT = 1, 2, 3
E, NU, PRESSURE = 1000.0, 0.3, 1.0
# Lower left corner, width and height.
FOUNDATION, BLOCK = ((-3.0, -2.0), (6.0, 2.0)), ((-1.0, 0.0), (2.0, 1.0))


def body(comm, corner, size, cells):
    """Mesh of a rectangle and tags of its BOTTOM, TOP and LEFT."""
    x, quads = brick(corner, size, cells, False)
    n = None if comm.rank == 0 else 0
    domain = compat.create_mesh(comm, quads[:n], x[:n], "quadrilateral")
    at = [(1, corner[1]), (1, corner[1] + size[1]), (0, corner[0])]
    found = [
        mesh.locate_entities_boundary(domain, 1, lambda p, k=k, y=y: np.isclose(p[k], y))
        for k, y in at
    ]
    values = np.repeat([BOTTOM, TOP, LEFT], [len(f) for f in found]).astype(np.int32)
    order = np.argsort(np.concatenate(found))
    return domain, mesh.meshtags(domain, 1, np.concatenate(found)[order], values[order])


def stress(u, E, nu):
    """Hooke's law in space or plane strain."""
    eps = ufl.sym(ufl.grad(u))
    return E / (1 + nu) * (eps + nu / (1 - 2 * nu) * ufl.tr(eps) * ufl.Identity(len(u)))


# ## Block and foundation
class Dragged:
    """The problem; ``drag`` is the motion of the block's top [length]."""

    def __init__(self, mu=0.3, elements=(16, 23), method="newton", order=(0, 1)):
        n, m = elements  # along the width of the contact: of the block, of the foundation
        comm, forms, loads = MPI.COMM_WORLD, [], []
        bodies = [body(comm, *BLOCK, (n, n // 2)), body(comm, *FOUNDATION, (3 * m, m))]
        spaces = [compat.function_space(domain, shape=(2,)) for domain, _ in bodies]
        for (domain, tags), V, p in zip(bodies, spaces, (PRESSURE, 0.0)):
            u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
            ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
            forms.append(ufl.inner(stress(u, E, NU), ufl.grad(w)) * ufl.dx)
            loads.append(-fem.Constant(domain, p) * w[1] * ds(TOP))
        self.top = hold(spaces[0], 0, lambda x: np.isclose(x[1], 1.0))
        bcs = [self.top] + [hold(spaces[1], k, lambda x: np.isclose(x[1], -2.0)) for k in (0, 1)]
        sides = ((bodies[0][1], BOTTOM), (bodies[1][1], TOP))
        law = llm.Coulomb(mu, method=method)
        interface = llm.Interface(None, tuple(sides[i] for i in order), law=law)
        self.problem = llm.ContactProblem(forms, loads, bcs=bcs, interfaces=[interface])

    def step(self, drag):
        """One load step; friction, normal force, shares of nodes that stick and slip."""
        self.top.g.x.array[:] = drag
        self.problem.solve()
        result = self.problem.results[0]
        T, N = result.resultant
        last = self.problem.history[-1]
        return {
            "drag": drag, "friction": -np.sign(N) * T, "normal": abs(N), "stick": last["stick"],
            "slip": last["slip"], "iterations": len(self.problem.history),
        }  # fmt: skip


def drag(mu, elements, method, distance=0.004, steps=8):
    """Rows of all load steps; None from the step on that does not converge."""
    scene, rows = Dragged(mu, elements, method), []
    for share in np.linspace(0.0, 1.0, steps + 1):
        try:
            rows.append(scene.step(share * distance))
        except llm.ContactError as error:
            rows.append({"drag": share * distance, "error": str(error)})
            break
    return scene.problem, rows


# ## SSNV128: half of a plate with a plane of symmetry at x = 0.04
SSNV_X = np.array([0.0, 0.00125, 0.005, 0.0075, 0.01125])
SSNV_U = 1e-5 * np.array([2.86, 2.72, 2.28, 1.98, 1.5])  # published, scatter 5 %


def ssnv128(n=32, comm=MPI.COMM_WORLD):
    """Tangential displacement at the five points; n elements along the edge, a multiple of 32."""
    domain, tags = body(comm, (0.0, 0.0), (0.04, 0.04), (n, n))
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
    down, aside = fem.Constant(domain, 5e7), fem.Constant(domain, 15e7)
    problem = llm.ContactProblem(
        ufl.inner(stress(u, 1.3e11, 0.2), ufl.grad(w)) * ufl.dx,
        -down * w[1] * ds(TOP) + aside * w[0] * ds(LEFT),
        bcs=[hold(V, 0, lambda x: np.isclose(x[0], 0.04))],
        interfaces=[llm.Interface(tags, (BOTTOM, llm.RigidPlane((0, 0), (0, 1))),
                                  law=llm.Coulomb(1.0))],
    )  # fmt: skip
    problem.solve()
    side = problem.results[0].sides[0]
    order = np.argsort(side.x[:, 0])
    return problem, np.interp(SSNV_X, side.x[order, 0], side.u[order, 0])


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mu", type=float, default=0.3)
    parser.add_argument("--elements", type=int, nargs=2, default=(16, 23), metavar="N")
    parser.add_argument("--steps", type=int, default=8)
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    runs = {
        method: drag(args.mu, args.elements, method, steps=args.steps)
        for method in ("newton", "switch")
    }
    plate, found = ssnv128()
    if MPI.COMM_WORLD.rank == 0:
        print(runs["newton"][0])
        for method, (_, rows) in runs.items():
            print(f"\n{method:12} friction / mu N   stick  slip  iterations")
            for row in rows:
                print(f"{row['drag']:12.5f}", end="")
                if "error" in row:
                    print(f"  {row['error'][:70]} ...")
                    continue
                share = row["friction"] / (args.mu * row["normal"])
                print(f"{share:16.12f}{row['stick']:8}{row['slip']:6}{row['iterations']:12}")
        print(f"\nSSNV128, {len(plate.history)} iterations\n       x   published       found")
        for x, u, v in zip(SSNV_X, SSNV_U, found):
            print(f"{x:8.5f}{u:12.3e}{v:12.3e}{v / u - 1:9.1%}")
        if args.json:
            table = {method: rows for method, (_, rows) in runs.items()}
            args.json.write_text(json.dumps(table | {"ssnv128": found.tolist()}) + "\n")
    if args.plot:
        lines = []
        for style, (method, (_, rows)) in zip(("k.-", "C1x"), runs.items()):
            done = [row for row in rows if "error" not in row]
            share = [row["friction"] / (args.mu * row["normal"]) for row in done]
            lines.append((method, style, [row["drag"] for row in done], share))
        path = args.plot / "friction_block.png"
        plot.curves(lines, path, xlabel="motion of the top", ylabel="friction over μ N")
    return {method: rows for method, (_, rows) in runs.items()}, found


if __name__ == "__main__":
    main()
