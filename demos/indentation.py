"""A stiff, rough punch leaves its print in a plastic block.

Right half, plane strain; the block is of J2 plasticity with linear hardening, small strain, by
radial return written in UFL, so that ``ufl.derivative`` finds the consistent tangent. Plastic
strain is a value at the points of quadrature, one in each of the four triangles of a square, which
do not lock. The punch is pressed in and drawn out until nothing touches.

Reference: the block alone, one piece, whose nodes below the punch are moved down and then let go.
Without hardening Prandtl's limit of the force per half width is (2 + pi) / sqrt(3) = 2.97 times the
yield stress.

    mpirun -n 2 python demos/indentation.py [--elements N M] [--depth D] [--plot DIR] ...
"""

import argparse
import json
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from friction_block import BOTTOM, TOP, stress
from hertz2d import hold
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

E, NU, YIELD, HARDENING, STIFF = 1000.0, 0.3, 4.0, 10.0, 1e6
BLOCK, PUNCH = ((0.0, -3.0), (4.0, 3.0)), ((0.0, 0.0), (1.0, 0.5))
POINT = 1  # degree of the quadrature
UP = [0.95, 0.9, 0.85, 0.8, 0.75, 0.7, 0.6, -0.1]  # of the depth, on the way out


def box(comm, corner, size, n):
    """Mesh of squares of four triangles, n over a length of 1, and tags of its BOTTOM and TOP."""
    corners = np.array([corner, np.add(corner, size)])
    cells, crossed = [int(round(n * side)) for side in size], mesh.DiagonalType.crossed
    domain = mesh.create_rectangle(comm, corners, cells, mesh.CellType.triangle, diagonal=crossed)
    found = [
        mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y))
        for y in corners[:, 1]
    ]
    values = np.repeat([BOTTOM, TOP], [len(f) for f in found]).astype(np.int32)
    order = np.argsort(np.concatenate(found))
    return domain, mesh.meshtags(domain, 1, np.concatenate(found)[order], values[order])


class Plastic:
    """Residual of a block of J2 plasticity, and what it remembers."""

    def __init__(self, V):
        domain = V.mesh
        self.u, w = fem.Function(V, name="u"), ufl.TestFunction(V)
        strain = fem.Function(compat.quadrature_space(domain, POINT, (3, 3)), name="plastic")
        self.way = way = fem.Function(compat.quadrature_space(domain, POINT), name="way")
        G, K = E / (2 * (1 + NU)), E / (3 * (1 - 2 * NU))
        tried = 2 * G * (self._deviator(self.u) - strain)
        size = ufl.sqrt(1.5 * ufl.inner(tried, tried) + (1e-9 * YIELD) ** 2)
        beyond = size - YIELD - HARDENING * way
        more = ufl.conditional(ufl.gt(beyond, 1e-9 * YIELD), beyond / (3 * G + HARDENING), 0.0)
        flow = 1.5 * more / size * tried
        felt = ufl.inner(tried - 2 * G * flow, self._deviator(w)) + K * ufl.div(self.u) * ufl.div(w)
        self.residual = felt * ufl.dx(domain, metadata={"quadrature_degree": POINT})
        self.memory = llm.Evolution({strain: strain + flow, way: way + more})
        self.bcs = [hold(V, 0, lambda x: np.isclose(x[0], 0.0))]
        self.bcs += [hold(V, k, lambda x: np.isclose(x[1], BLOCK[0][1])) for k in (0, 1)]

    @staticmethod
    def _deviator(u):
        e = ufl.sym(ufl.grad(u))
        wide = ufl.as_tensor([[e[0, 0], e[0, 1], 0.0], [e[0, 1], e[1, 1], 0.0], [0.0, 0.0, 0.0]])
        return wide - ufl.tr(e) / 3 * ufl.Identity(3)

    def let_go(self):
        """Nothing presses the block any more."""
        free = llm.NonlinearContactProblem(self.residual, self.u, bcs=self.bcs)
        free.solve(accepted=self.memory)

    def depth(self):
        """Of its corner on the axis."""
        V, u = self.u.function_space, self.u
        x = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local]
        at = np.isclose(x[:, 0], 0.0) & np.isclose(x[:, 1], 0.0)
        return V.mesh.comm.allreduce(float(-u.x.array.reshape(-1, 2)[: len(x)][at, 1].sum()))


class Indentation:
    """The punch on the block; elements over the half width of the punch, in the block and in it."""

    def __init__(self, elements=(6, 4), comm=MPI.COMM_WORLD):
        n, m = elements
        (domain, tags), (top, top_tags) = (
            box(comm, *where, k) for where, k in ((BLOCK, n), (PUNCH, m))
        )
        V, W = (compat.function_space(d, shape=(2,)) for d in (domain, top))
        self.block, u, w = Plastic(V), fem.Function(W), ufl.TestFunction(W)
        self.down = hold(W, 1, lambda x: np.isclose(x[1], PUNCH[1][1]))
        held = hold(W, 0, lambda x: np.isclose(x[0], 0.0))
        sides = (tags, TOP), (top_tags, BOTTOM)
        self.contact = llm.NonlinearContactProblem(
            [self.block.residual, ufl.inner(stress(u, STIFF, NU), ufl.grad(w)) * ufl.dx],
            [self.block.u, u],
            bcs=[*self.block.bcs, self.down, held],
            interfaces=[llm.Interface(None, sides, law=llm.Coulomb(1.0))],
        )
        self.rows = []

    def go(self, depth):
        """Move the punch to a depth: force over half width and yield stress."""
        self.down.g.x.array[:] = -depth
        self.contact.solve(accepted=self.block.memory)
        force = self.contact.results[0].resultant[1] / (PUNCH[1][0] * YIELD)
        self.rows.append((depth, force))


def one_piece(elements, depths, comm=MPI.COMM_WORLD):
    """The block alone: force at each depth, and the print that is left."""
    domain, _ = box(comm, *BLOCK, elements)
    V = compat.function_space(domain, shape=(2,))
    block = Plastic(V)
    touched = lambda x: np.isclose(x[1], 0.0) & (x[0] < PUNCH[1][0] + 1e-9)  # noqa: E731
    down = [hold(V, k, touched) for k in (0, 1)]
    pressed = llm.NonlinearContactProblem(block.residual, block.u, bcs=[*block.bcs, *down])
    form, forces = fem.form(block.residual), []
    nodes = fem.locate_dofs_geometrical(V, touched)
    own = nodes[nodes < V.dofmap.index_map.size_local]
    for depth in depths:
        down[1].g.x.array[:] = -depth
        # With the strain of the step flow is none: the forces are those of the step.
        pressed.solve(accepted=block.memory)
        r = compat.assemble_force((form,), (1.0,), V).reshape(-1, 2)[own, 1].sum()
        forces.append(-comm.allreduce(float(r)) / (PUNCH[1][0] * YIELD))
    block.let_go()
    return forces, block.depth()


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--elements", type=int, nargs=2, default=(6, 4), metavar=("N", "M"))
    parser.add_argument("--depth", type=float, default=0.06, help="over the half width")
    parser.add_argument("--steps", type=int, default=5, help="down")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    parser.add_argument("--output", type=Path, metavar="DIR", help="time series for ParaView")
    args = parser.parse_args(arguments)
    scene, down = Indentation(args.elements), args.steps
    depths = args.depth * np.arange(1, down + 1) / down
    with ExitStack() as stack:
        files = args.output and stack.enter_context(llm.post.LoadSteps(scene.contact, args.output))
        for depth in [*depths, *(args.depth * np.array(UP))]:
            scene.go(float(depth))
            if files:
                files.write()
            if args.plot and depth == args.depth:
                scene.contact.plot(args.plot)
    printed = scene.block.depth()
    forces, left = one_piece(args.elements[0], depths)
    rows = np.array(scene.rows)
    found = {
        "force": float(rows[down - 1, 1]),
        "over one piece": (rows[:down, 1] / forces).tolist(),
        "let up": float(rows[down + UP.index(0.9), 1]),
        "away": float(rows[-1, 1]),
        "print": printed,
        "print over one piece": printed / left,
    }
    if MPI.COMM_WORLD.rank == 0:
        print(scene.contact)
        worst = max(np.abs(np.array(found["over one piece"]) - 1.0))
        print(f"force over half width and yield stress:     {found['force']:.4f}")
        print(f"... off the one piece's in any step by at most {worst:.1e}")
        print(f"print that is left:                         {found['print']:.5f}")
        print(f"... over the one piece's:                   {found['print over one piece']:.6f}")
        if args.json:
            args.json.write_text(json.dumps(found) + "\n")
    if args.plot:
        lines = [
            ("with contact", "C0.-", rows[:, 0], rows[:, 1]),
            ("one piece", "kx", depths, forces),
        ]
        label = {"xlabel": "depth of the punch / half width", "ylabel": "force / (a yield stress)"}
        plot.curves(lines, args.plot / "indentation.png", **label)
    return found


if __name__ == "__main__":
    main()
