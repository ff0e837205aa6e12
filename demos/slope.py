"""A block on a slope: at rest or sliding, by friction, with the acceleration of theory.

The slope's tangent is 1/2; the block rests with mu = 0.501 and slides with mu = 0.499 by the
acceleration g (sin - mu cos), which is a thousandth of that of its weight. The block lies level and
gravity is turned, so that the way along the slope is that along x.

    mpirun -n 2 python demos/slope.py [--mu MU ...] [--elements N] [--steps N] [--plot DIR] ...
"""

import argparse
import json
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from friction_block import BOTTOM, body, stress
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

TANGENT, GRAVITY, E, NU = 0.5, 10.0, 1e7, 0.3


class Slope:
    """A block of width 2 and height 1, density 1; steps of ``dt`` [time]."""

    def __init__(self, mu, elements=6, dt=0.04, comm=MPI.COMM_WORLD):
        self.comm, self.mu, cos = comm, mu, 1.0 / np.hypot(1.0, TANGENT)
        domain, tags = body(comm, (-1.0, 0.0), (2.0, 1.0), (2 * elements, elements))
        V = compat.function_space(domain, shape=(2,))
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        self.weight = fem.Constant(domain, GRAVITY * cos * np.array([TANGENT, -1.0]))
        a = ufl.inner(stress(u, E, NU), ufl.grad(w)) * ufl.dx
        L = ufl.inner(self.weight, w) * ufl.dx
        plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
        interface = llm.Interface(tags, (BOTTOM, plane), law=llm.Coulomb(mu))
        self.stepper = s = llm.TimeStepper(1.0, a, L, dt=dt, interfaces=[interface])
        self.theory = GRAVITY * cos * max(TANGENT - mu, 0.0)
        # As pressed by its weight, and moving as it will: nothing swings then.
        self.settle(V, tags, plane, a, w)
        rho, dx = s.density[0], ufl.dx(domain)
        self.start = s.u.copy()
        terms = rho * (s.u[0] - self.start[0]), rho * s.v[0], rho * s.v[1]
        self._forms = [fem.form(0.5 * term * dx) for term in terms]  # of a mass of 2
        self.rows = []

    def settle(self, V, tags, plane, a, w):
        """The displacement of the block under its weight less its inertia."""
        s = self.stepper
        weight = self.weight - s.density[0] * ufl.as_vector((self.theory, 0.0))
        law = llm.Coulomb((1.0 + 1e-5) * self.mu)  # at the brink of slip
        interface = llm.Interface(tags, (BOTTOM, plane), law=law)
        problem = llm.ContactProblem(a, ufl.inner(weight, w) * ufl.dx, interfaces=[interface])
        s.u.x.array[:] = problem.solve().x.array
        problem.destroy()

    def step(self):
        self.stepper.step()
        found = [self.comm.allreduce(fem.assemble_scalar(form)) for form in self._forms]
        resultant = self.stepper.problem.results[0].resultant
        self.rows.append([self.stepper.t, *found, *resultant])


def slide(mu, elements, steps, output=None):
    """Rows of time, way, velocity along and normal, forces; acceleration over theory, or speed."""
    slope = Slope(mu, elements)
    for _ in range(steps):
        slope.step()
    rows = np.array(slope.rows)
    t, way, v = rows[:, 0], rows[:, 1], rows[:, 2]
    found = {"mu": mu, "theory": slope.theory, "speed": float(abs(v[-1])), "way": float(way[-1])}
    found["acceleration"] = float(2.0 * (way @ t**2) / (t**2 @ t**2))
    if output:
        llm.post.write_interface(output / f"mu_{mu}", slope.stepper.problem.results[0])
    return rows, found


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mu", type=float, nargs="+", default=[0.501, 0.499])
    parser.add_argument("--elements", type=int, default=6)
    parser.add_argument("--steps", type=int, default=25)
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    parser.add_argument("--output", type=Path, metavar="DIR", help="contact forces for ParaView")
    args = parser.parse_args(arguments)
    report, lines = [], []
    for mu in args.mu:
        rows, found = slide(mu, args.elements, args.steps, args.output)
        report.append(found)
        t, v = rows[:, 0], rows[:, 2]
        lines.append((f"mu = {mu}", "-", t, v))
        lines.append((f"theory, mu = {mu}", "k:", t, found["theory"] * t))
        if MPI.COMM_WORLD.rank == 0:
            print(", ".join(f"{name} {value:.6g}" for name, value in found.items()))
    if MPI.COMM_WORLD.rank == 0 and args.json:
        args.json.write_text(json.dumps(report) + "\n")
    if args.plot:
        plot.curves(lines, args.plot / "slope.png", xlabel="t", ylabel="velocity")
    return report


if __name__ == "__main__":
    main()
