"""A stiff disc that slides on a plane until friction makes it roll: with 2/3 of its first speed.

The disc lies on the plane by its weight and starts to slide with the speed V. Friction slows it and
turns it, until at t = V / (3 mu g) the point that touches rests: the disc rolls with 2/3 V,
whatever mu. The way is small against the radius, so that a linear problem will do.

    mpirun -n 2 python demos/rolling_disc.py [--mu MU] [--elements N] [--steps N] [--plot DIR] ...
"""

import argparse
import json
from pathlib import Path

import gmsh
import numpy as np
import ufl
from dolfinx import fem
from friction_block import stress
from hertz2d import hold
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

OUTLINE, GRAVITY, V, E, NU = 1, 10.0, 0.01, 1e9, 0.3


def disc(comm, n):
    """Mesh of a disc of radius 1 on y = 0, n cells over the radius, and tags of its lower third."""
    gmsh.initialize()
    if comm.rank == 0:
        gmsh.option.setNumber("General.Terminal", 0)
        geo, angles = gmsh.model.geo, np.deg2rad([-150.0, -90.0, -30.0, 90.0])
        middle = geo.addPoint(0.0, 1.0, 0.0)
        points = [geo.addPoint(np.cos(t), 1.0 + np.sin(t), 0.0) for t in angles]
        arcs = [geo.addCircleArc(points[i], middle, points[(i + 1) % 4]) for i in range(4)]
        surface = geo.addPlaneSurface([geo.addCurveLoop(arcs)])
        geo.synchronize()
        gmsh.option.setNumber("Mesh.CharacteristicLengthMin", 1.0 / n)
        gmsh.option.setNumber("Mesh.CharacteristicLengthMax", 1.0 / n)
        gmsh.model.addPhysicalGroup(1, arcs[:2], OUTLINE)
        gmsh.model.addPhysicalGroup(2, [surface], 2)
        gmsh.model.mesh.generate(2)
    domain, _, tags = compat.model_to_mesh(gmsh.model, comm, 0, gdim=2)
    gmsh.finalize()
    return domain, tags


class Disc:
    """The disc, of density 1, as pressed by its weight; ``dt`` a share of the time it slides."""

    def __init__(self, mu=0.3, elements=8, steps=40, comm=MPI.COMM_WORLD):
        self.comm, self.rolls = comm, V / (3.0 * mu * GRAVITY)
        domain, tags = disc(comm, elements)
        W = compat.function_space(domain, shape=(2,))
        u, w = ufl.TrialFunction(W), ufl.TestFunction(W)
        a = ufl.inner(stress(u, E, NU), ufl.grad(w)) * ufl.dx
        L = -GRAVITY * w[1] * ufl.dx
        plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
        pressed = llm.Interface(tags, (OUTLINE, plane), law=llm.Frictionless())
        interface = llm.Interface(tags, (OUTLINE, plane), law=llm.Coulomb(mu))
        self.stepper = s = llm.TimeStepper(1.0, a, L, dt=self.rolls / steps, interfaces=[interface])
        rho, dx = s.density[0], ufl.dx(domain)
        upright = hold(W, 0, lambda x: np.isclose(x[0], 0.0) & (abs(x[1] - 1.0) > 1.0 - 1e-9))
        weight = -GRAVITY * rho * w[1] * ufl.dx
        with llm.ContactProblem(a, weight, bcs=[upright], interfaces=[pressed]) as problem:
            s.u.x.array[:] = problem.solve().x.array
        s.v.interpolate(lambda x: np.stack([V + 0.0 * x[0], 0.0 * x[0]]))
        y = ufl.SpatialCoordinate(domain)[1] - 1.0
        x = ufl.SpatialCoordinate(domain)[0]
        eps = ufl.sym(ufl.grad(s.u))
        terms = (
            rho, rho * (x * x + y * y), rho * s.v[0], rho * (y * s.v[0] - x * s.v[1]),
            0.5 * rho * ufl.inner(s.v, s.v), 0.5 * ufl.inner(stress(s.u, E, NU), eps),
        )  # fmt: skip
        self._forms = [fem.form(term * dx) for term in terms]
        self.rows = []

    def run(self, time):
        """Rows of time over that of sliding, speed and spin over V, kinetic and elastic energy."""
        while self.stepper.t < time * self.rolls - 1e-12:
            self.stepper.step()
            m, inertia, p, turn, kinetic, elastic = (
                self.comm.allreduce(fem.assemble_scalar(form)) for form in self._forms
            )
            row = self.stepper.t / self.rolls, p / m / V, turn / inertia / V, kinetic, elastic
            self.rows.append(row)
        return np.array(self.rows)


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mu", type=float, default=0.3)
    parser.add_argument("--elements", type=int, default=6)
    parser.add_argument("--steps", type=int, default=40, help="until it rolls")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    rolling = Disc(args.mu, args.elements, args.steps)
    rows = rolling.run(2.0)
    late = rows[:, 0] > 1.2
    found = {"speed": float(rows[late, 1].mean()), "spin": float(rows[late, 2].mean())}
    if MPI.COMM_WORLD.rank == 0:
        print(rolling.stepper.problem)
        for name, value in found.items():
            print(f"{name:6} over that of theory, 2/3 V: {1.5 * value:.5f}")
        if args.json:
            args.json.write_text(json.dumps(found) + "\n")
    if args.plot:
        t, exact = rows[:, 0], np.maximum(1.0 - rows[:, 0] / 3.0, 2.0 / 3.0)
        lines = [("speed / V", "C0-", t, rows[:, 1]), ("spin R / V", "C1-", t, rows[:, 2])]
        lines.append(("theory", "k:", t, exact))
        label = "time over that of sliding"
        plot.curves(lines, args.plot / "rolling_disc.png", xlabel=label, ylabel="speed, spin")
        lines = [("kinetic", "C0-", t, rows[:, 3]), ("elastic", "C1-", t, rows[:, 4])]
        plot.curves(lines, args.plot / "rolling_disc_energy.png", xlabel=label, ylabel="energy")
    return found, rows


if __name__ == "__main__":
    main()
