"""A block pressed eccentrically lifts off partly, and closes again.

Two blocks of the same width L, one on the other, without friction; linear pressure on the top,
1 + 12 e x / L² times P / L, so that P acts at x = e. Up to e = L / 6 contact is closed everywhere
and carries that pressure unchanged (pure bending); beyond it lifts off. Navier's triangle without
tension, 3 (L/2 - e) long, is then only an estimate. At every e the forces of contact balance the
load and its moment, and no pair pulls, overlaps, or presses while open.

    mpirun -n 2 python demos/lift_off.py [--elements 24 35] [--plot DIR]
"""

import argparse
import json
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from friction_block import BOTTOM, TOP, body, stress
from hertz2d import averages, hold
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

E, NU, P, L, H = 1000.0, 0.3, 1.0, 1.0, 1.0
STEPS = (0.0, 0.1, 1 / 6, 0.2, 0.25, 0.3, 0.25, 0.1, 0.0)  # e / L: opens, then closes again


def load(x, e):
    """Pressure on the top whose resultant P acts at e."""
    return P / L * (1 + 12 * e * x / L**2)


class Tower:
    """The problem; ``eccentricity`` is a Constant that may be set before each solve [length]."""

    def __init__(self, elements=(16, 23), order=(0, 1), comm=MPI.COMM_WORLD):
        self.eccentricity, forms, loads, bcs, sides = [], [], [], [], []
        for k, n in enumerate(elements):  # the upper block, then the lower one
            y = 0.0 if k == 0 else -H
            domain, tags = body(comm, (-L / 2, y), (L, H), (n, n))
            V = compat.function_space(domain, shape=(2,))
            u, w, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(domain)
            ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
            e, p = fem.Constant(domain, 0.0), fem.Constant(domain, 1.0 if k == 0 else 0.0)
            forms.append(ufl.inner(stress(u, E, NU), ufl.grad(w)) * ufl.dx)
            loads.append(-p * load(x[0], e) * w[1] * ds(TOP))
            # Against sliding, at one node in a corner; carries nothing.
            bcs.append(hold(V, 0, lambda p, y=y: np.isclose(p[0], -L / 2) & np.isclose(p[1], y)))
            if k == 1:
                bcs.append(hold(V, 1, lambda p: np.isclose(p[1], -H)))
            self.eccentricity.append(e)
            sides.append((tags, TOP if k else BOTTOM))
        law = llm.Frictionless()
        interface = llm.Interface(None, tuple(sides[i] for i in order), law=law)
        self.problem = llm.ContactProblem(forms, loads, bcs=bcs, interfaces=[interface])

    def step(self, e):
        """One load step, P at x = e; its figures."""
        for constant in self.eccentricity:
            constant.value = e
        self.problem.solve()
        result = self.problem.results[0]
        closed = [side.x[side.status > 0, 0] for side in result.sides]
        off = [
            np.abs(side.normal_force / side.area - averages(side.x[:, 0], lambda x: load(x, e)))
            for side in result.sides
        ]
        return {
            "e": e, "contact": float(max(map(np.ptp, closed))), "Navier": min(L, 3 * (L / 2 - e)),
            "peak": result.pressure.max(), "off linear": float(max(a.max() for a in off)),
            "force": abs(abs(result.resultant[1]) / P - 1),
            "moment": abs(abs(result.moment()[0]) - P * e) / (P * L),
            "complementarity": complementarity(self.problem),
            "iterations": len(self.problem.history),
        }  # fmt: skip


def complementarity(problem):
    """Largest of pull, overlap and force times gap, over the largest force and displacement."""
    worst = 0.0
    for result in problem.results:
        force = max(side.normal_force.max() for side in result.sides)
        size = max(np.abs(side.u).max() for side in result.sides)
        for side in result.sides:
            n, gap = side.normal_force / force, side.frame_gap / size
            worst = max(worst, -n.min(), -gap.min(), np.abs(n * gap).max())
    return float(worst)


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--elements", type=int, nargs=2, default=(16, 23), metavar="N")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    tower, rows, lines = Tower(args.elements), [], []
    for k, e in enumerate(STEPS):
        rows.append(tower.step(e * L))
        result = tower.problem.results[0]
        order = np.argsort(result.x[:, 0])
        if k < 6:
            x, p = result.x[order, 0], result.pressure[order]
            lines.append((f"e = {e:.3f} L", ".-", x / L, p * L / P))
    if MPI.COMM_WORLD.rank == 0:
        print(f"{tower.problem}\n\n" + "".join(f"{name:>16}" for name in rows[0]))
        for row in rows:
            print("".join(f"{value:16.4g}" for value in row.values()))
        if args.json:
            args.json.write_text(json.dumps(rows) + "\n")
    if args.plot:
        plot.curves(lines, args.plot / "lift_off.png", xlabel="x / L", ylabel="p L / P")
    return rows


if __name__ == "__main__":
    main()
