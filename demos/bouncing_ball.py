"""A disc that falls on a plane with a spin: three bounces, in each of which friction takes of it.

As long as the point that touches slides, the impulse of friction is mu times that of the pressure:
with the speed v at which the disc comes, e v at which it goes and the radius R a stiff disc gains
mu (1 + e) v along the plane and loses 2 mu (1 + e) v / R of its spin; to (1 + e) v comes what the
weight adds while they touch. e follows from the waves that are left in the disc. Turns are small,
so that a linear problem will do.

    mpirun -n 2 python demos/bouncing_ball.py [--mu MU] [--elements N] [--bounces N] [--plot DIR]
"""

import argparse
import json
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from friction_block import stress
from mpi4py import MPI
from rolling_disc import OUTLINE, disc

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

GRAVITY, V, SPIN, E, NU = 0.1, 0.01, 0.04, 2e6, 0.3  # V: with which it first meets the plane
NEAR, FAR = 1e-4, 4e-3  # steps in time at the plane, in flight


class Ball:
    """A disc of radius 1 and density 1, V² / (2 g) above the plane."""

    def __init__(self, mu=0.2, elements=8, comm=MPI.COMM_WORLD):
        self.comm, self.height, self.rows = comm, V**2 / (2 * GRAVITY), []
        domain, tags = disc(comm, elements)
        W = compat.function_space(domain, shape=(2,))
        u, w = ufl.TrialFunction(W), ufl.TestFunction(W)
        a = ufl.inner(stress(u, E, NU), ufl.grad(w)) * ufl.dx
        plane = llm.RigidPlane((0.0, -self.height), (0.0, 1.0))
        interface = llm.Interface(tags, (OUTLINE, plane), law=llm.Coulomb(mu))
        # Gravity acts on the mass as it moves, else the disc would swing in flight.
        self.weight = fem.Function(W)
        self.stepper = s = llm.TimeStepper(
            1.0, a, ufl.inner(fem.Constant(domain, (0.0, 0.0)), w) * ufl.dx, dt=FAR,
            interfaces=[interface], nodal_loads=[self.weight],
        )  # fmt: skip
        rho, dx = s.density[0], ufl.dx(domain)
        force = compat.assemble_force((fem.form(-GRAVITY * rho * w[1] * dx),), (1.0,), W)
        self.weight.x.array[: len(force)] = force
        self.weight.x.scatter_forward()
        s.v.interpolate(lambda x: SPIN * np.stack([1.0 - x[1], x[0]]))
        x, y = ufl.SpatialCoordinate(domain)
        y = y - 1.0
        terms = (
            rho, rho * (x * x + y * y), rho * s.u[1], rho * s.v[0], rho * s.v[1],
            rho * (x * s.v[1] - y * s.v[0]), 0.5 * rho * ufl.inner(s.v, s.v),
            0.5 * ufl.inner(stress(s.u, E, NU), ufl.sym(ufl.grad(s.u))),
        )  # fmt: skip
        self._forms = [fem.form(term * dx) for term in terms]

    def row(self):
        """Time, height, speeds along and up, spin; force of the plane; kinetic, elastic energy, and
        that of the height."""
        m, inertia, up, along, rise, turn, kinetic, elastic = (
            self.comm.allreduce(fem.assemble_scalar(form)) for form in self._forms
        )
        results = self.stepper.problem.results
        press = results[0].sides[0].normal_force.sum() if results else 0.0
        height = self.height + up / m
        motion = height, along / m, rise / m, turn / inertia
        return [self.stepper.t, *motion, press, kinetic, elastic, m * GRAVITY * height]

    def run(self, bounces, files=None):
        """Rows of all steps until the disc is on its top after so many bounces."""
        self.stepper.start()
        self.rows.append(self.row())
        met = 0
        while met < bounces or self.rows[-1][5] != 0.0 or self.rows[-1][3] > 0.0:
            height, speed, s = self.rows[-1][1], self.rows[-1][3], self.stepper
            near = speed < 0.0 and height < -1.1 * speed * FAR
            dt = NEAR if near or self.rows[-1][5] != 0.0 else FAR
            if dt != s.dt:
                s.dt = dt
            s.step()
            self.rows.append(self.row())
            met += self.rows[-2][5] != 0.0 and self.rows[-1][5] == 0.0
            if files:
                files.write(s.t)
        return np.array(self.rows)


def figures(rows, mu):
    """Of each bounce: e, and what is gained along the plane and lost of the spin over theory."""
    touched = np.concatenate([[False], rows[:, 5] != 0.0, [False]])
    begins, ends = (np.flatnonzero(np.diff(touched.astype(int)) == k) for k in (1, -1))
    found = {"e": [], "along": [], "spin": []}
    for i, j in zip(begins - 1, ends - 1, strict=True):
        before, after = rows[i], rows[j]
        impulse = mu * (after[3] - before[3] + GRAVITY * (after[0] - before[0]))
        found["e"].append(float(-after[3] / before[3]))
        found["along"].append(float((before[2] - after[2]) / impulse))
        found["spin"].append(float((before[4] - after[4]) / (2.0 * impulse)))
    energy = rows[:, 6:].sum(axis=1)
    found["growth"] = float(np.diff(energy).max() / energy[0])
    return found


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mu", type=float, default=0.2)
    parser.add_argument("--elements", type=int, default=8, help="over the radius")
    parser.add_argument("--bounces", type=int, default=3)
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    parser.add_argument("--output", type=Path, metavar="DIR", help="time series for ParaView")
    args = parser.parse_args(arguments)
    ball = Ball(args.mu, args.elements)
    with ExitStack() as stack:
        series = llm.post.LoadSteps
        files = args.output and stack.enter_context(series(ball.stepper.problem, args.output))
        rows = ball.run(args.bounces, files)
    found = figures(rows, args.mu)
    if MPI.COMM_WORLD.rank == 0:
        print(ball.stepper.problem)
        print("bounce       e   gain along, loss of spin over theory")
        for i, values in enumerate(zip(found["e"], found["along"], found["spin"], strict=True)):
            print("{:6d}  {:6.4f} {:11.5f} {:13.5f}".format(i + 1, *values))
        print(f"largest growth of energy in a step: {found['growth']:.1e}; {len(rows)} steps")
        if args.json:
            args.json.write_text(json.dumps(found) + "\n")
    if args.plot:
        t = rows[:, 0]
        lines = [("along", "C0-", t, rows[:, 2]), ("up", "C1-", t, rows[:, 3])]
        lines += [("spin R", "C2-", t, rows[:, 4])]
        plot.curves(lines, args.plot / "bouncing_ball.png", xlabel="time", ylabel="speed")
        energy = [("all", "k-", t, rows[:, 6:].sum(axis=1)), ("kinetic", "C0-", t, rows[:, 6])]
        energy += [("elastic", "C1-", t, rows[:, 7]), ("height", "C2-", t, rows[:, 8])]
        path = args.plot / "bouncing_ball_energy.png"
        plot.curves(energy, path, xlabel="time", ylabel="energy")
    return found, rows


if __name__ == "__main__":
    main()
