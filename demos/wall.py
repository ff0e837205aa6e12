"""A wall of loose blocks in running bond under its weight and a side load, friction in all joints.

Blocks 1 x 1/2 and half blocks lie on rigid ground, mu = 0.6; joints are found by themselves. The
side load is a part of the weight of each block, as if the ground were tilted, and grows in steps.
Told is the largest part of its friction that a joint uses, and how well the wall is balanced.
Limit analysis of rigid blocks, a linear programme of forces at both ends of each joint, bounds the
side load from above (its friction dilates): 5 % beyond it the wall must fall, and what moves is
told. With --stack towers of blocks under their weight are timed instead.

    mpirun -n 2 python demos/wall.py [--rows N] [--columns N] [--loads A ...] [--plot DIR] ...
    python demos/wall.py --stack 100 200 400 1000 2000 [--dim 3] [--mu 0] [--json FILE]
"""

import argparse
import json
import resource
import time
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from friction_block import stress
from mpi4py import MPI
from scipy.optimize import linprog

import dolfinx_llm as llm
from dolfinx_llm import compat

E, NU, MU = 1e4, 0.2, 0.6
GROUND = 1


def bond(rows, columns):
    """(b, 2, 2) low and high corners of the blocks, course by course."""
    found = []
    for r in range(rows):
        cuts = np.arange(columns + 1.0)
        if r % 2:
            cuts = np.concatenate([[0.0], cuts[:-1] + 0.5, [float(columns)]])
        found += [[[a, 0.5 * r], [b, 0.5 * r + 0.5]] for a, b in zip(cuts[:-1], cuts[1:])]
    return np.array(found)


def rigid_limit(blocks):
    """Largest side load over weight that rigid blocks may bear, by the static theorem."""
    low, high, joints = blocks[:, 0], blocks[:, 1], []
    for axis in (0, 1):
        along = 1 - axis
        for j in range(len(blocks)):
            below = np.flatnonzero(np.isclose(high[:, axis], low[j, axis]))
            ends = [(i, max(low[i, along], low[j, along]), min(high[i, along], high[j, along]))
                    for i in below]  # fmt: skip
            joints += [(i, j, axis, a, b) for i, a, b in ends if b > a + 1e-9]
        if axis:  # on the ground, which is no block
            joints += [(-1, j, 1, low[j, 0], high[j, 0]) for j in np.flatnonzero(low[:, 1] < 1e-9)]
    n, area, centre = len(joints), (high - low).prod(axis=1), 0.5 * (low + high)
    A, bounds = np.zeros((len(blocks) + 1, 3, 3 * n + 1)), []
    for k, (i, j, axis, *ends) in enumerate(joints):
        for c, (at, way) in enumerate(((ends[0], axis), (ends[1], axis), (ends[0], 1 - axis))):
            x = np.zeros(2)
            x[axis], x[1 - axis] = low[j, axis], at
            for block, sign in ((i, -1.0), (j, 1.0)):  # the last row takes what the ground bears
                arm = x - centre[block]
                A[block, way, 3 * k + c] += sign
                A[block, 2, 3 * k + c] += sign * (arm[0] if way == 1 else -arm[1])
        bounds += [(0, None), (0, None), (None, None)]
    A[:-1, 0, -1] = area
    slip = np.zeros((2 * n, 3 * n + 1))
    for k in range(n):
        slip[2 * k : 2 * k + 2, 3 * k : 3 * k + 3] = [[-MU, -MU, 1.0], [-MU, -MU, -1.0]]
    balance, weight = A[:-1].reshape(-1, 3 * n + 1), np.column_stack([0 * area, area, 0 * area])
    found = linprog(-np.eye(3 * n + 1)[-1], slip, np.zeros(2 * n), balance, weight.ravel(),
                    bounds=[*bounds, (0, None)])  # fmt: skip
    return float(found.x[-1])


class Wall:
    """The problem of blocks (b, 2, gdim); ``load`` is the side load over the weight."""

    def __init__(self, blocks, n=2, mu=MU, comm=MPI.COMM_WORLD):
        self.blocks, points, cells, self.mu = blocks, [], [], mu
        gdim = blocks.shape[2]
        for k, (low, high) in enumerate(self.blocks):
            m = max(1, round((high - low)[0] * (2 * n - k % 2)))  # meshes do not match
            ends = np.append(np.full(gdim - 1, m), n) + 1
            x = np.stack(np.meshgrid(*map(np.linspace, low, high, ends), indexing="ij"))
            node = np.arange(x[0].size).reshape(ends) + sum(map(len, points))
            corners = [
                node[tuple(slice(i, i - 1 or None) for i in corner[::-1])].ravel()
                for corner in np.ndindex(*[2] * gdim)
            ]
            cells.append(np.stack(corners, axis=1))
            points.append(x.reshape(gdim, -1).T)
        x, c = (np.concatenate(a)[: None if comm.rank == 0 else 0] for a in (points, cells))
        domain = compat.create_mesh(comm, c, x, "quadrilateral" if gdim == 2 else "hexahedron")
        V = compat.function_space(domain, shape=(gdim,))
        at = mesh.locate_entities_boundary(domain, gdim - 1, lambda p: p[gdim - 1] < 1e-9)
        values = np.full(len(at), GROUND, dtype=np.int32)
        tags, up = mesh.meshtags(domain, gdim - 1, np.sort(at), values), np.eye(gdim)[-1]
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        self.load, law = fem.Constant(domain, -up), llm.Frictionless()
        law = llm.Coulomb(mu) if mu else law
        self.interfaces = llm.find_interfaces(None, V, law=law)
        ground = llm.Interface(tags, (GROUND, llm.RigidPlane(0.0 * up, up)), law=law)
        a = ufl.inner(stress(u, E, NU), ufl.grad(w)) * ufl.dx
        self.problem = llm.ContactProblem(
            a, ufl.inner(self.load, w) * ufl.dx, interfaces=[*self.interfaces, ground]
        )

    def step(self, part):
        """One load step, and its figures."""
        pull, began = np.zeros(len(self.load.value)), time.perf_counter()
        pull[0], pull[-1] = part, -1.0
        self.load.value = pull
        row = {"load": part, "joints": len(self.problem.interfaces)}
        try:
            self.problem.solve()
        except llm.ContactError as error:
            return row | {"stands": False, "seconds": time.perf_counter() - began,
                          "told": str(error)}  # fmt: skip
        used, least = [], 0.0
        for result in self.problem.results:
            N = sum(result.sides[0].normal_force)
            T = np.linalg.norm((result.sides[0].force).sum(axis=0)) ** 2 - N**2
            used += [np.sqrt(max(T, 0.0)) / (self.mu * N)] if self.mu and N > 1e-6 else []
            least = min(least, *(side.normal_force.min() for side in result.sides))
        total = self.problem.results[-1].sides[0].force.sum(axis=0)
        area = (self.blocks[:, 1] - self.blocks[:, 0]).prod(axis=1).sum()
        return row | {
            "stands": True, "iterations": len(self.problem.history),
            "seconds": time.perf_counter() - began, "friction used": max(used, default=0.0),
            "pull": least,
            "balance": float(np.abs(total / area - pull).max()),
        }  # fmt: skip


def tower(n, mu, gdim=2):
    """A stack of n blocks: processor and wall seconds of set-up and solve, memory of the process so
    far, and by how much a joint's force misses the weight above it, over that of all."""
    low, clocks = 0.5 * np.arange(n)[:, None] * np.eye(gdim)[-1], []
    clocks.append((time.process_time(), time.perf_counter()))
    wall = Wall(np.stack([low, low + [*[1.0] * (gdim - 1), 0.5]], axis=1), mu=mu)
    clocks.append((time.process_time(), time.perf_counter()))
    row = wall.step(0.0)
    clocks.append((time.process_time(), time.perf_counter()))
    missed = [
        abs((r.sides[0].normal_force.sum() + r.sides[0].x[:, -1].mean()) / (0.5 * n) - 1.0)
        for r in wall.problem.results
    ]
    wall.problem.destroy()
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    spent = dict(zip(("set-up", "solve"), np.diff(clocks, axis=0).round(2).tolist()))
    return {"blocks": n, "GB": memory, "missed": max(missed)} | spent | row


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=4)
    parser.add_argument("--columns", type=int, default=6)
    parser.add_argument("--loads", type=float, nargs="+", default=[0.2])
    parser.add_argument("--stack", type=int, nargs="+", default=[], metavar="N")
    parser.add_argument("--dim", type=int, choices=(2, 3), default=2, help="of stacks")
    parser.add_argument("--mu", type=float, default=MU, help=f"of a stack; a wall has {MU}")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args, rows = parser.parse_args(arguments), []
    for n in args.stack:
        rows.append(tower(n, args.mu, args.dim))
        if MPI.COMM_WORLD.rank == 0:
            print(rows[-1])
    if not args.stack:
        blocks = bond(args.rows, args.columns)
        limit, wall = rigid_limit(blocks), Wall(blocks)
        for part in [*args.loads, 1.05 * limit]:
            rows.append(wall.step(part) | {"limit": limit})
            if MPI.COMM_WORLD.rank == 0:
                print(", ".join(f"{name} {value}" for name, value in rows[-1].items())[:420])
            if args.plot and part == args.loads[-1] and rows[-1]["stands"]:
                wall.problem.plot(args.plot)
        wall.problem.destroy()
    if MPI.COMM_WORLD.rank == 0 and args.json:
        args.json.write_text(json.dumps(rows) + "\n")
    return rows


if __name__ == "__main__":
    main()
