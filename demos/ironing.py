"""Ironing: a stiff curved die is pressed into a soft slab and drawn along it, with and without
friction.

Neo-Hookean bodies whose meshes do not match, in 2D in plane strain or in 3D. Some ten facets of the
slab lie under the die, which travels by ten in steps of half a facet. Forces on the die should
follow its motion without a trace of the facets: their ripple is what is left of them about a cubic,
over the normal force. With friction the die drags the slab along. The stiff body is the coarser one
here, whose nodes carry the frame: many nodes of a stiff curved surface on few facets of a soft one
would touch at these facets' own nodes alone.

    mpirun -n 2 python demos/ironing.py [--dim 3] [--mu 0 0.3] [--plot DIR] ...
"""

import argparse
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from finite_patch import energy, lame
from mpi4py import MPI
from patch2d import FOUNDATION_TOP, PUNCH_BOTTOM, PUNCH_TOP, bodies

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

SLAB, DIE = (1.0, 0.3), (20.0, 0.3)  # E and nu
RADIUS, DEPTH, FACET, UNDER = 2.0, 0.12, 0.1, 10
BOXES = {  # lower corner, size and cells of slab and die
    2: (((0.0, 0.0), (4.0, 1.0), (40, 8)), ((0.6, 1.0), (2.0, 1.0), (10, 5))),
    3: (
        ((0.0, 0.0, 0.0), (2.6, 1.0, 1.0), (26, 5, 10)),
        ((0.3, 0.3, 1.0), (1.4, 0.4, 1.0), (7, 2, 3)),  # its edges lie amid facets of the slab
    ),
}


class Ironing:
    """The problem; ``motion`` is that of the die's top [length]."""

    def __init__(self, mu=0.3, dim=2, comm=MPI.COMM_WORLD):
        scene = bodies(comm, {2: "quad", 3: "hex"}[dim], 1, True, boxes=BOXES[dim])
        (corner, size, _), die = BOXES[dim][1], scene[1][0].geometry.x
        along, up = die[:, 0] - corner[0] - size[0] / 2, die[:, dim - 1] - corner[-1]
        rise = RADIUS - np.sqrt(RADIUS**2 - along**2)
        die[:, dim - 1] += rise * (1 - up / size[-1])
        spaces = [compat.function_space(domain, shape=(dim,)) for domain, _ in scene]
        u, forms = [fem.Function(V, name="u") for V in spaces], []
        for V, w, material in zip(spaces, u, (SLAB, DIE), strict=True):
            constants = (fem.Constant(V.mesh, c) for c in lame(*material))
            density = energy(w, *constants) * ufl.dx(degree=4)
            forms.append(ufl.derivative(density, w, ufl.TestFunction(V)))
        self.motion = fem.Constant(scene[1][0], np.zeros(dim))
        bottom = fem.locate_dofs_geometrical(spaces[0], lambda p: np.isclose(p[dim - 1], 0.0))
        facets = scene[1][1].indices[scene[1][1].values == PUNCH_TOP]
        top = fem.locate_dofs_topological(spaces[1], dim - 1, facets)
        still = fem.Constant(scene[0][0], np.zeros(dim))
        bcs = [fem.dirichletbc(still, bottom, spaces[0])]
        bcs.append(fem.dirichletbc(self.motion, top, spaces[1]))
        sides = (scene[0][1], FOUNDATION_TOP), (scene[1][1], PUNCH_BOTTOM)
        interface = llm.Interface(None, sides, law=llm.Coulomb(mu))
        self.problem = llm.NonlinearContactProblem(forms, u, bcs=bcs, interfaces=[interface])

    def step(self, along, down):
        """Move the die there; force of the slab on it, iterations, halvings, pairs that slip."""
        self.motion.value[0], self.motion.value[-1] = along, -down
        self.problem.solve()
        history, result = self.problem.history, self.problem.results[0]
        ends = {entry["part"]: entry for entry in history}
        if MPI.COMM_WORLD.rank == 0:
            print(f"  at {along:.3f}, {down:.3f} down: {history[-1]['iteration']} iterations")
        return result.resultant, history[-1]["iteration"], len(ends) - 1, history[-1]["slip"]


def ripple(travel, force):
    """Largest deviation of forces (n, d) from a cubic in the travel, over the normal force."""
    if len(travel) < 6:  # a cubic takes all
        return np.full(force.shape[1], np.nan)
    cubic = np.polynomial.polynomial.polyfit(travel, force, 3)
    rest = force - np.polynomial.polynomial.polyval(travel, cubic).T
    return np.abs(rest).max(axis=0) / np.abs(force[:, -1]).mean()


def iron(mu, dim, down, steps):
    """Press the die in ``down`` steps, draw it along by ``steps`` halves of a facet."""
    run = Ironing(mu, dim)
    pressed = [run.step(0.0, DEPTH * (k + 1) / down) for k in range(down)]
    travel = 0.5 * FACET * np.arange(1, steps + 1)
    drawn = [run.step(s, DEPTH) for s in travel]
    return run, travel, pressed, drawn


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--dim", type=int, choices=[2, 3], default=2)
    parser.add_argument("--mu", type=float, nargs="+", default=[0.0, 0.3])
    parser.add_argument("--down", type=int, default=4, metavar="N", help="steps down")
    parser.add_argument("--steps", type=int, default=2 * UNDER, metavar="N", help="steps along")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    report, curves = {}, []
    for k, mu in enumerate(args.mu):
        run, travel, *done = iron(mu, args.dim, args.down, args.steps)
        force, its, halvings, slip = (list(column) for column in zip(*done[0], *done[1]))
        force = np.array(force)[args.down :]
        slid = travel > (0.0 if mu == 0.0 else 3.5 * FACET)  # at first the slab sticks
        found = report[mu] = {
            "force": force,
            "ripple": ripple(travel[slid], force[slid]),
            "iterations": its,
            "halvings": sum(halvings),
            "slip": slip,
        }
        curves += [
            (f"{name}, mu = {mu:g}", f"C{k}{style}", travel, sign * force[:, i])
            for name, style, sign, i in (("along", "o--", -1.0, 0), ("normal", "s-", 1.0, -1))
        ]
        if MPI.COMM_WORLD.rank == 0:
            mean, last = np.mean(its), force[-1]
            print(f"mu = {mu:g}: {run.problem.results[0].frame.x.shape[0]} frame nodes")
            print(f"  force along {last[0]:.5f}, normal {last[-1]:.5f}")
            told = ", ".join(f"{r:.2%}" for r in found["ripple"])
            few = np.isnan(found["ripple"]).any()
            print(f"  ripple over the normal force: {'too few steps slide' if few else told}")
            print(f"  iterations {mean:.1f} a step, at most {max(its)}; halvings {sum(halvings)}")
        if args.plot:
            for name, u in zip(("slab", "die"), run.problem.u, strict=True):
                path = args.plot / f"ironing_{args.dim}d_{mu:g}_{name}.png"
                plot.bodies(u, u[0], path, label="u along", scale=1.0)
    if args.plot:
        path = args.plot / f"ironing_{args.dim}d.png"
        plot.curves(curves, path, xlabel="travel", ylabel="force on the die")
    return report


if __name__ == "__main__":
    main()
