"""Sensitivities of contact with friction by one adjoint solve, against differences of solves.

A block on an elastic foundation is pressed and dragged by its top; under it nodes stick and slip.
J is the mean sideways motion of the foundation's surface, as a gauge would read it. With p of
``problem.adjoint(dJ)``, one solve, the derivative of L(p) - a(u, p) by a parameter, u held, is that
of J: by the modulus E of every cell, by the pressure on the block's left side, by any other.
Differences take two solves for each, and find the same six digits where no node changes between
stick and slip.

    mpirun -n 2 python demos/adjoint.py [--mu 0.3] [--elements 8 12] [--plot DIR] [--json FILE]
"""

import argparse
import json
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from friction_block import BLOCK, BOTTOM, FOUNDATION, LEFT, TOP, body, stress
from hertz2d import hold
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

NU, PRESS, DRAG, STEP = 0.3, -0.02, 0.007, 2e-4  # motion of the top; relative step of differences


class Gauged:
    """The problem: E of cells, Functions ``E``, and the pressure ``load`` on the left side."""

    def __init__(self, mu=0.3, elements=(8, 12), solver="auto"):
        n, m = elements  # along the width of the contact: of the block, of the foundation
        made = [body(MPI.COMM_WORLD, *BLOCK, (n, n // 2)),
                body(MPI.COMM_WORLD, *FOUNDATION, (3 * m, m))]  # fmt: skip
        self.spaces = [compat.function_space(domain, shape=(2,)) for domain, _ in made]
        self.tests = [ufl.TestFunction(V) for V in self.spaces]
        self.ds = [ufl.Measure("ds", domain=domain, subdomain_data=tags) for domain, tags in made]
        self.E = [fem.Function(compat.function_space(domain, "DG", 0)) for domain, _ in made]
        for E, value in zip(self.E, (1500.0, 1000.0)):
            E.x.array[:] = value
        self.load = fem.Constant(made[0][0], 2.0)
        held = [(0, 0, 1.0, DRAG), (0, 1, 1.0, PRESS), (1, 0, -2.0, 0.0), (1, 1, -2.0, 0.0)]
        bcs = []
        for i, k, y, value in held:
            bcs.append(hold(self.spaces[i], k, lambda x, y=y: np.isclose(x[1], y)))
            bcs[-1].g.x.array[:] = value
        sides = (made[0][1], BOTTOM), (made[1][1], TOP)
        trials = [ufl.TrialFunction(V) for V in self.spaces]
        self.problem = llm.ContactProblem(
            [self.a(i, u, w) for i, (u, w) in enumerate(zip(trials, self.tests))],
            [self.L(i, w) for i, w in enumerate(self.tests)],
            bcs=bcs,
            interfaces=llm.Interface(None, sides, law=llm.Coulomb(mu)),
            solver=solver,
        )

    def a(self, i, u, w):
        return ufl.inner(stress(u, self.E[i], NU), ufl.sym(ufl.grad(w))) * ufl.dx

    def L(self, i, w):
        pressed = self.load * w[0] * self.ds[0](LEFT)
        return pressed if i == 0 else fem.Constant(w.ufl_function_space().mesh, 0.0) * w[0] * ufl.dx

    def J(self, u):
        """Of both bodies' displacements; the form."""
        return u[1][0] / FOUNDATION[1][0] * self.ds[1](TOP)

    def value(self):
        """J of one load step from rest."""
        self.problem.reset()
        return total(self.J(self.problem.solve()))

    def sensitivities(self):
        """dJ/dE of every cell, as Functions, and dJ/dload, at the state of the last solve."""
        u = self.problem.u
        zero = fem.Constant(u[0].function_space.mesh, 0.0) * self.tests[0][0] * ufl.dx
        p = self.problem.adjoint([zero, ufl.derivative(self.J(u), u[1], self.tests[1])])
        by_E = []
        for i, E in enumerate(self.E):
            change = ufl.TestFunction(E.function_space)
            rate = compat.form("dJ/dE", -ufl.derivative(self.a(i, u[i], p[i]), E, change))
            found = fem.Function(E.function_space)
            found.x.array[: E.function_space.dofmap.index_map.size_local] = compat.assemble_force(
                (rate,), (1.0,), E.function_space
            )
            found.x.scatter_forward()
            by_E.append(found)
        return by_E, total(self.L(0, p[0])) / float(self.load.value)


def total(form):
    """Of all ranks."""
    value = fem.assemble_scalar(fem.form(form))
    return MPI.COMM_WORLD.allreduce(value)


PARTS = [
    (0, "block", lambda x: x[0] < np.inf),
    (1, "foundation", lambda x: x[0] < np.inf),
    (1, "foundation beneath the block", lambda x: (x[1] > -0.5) & (abs(x[0]) < 1.0)),
    (0, "corner of the block", lambda x: (x[1] < 0.3) & (x[0] < -0.7)),
]


def run(mu=0.3, elements=(8, 12), solver="auto"):
    """J, numbers of pairs that stick and slip, and rows of derivatives by the logarithm of a
    parameter, by the adjoint and by differences; the problem's u and dJ/dE."""
    scene, rows = Gauged(mu, elements, solver), []
    value, last = scene.value(), scene.problem.history[-1]
    u, (by_E, by_load) = scene.problem.u, scene.sensitivities()

    def compare(name, found, array, part):
        kept, values = array.copy(), []
        for sign in (1.0, -1.0):
            array[...] = kept * (1.0 + sign * STEP * part)
            values.append(scene.value())
        array[...] = kept
        rows.append((name, float(found), (values[0] - values[1]) / (2.0 * STEP)))

    for i, name, where in PARTS:
        E, own = scene.E[i].x.array, by_E[i].function_space.dofmap.index_map.size_local
        part = where(by_E[i].function_space.tabulate_dof_coordinates()[: len(E)].T)
        found = (by_E[i].x.array * E * part)[:own].sum()
        compare(f"E of {name}", MPI.COMM_WORLD.allreduce(found), E, part)
    compare("pressure on its side", by_load * scene.load.value, scene.load.value, 1.0)
    return {"J": value, "stick": last["stick"], "slip": last["slip"], "rows": rows}, u, by_E


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mu", type=float, default=0.3)
    parser.add_argument("--elements", type=int, nargs=2, default=(8, 12))
    parser.add_argument("--solver", default="auto", choices=("auto", "saddle", "condensed"))
    parser.add_argument("--plot", type=Path, metavar="DIR")
    parser.add_argument("--json", type=Path, metavar="FILE")
    args = parser.parse_args(arguments)
    found, u, by_E = run(args.mu, args.elements, args.solver)
    if MPI.COMM_WORLD.rank == 0:
        print("J {J:.6g}; {stick} nodes stick, {slip} slip".format(**found))
        for name, adjoint, differences in found["rows"]:
            print(f"{name:30} dJ/dlog: {adjoint:14.7e}, differences {differences:14.7e}, "
                  f"off by {abs(adjoint / differences - 1):.0e}")  # fmt: skip
        if args.json:
            args.json.write_text(json.dumps(found) + "\n")
    if args.plot:
        rates = [1.0 * rate for rate in by_E]
        plot.bodies(u, rates, args.plot / "adjoint.png", label="dJ / dE of the cells", scale=10.0)
    return found


if __name__ == "__main__":
    main()
