"""An elastic half ring pressed on an elastic block and drawn along it: large sliding, no friction.

Both bodies are neo-Hookean, in plane strain; their meshes do not match. The ring's ends are pressed
down and then move along the block, by many facets. Without friction nothing holds the ring back:
the force along the block is zero but for what the meshes show of themselves, as far as the ring
stays away from the block's ends. The work of the ring's ends is what the bodies store.

    mpirun -n 2 python demos/ring_on_block.py [--refine N] [--travel L] [--plot DIR]
"""

import argparse
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from finite_patch import energy, lame
from mpi4py import MPI
from patch2d import brick

import dolfinx_llm as llm
from dolfinx_llm import compat

INNER, OUTER, START = 0.8, 1.0, 2.0  # radii, and where the ring stands at first
LENGTH, HEIGHT, FACETS = 6.0, 1.0, 40  # of the block, whose top is y = 0
YOUNG, POISSON = (300.0, 1000.0), 0.3  # of block and ring
TOUCH, HELD = 1, 2
PRESSED = 0.3


def bodies(comm, refine=1):
    """(mesh, facet tags) of block and ring."""
    block = brick((0.0, -HEIGHT), (LENGTH, HEIGHT), (FACETS, 8), False, refine)
    s, cells = brick((0.0, 0.0), (1.0, 1.0), (3, 36), False, refine)
    r, angle = INNER + (OUTER - INNER) * s[:, 0], np.pi * (1.0 + s[:, 1])
    ring = np.column_stack([START + r * np.cos(angle), OUTER + r * np.sin(angle)]), cells
    radius = lambda p: np.hypot(p[0] - START, p[1] - OUTER)  # noqa: E731
    where = [
        (lambda p: np.isclose(p[1], 0.0), lambda p: np.isclose(p[1], -HEIGHT)),
        (lambda p: np.isclose(radius(p), OUTER), lambda p: np.isclose(p[1], OUTER)),
    ]
    scene, n = [], None if comm.rank == 0 else 0  # rank 0 brings the mesh
    for (x, cells), marks in zip((block, ring), where, strict=True):
        domain = compat.create_mesh(comm, cells[:n], x[:n], "quadrilateral")
        facets = [mesh.locate_entities_boundary(domain, 1, mark) for mark in marks]
        values = np.repeat([TOUCH, HELD], [len(f) for f in facets]).astype(np.int32)
        order = np.argsort(np.concatenate(facets))
        tags = mesh.meshtags(domain, 1, np.concatenate(facets)[order], values[order])
        scene.append((domain, tags))
    return scene


def problem(scene):
    """The problem, the Constant that moves the ring's ends, and the bodies' energies."""
    functions, forms, energies, bcs, ends = [], [], [], [], []
    for (domain, tags), young in zip(scene, YOUNG, strict=True):
        V = compat.function_space(domain, shape=(2,))
        u = fem.Function(V, name="u")
        mu, lam = (fem.Constant(domain, value) for value in lame(young, POISSON))
        energies.append(energy(u, mu, lam) * ufl.dx)
        forms.append(ufl.derivative(energies[-1], u, ufl.TestFunction(V)))
        held = fem.locate_dofs_topological(V, 1, tags.indices[tags.values == HELD])
        ends.append(fem.Constant(domain, (0.0, 0.0)))
        bcs.append(fem.dirichletbc(ends[-1], held, V))
        functions.append(u)
    (_, low), (_, high) = scene
    interface = llm.Interface(None, ((low, TOUCH), (high, TOUCH)), law=llm.Frictionless())
    contact = llm.NonlinearContactProblem(forms, functions, bcs=bcs, interfaces=[interface])
    return contact, ends[1], [fem.form(W) for W in energies]


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--refine", type=int, default=1, metavar="N")
    parser.add_argument("--travel", type=float, default=2.0, metavar="L")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    comm = MPI.COMM_WORLD
    contact, end, energies = problem(bodies(comm, args.refine))
    facet = LENGTH / (FACETS * args.refine)
    down, along = 8, max(1, round(2.0 * args.travel / facet))  # half a facet each
    ways = [(0.0, -PRESSED * (k + 1) / down) for k in range(down)]
    ways += [(args.travel * (k + 1) / along, -PRESSED) for k in range(along)]
    forces, work, before = [np.zeros(2)], 0.0, np.zeros(2)
    iterations, halved = [], 0
    for way in ways:
        end.value[:] = way
        contact.solve()
        iterations.append(len(contact.history))
        halved += len({entry["part"] for entry in contact.history}) > 1
        forces.append(-contact.results[0].resultant)  # what the ring does to the block
        work += 0.5 * (forces[-1] + forces[-2]) @ (np.array(way) - before)
        before = np.array(way)
    stored = comm.allreduce(sum(fem.assemble_scalar(W) for W in energies))
    sliding = np.array(forces[down + 1 :])
    found = {
        "force": float(-sliding[:, 1].mean()),
        "ripple": (np.ptp(sliding, axis=0) / 2 / -sliding[:, 1].mean()).tolist(),
        "drag": float(abs(sliding[:, 0].mean() / sliding[:, 1].mean())),
        "work": float(work / stored - 1.0),
        "iterations": (min(iterations), max(iterations)),
        "halved": halved,
    }
    if comm.rank == 0:
        print(contact)
        print(f"force {found['force']:.4f}, along the block {found['drag']:.1e} of it in the mean")
        print("ripple of the forces along and down: {:.2%}, {:.2%}".format(*found["ripple"]))
        print(f"work of the ends over stored energy - 1: {found['work']:.1e}")
        print(f"iterations per step {found['iterations']}, {halved} of {len(ways)} steps halved")
    if args.plot:
        contact.plot(args.plot)
    return found


if __name__ == "__main__":
    main()
