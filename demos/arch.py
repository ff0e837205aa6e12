"""An arch of loose stones stands or falls by its thickness, as limit analysis says.

Half a ring of N stones, its middle line of radius 1, on rigid ground under its own weight; joints
take no pull and do not slide (mu = 2 is more than any thrust line needs). By Heyman's theorem it
stands where some thrust line lies within the stones: a linear programme of forces at both ends of
each joint, by which the least thickness is found to seven digits. Elastic stones that contact alone
holds stand 1 % above it, with a thrust within the programme's bounds; 1 % below they fall, and the
hinges are told.

    mpirun -n 2 python demos/arch.py [--stones N ...] [--elements N N] [--json FILE] [--plot DIR]
"""

import argparse
import json
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from friction_block import stress
from mpi4py import MPI
from scipy.optimize import linprog

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

E, NU, MU, WEIGHT = 1e5, 0.2, 2.0, 1.0
GROUND = 1


def joints(n, t):
    """(n + 1, 2, 2) inner and outer ends of the joints, from left to right."""
    angle = np.linspace(np.pi, 0.0, n + 1)
    ray = np.column_stack([np.cos(angle), np.sin(angle)])
    return np.stack([(1.0 - 0.5 * t) * ray, (1.0 + 0.5 * t) * ray], axis=1)


def thrust(n, t, sense=0.0):
    """Horizontal thrust of rigid stones, the least (sense 1), largest (-1) or some (0); None: they
    fall. Unknowns are two normal forces, at the ends, and a shear force in each joint."""
    ends, across = joints(n, t), [[0.0, -1.0], [1.0, 0.0]]
    A, b = np.zeros((n, 3, n + 1, 3)), np.zeros((n, 3))
    for k in range(n):
        x = np.concatenate([ends[k], ends[k + 1, ::-1]])
        turn = x[:, 0] * np.roll(x[:, 1], -1) - np.roll(x[:, 0], -1) * x[:, 1]
        area = 0.5 * turn.sum()
        centre = turn @ (x + np.roll(x, -1, axis=0)) / (6.0 * area)
        b[k, 1] = WEIGHT * abs(area)
        for j, sign in ((k, 1.0), (k + 1, -1.0)):
            shear = (ends[j, 1] - ends[j, 0]) / t
            push = sign * shear @ across
            for i, (at, force) in enumerate(zip(ends[j, [0, 1, 1]], (push, push, sign * shear))):
                A[k, :2, j, i], arm = force, at - centre
                A[k, 2, j, i] = arm[0] * force[1] - arm[1] * force[0]
    cost = np.zeros((n + 1, 3))
    cost[0, 2] = -sense  # at the left joint shear points to the left
    bounds = [(0, None), (0, None), (None, None)] * (n + 1)
    found = linprog(cost.ravel(), A_eq=A.reshape(3 * n, -1), b_eq=b.ravel(), bounds=bounds)
    return None if found.status else -float(found.x[2])


def least_thickness(n):
    low, high = 0.02, 0.4
    while high - low > 1e-8:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if thrust(n, middle) is None else (low, middle)
    return high


def outline(n, t):
    """(k, 2) of all stones, one after the other."""
    ends = joints(n, t)
    stones = [np.concatenate([ends[k], ends[k + 1, ::-1], ends[k, :1]]) for k in range(n)]
    return np.concatenate([np.vstack([stone, [np.nan, np.nan]]) for stone in stones])


def arch(comm, n, t, elements):
    """The problem: stones of some elements along and across, tied to nothing."""
    ends, (along, across) = joints(n, t), elements
    s, r = (a.ravel() for a in np.meshgrid(*[np.linspace(0, 1, k + 1) for k in elements]))
    corners = np.stack([(1 - s) * (1 - r), (1 - s) * r, s * (1 - r), s * r], axis=1)
    x = np.concatenate([corners @ np.concatenate(ends[k : k + 2]) for k in range(n)])
    first = (np.arange(across)[:, None] * (along + 1) + np.arange(along)).ravel()
    cells = first[:, None] + [0, 1, along + 1, along + 2]
    cells = (cells + len(s) * np.arange(n)[:, None, None]).reshape(-1, 4)
    if comm.rank:
        x, cells = x[:0], cells[:0]
    domain = compat.create_mesh(comm, cells, x, "quadrilateral")
    V = compat.function_space(domain, shape=(2,))
    ground = mesh.locate_entities_boundary(domain, 1, lambda p: np.abs(p[1]) < 1e-9)
    tags = mesh.meshtags(domain, 1, np.sort(ground), np.full(len(ground), GROUND, dtype=np.int32))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    weight, law = fem.Constant(domain, np.array([0.0, -WEIGHT])), llm.Coulomb(MU)
    interfaces = [llm.Interface(tags, (GROUND, llm.RigidPlane((0, 0), (0, 1))), law=law)]
    interfaces += llm.find_interfaces(None, V, law=law)
    a = ufl.inner(stress(u, E, NU), ufl.grad(w)) * ufl.dx
    return llm.ContactProblem(a, ufl.inner(weight, w) * ufl.dx, interfaces=interfaces)


def tried(n, t, elements, comm=MPI.COMM_WORLD):
    """What becomes of it, and the thrust line (n + 1, 2) if it stands."""
    problem, found = arch(comm, n, t, elements), {"stones": n, "thickness": t}
    try:
        problem.solve()
    except llm.ContactError as error:
        problem.destroy()
        return found | {"stands": False, "told": str(error)}, None
    ground = problem.results[0].sides[0]
    left = ground.x[:, 0] < 0.0
    places = [(ground.x[k], ground.normal_force[k]) for k in (left, ~left)]
    places += [(r.sides[0].x, r.sides[0].normal_force) for r in problem.results[1:]]
    line = np.array([N @ x / N.sum() for x, N in places])
    line = line[np.argsort(line[:, 0])]
    found |= {
        "stands": True, "iterations": len(problem.history), "thrust": -ground.force[left, 0].sum(),
        "carried": -ground.force[:, 1].sum(),
        "outside": np.abs(np.linalg.norm(line, axis=1) - 1.0).max() - 0.5 * t,
    }  # fmt: skip
    problem.destroy()
    return found, line


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stones", type=int, nargs="+", default=[8, 20])
    parser.add_argument("--elements", type=int, nargs=2, default=(2, 3), metavar="N")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args, rows = parser.parse_args(arguments), []
    for n in args.stones:
        least = least_thickness(n)
        for part in (1.01, 0.99):
            row, line = tried(n, part * least, args.elements)
            bounds = [thrust(n, part * least, s) for s in (1.0, -1.0)]
            rows.append(row | {"part": part, "bounds": bounds})
            if MPI.COMM_WORLD.rank == 0:
                print(", ".join(f"{name} {value}" for name, value in rows[-1].items())[:420])
            if args.plot and line is not None:
                lines = [("stones", "k-", *outline(n, part * least).T)]
                lines.append((f"thrust line, {part} of the least thickness", "C3.-", *line.T))
                plot.curves(lines, args.plot / f"arch_{n}.png", xlabel="x", ylabel="y")
    if MPI.COMM_WORLD.rank == 0 and args.json:
        args.json.write_text(json.dumps(rows) + "\n")
    return rows


if __name__ == "__main__":
    main()
