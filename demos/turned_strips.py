"""Objectivity: two strips are pressed, sheared, and turned by half a turn.

Neo-Hookean strips whose meshes do not match, in plane strain, tied, without friction, and with
friction that sticks here and slips there. Turning changes nothing for them: contact forces in the
turned base stay as they are, and what sticks does not slip. Then the upper strip is moved to and
fro, with and without turning at the same time: the friction is the same.

    mpirun -n 2 python demos/turned_strips.py [--turn 180] [--step 10] [--plot DIR]
"""

import argparse
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from finite_patch import energy, lame
from mpi4py import MPI
from patch2d import FOUNDATION_TOP, PUNCH_BOTTOM, bodies

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

E, NU = 1000.0, 0.4
STRIPS = ((0.0, 0.0), (1.4, 1.0), (7, 3)), ((0.3, 1.0), (0.7, 1.0), (8, 4))
DOWN, SHIFT = 0.08, 0.04
LAWS = (llm.Tied(), llm.Frictionless(), llm.Coulomb(0.1), llm.Coulomb(0.3))


def turn(angle):
    """Matrix of a turn by an angle in radians."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


class Strips:
    """The problem; both ends are held, and moved as one asks for."""

    def __init__(self, law, comm=MPI.COMM_WORLD):
        scene = bodies(comm, "quad", separate=True, boxes=STRIPS, rough=0.2)
        spaces = [compat.function_space(domain, shape=(2,)) for domain, _ in scene]
        u, forms, bcs, self.ends = [fem.Function(V, name="u") for V in spaces], [], [], []
        for V, w, height in zip(spaces, u, (0.0, 2.0), strict=True):
            mu, lam = (fem.Constant(V.mesh, c) for c in lame(E, NU))
            forms.append(ufl.derivative(energy(w, mu, lam) * ufl.dx, w, ufl.TestFunction(V)))
            dofs = fem.locate_dofs_geometrical(V, lambda p, y=height: np.isclose(p[1], y))
            self.ends.append(fem.Function(V))
            bcs.append(fem.dirichletbc(self.ends[-1], dofs))
        sides = (scene[0][1], FOUNDATION_TOP), (scene[1][1], PUNCH_BOTTOM)
        interface = llm.Interface(None, sides, law=law)
        self.problem = llm.NonlinearContactProblem(forms, u, bcs=bcs, interfaces=[interface])

    def step(self, shift, angle=0.0):
        """Move the upper end along and down, turn all; nodal forces of both sides in the turned
        base, slip of nodes that stick."""
        Q = turn(angle)
        for end, moved in zip(self.ends, (0.0, 1.0), strict=True):
            x = end.function_space.tabulate_dof_coordinates()[:, :2]
            to = (x + moved * np.array([shift, -DOWN])) @ Q.T - x
            end.x.array[:] = to.ravel()
        self.problem.solve()
        sides = self.problem.results[0].sides
        stuck = max(np.abs(side.slip[side.status == 1]).max(initial=0.0) for side in sides)
        return np.concatenate([side.force @ Q for side in sides]), stuck

    def counts(self):
        """Pairs that stick and slip, and iterations of the last step."""
        last = self.problem.history[-1]
        return last["stick"], last["slip"], len(self.problem.history)


def turned(law, degrees, end=180.0):
    """Largest change of forces, over the largest force, and slip of what sticks, in a turn."""
    strips = Strips(law)
    strips.step(SHIFT)
    still, _ = strips.step(SHIFT)  # what slipped on the way rests
    first, change, slip, its = strips.counts(), 0.0, 0.0, []
    for angle in np.arange(degrees, end + 0.1, degrees):
        force, stuck = strips.step(SHIFT, np.deg2rad(angle))
        change = max(change, np.abs(force - still).max() / np.abs(still).max())
        slip = max(slip, stuck)
        its.append(strips.counts()[2])
    return strips, {"change": change, "slip": slip, "iterations": its, "pairs": first[:2]}


def to_and_fro(law, steps=6, degrees=90.0):
    """Friction over normal force on the way, still and while all turns."""
    way = SHIFT * np.sin(2 * np.pi * (np.arange(steps) + 0.5) / steps)
    found = []
    for end in (0.0, np.deg2rad(degrees)):
        strips = Strips(law)
        strips.step(0.0)
        steps_of = enumerate(way, start=1)
        forces = [strips.step(s, end * k / steps)[0] for k, s in steps_of]
        n = len(strips.problem.results[0].sides[0].x)
        sums = np.array([force[:n].sum(axis=0) for force in forces])
        found.append(sums[:, 0] / sums[:, 1])
    return found


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--turn", type=float, default=180.0, metavar="DEG")
    parser.add_argument("--step", type=float, default=10.0, metavar="DEG", help="of the turn")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    report, root = {}, MPI.COMM_WORLD.rank == 0
    for law in LAWS:
        strips, found = turned(law, args.step, args.turn)
        report[str(law)] = found
        if root:
            print(
                f"{law}: {found['pairs'][0]} stick, {found['pairs'][1]} slip before; while "
                f"all turns forces change by {found['change']:.1e}, slip {found['slip']:.1e}; at "
                f"most {max(found['iterations'])} iterations a step"
            )
    still, turning = to_and_fro(LAWS[-1])
    report["to and fro"] = float(np.abs(turning - still).max())
    if root:
        print("to and fro, friction over normal force:", np.array2string(still, precision=4))
        print(f"the same while all turns by 90 degrees: change {report['to and fro']:.1e}")
    if args.plot:
        for k, u in enumerate(strips.problem.u):
            path = args.plot / f"turned_{k}.png"
            plot.bodies(u, ufl.sqrt(ufl.dot(u, u)), path, label="length of u", scale=1.0)
    return report


if __name__ == "__main__":
    main()
