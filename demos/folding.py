"""A hairpin pressed flat until its sides touch: a surface that folds onto itself.

Half a ring with two legs, neo-Hookean and in plane strain. Jaws press the legs together; the
inner surface is tagged as a whole, and what touches of it is found by itself. The scene is
symmetric about its middle, and so must be the forces, though one part of the surface carries the
frame and the other moves on it; no node may lie behind what it touches.

    mpirun -n 2 python demos/folding.py [--refine N] [--mu MU] [--skew S] [--steps N] [--plot DIR]
"""

import argparse
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from finite_patch import energy, lame
from mpi4py import MPI
from patch2d import CELLS, brick

import dolfinx_llm as llm
from dolfinx_llm import compat

RADIUS, THICK, LEG = 1.0, 0.12, 1.0  # of the inner surface; of the wall; straight, at either end
DEEP, LAYERS = 0.3, 2  # in 3D, where the hairpin stays in its plane: depth, and cells along it
YOUNG, POISSON = 100.0, 0.3
INSIDE, OUTSIDE = 1, 2
ALONG, ACROSS = 60, 2  # cells
PRESSED = 0.04  # beyond what brings the legs into touch, of each


def bent(way, depth):
    """(n, 2) points at a way along the inner surface from its middle, at a depth in the wall."""
    turn = np.clip(way / RADIUS, -0.5 * np.pi, 0.5 * np.pi)
    leg = np.maximum(np.abs(way) - 0.5 * np.pi * RADIUS, 0.0)
    r = RADIUS + depth
    return np.column_stack([r * np.cos(turn) - leg, r * np.sin(turn)])


def hairpin(comm, refine=1, skew=0.0, half=False, kind="quad", layers=LAYERS):
    """Mesh and facet tags, if so wished of the upper half; cells are longer on one side of the
    middle by a part ``skew``."""
    part, dim = 1 + (not half), 3 if kind in ("hex", "tet") else 2
    box = (0.0, 1.0 - part, 0.0), (1.0, part, DEEP), (ACROSS, part * ALONG // 2, layers)
    s, cells = brick(*(values[:dim] for values in box), kind in ("tri", "tet"), refine)
    way = (0.5 * np.pi * RADIUS + LEG) * (s[:, 1] + skew * (1.0 - s[:, 1] ** 2))
    x = np.column_stack([bent(way, THICK * s[:, 0]), s[:, 2:]])
    n = None if comm.rank == 0 else 0  # rank 0 brings the mesh
    domain = compat.create_mesh(comm, cells[:n], x[:n], CELLS[kind])
    out = lambda p: np.maximum(np.abs(p[1]), np.hypot(np.maximum(p[0], 0.0), p[1]))  # noqa: E731
    marks = [lambda p, r=r: np.abs(out(p) - r) < 1e-3 * THICK for r in (RADIUS, RADIUS + THICK)]
    facets = [mesh.locate_entities_boundary(domain, dim - 1, mark) for mark in marks]
    values = np.repeat([INSIDE, OUTSIDE], [len(f) for f in facets]).astype(np.int32)
    order = np.argsort(np.concatenate(facets))
    return domain, mesh.meshtags(domain, dim - 1, np.concatenate(facets)[order], values[order])


def problem(domain, tags, mu=0.0, interfaces=None, solver="auto", middle=False, degree=1):
    """The problem, and the Constants by which both jaws move the legs, whose ends stay in place
    along the jaws; ``interfaces`` in the place of self contact, ``middle``: held there."""
    dim = domain.geometry.dim
    V = compat.function_space(domain, degree=degree, shape=(dim,))
    u = fem.Function(V, name="u")
    stiff = (fem.Constant(domain, value) for value in lame(YOUNG, POISSON))
    F = ufl.derivative(energy(u, *stiff) * ufl.dx(degree=4), u, ufl.TestFunction(V))
    bcs, jaws = [], [fem.Constant(domain, 0.0) for _ in range(2)]
    V0, _ = V.sub(0).collapse()
    end = lambda p: np.isclose(p[0], -LEG) & np.isclose(np.abs(p[1]), RADIUS + THICK)  # noqa: E731
    dofs = fem.locate_dofs_geometrical((V.sub(0), V0), end)
    bcs.append(fem.dirichletbc(fem.Function(V0), dofs, V.sub(0)))
    for k, at in [(1, [0.0])] * middle + [(2, [0.0, DEEP])] * (dim - 2):
        Vk, _ = V.sub(k).collapse()
        held = lambda p, k=k, at=at: np.isclose(p[k], np.c_[at]).any(axis=0)  # noqa: E731
        dofs = fem.locate_dofs_geometrical((V.sub(k), Vk), held)
        bcs.append(fem.dirichletbc(fem.Function(Vk), dofs, V.sub(k)))
    for jaw, side in zip(jaws, (-1.0, 1.0), strict=True):
        leg = lambda p, s=side: np.isclose(s * p[1], RADIUS + THICK) & (p[0] < 1e-9)  # noqa: E731
        facets = mesh.locate_entities_boundary(domain, dim - 1, leg)
        dofs = fem.locate_dofs_topological(V.sub(1), dim - 1, facets)
        bcs.append(fem.dirichletbc(jaw, dofs, V.sub(1)))
    law = llm.Coulomb(mu) if mu else llm.Frictionless()
    contact = interfaces or [llm.SelfContact(tags, INSIDE, law)]
    return llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=contact, solver=solver), jaws


def overlap(x, facets):
    """Deepest node of a surface behind one of its facets that faces it, over the largest facet."""
    a, b = x[facets[:, 0]], x[facets[:, 1]]
    along = b - a
    size = np.linalg.norm(along, axis=1)
    inward = np.column_stack([along[:, 1], -along[:, 0]]) / size[:, None]
    arm = x[:, None] - a
    depth = np.einsum("nfi,fi->nf", arm, inward)
    place = np.einsum("nfi,fi->nf", arm, along) / size**2
    behind = (depth > 0.0) & (depth < 0.8 * THICK) & (place > 0.0) & (place < 1.0)
    behind[facets, np.arange(len(facets))[:, None]] = False
    return depth[behind].max(initial=0.0) / size.max()


def asymmetry(side_pair):
    """Largest difference of the forces of mirrored nodes, over the largest force."""
    force, X = side_pair[0].force + side_pair[1].force, side_pair[0].X
    turn = np.array([1.0, -1.0, 1.0])[: X.shape[1]]
    mirrored = np.linalg.norm(X[:, None] - X * turn, axis=2).argmin(axis=1)
    return np.abs(force - force[mirrored] * turn).max() / np.abs(force).max()


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--refine", type=int, default=1, metavar="N")
    parser.add_argument("--mu", type=float, default=0.0, help="coefficient of friction")
    parser.add_argument("--skew", type=float, default=0.0, help="of the mesh, up to 0.2")
    parser.add_argument("--steps", type=int, default=6, metavar="N", help="before, and in contact")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    comm = MPI.COMM_WORLD
    contact, jaws = problem(*hairpin(comm, args.refine, args.skew), args.mu)
    film = llm.plot.Film(contact, args.plot / "folding.gif") if args.plot else None
    free = np.linspace(0.0, RADIUS - 0.04, args.steps + 1)[1:]
    ways = [*free, *np.linspace(free[-1], RADIUS + PRESSED, args.steps + 1)[1:]]
    found = {"iterations": [], "halved": 0, "overlap": 0.0, "asymmetry": 0.0}
    for way in ways:
        for jaw, side in zip(jaws, (1.0, -1.0), strict=True):
            jaw.value = side * way
        contact.solve()
        if film:
            film.add()
        (result,) = contact.results
        found["iterations"].append(contact.history[-1]["iteration"])
        found["halved"] += len({entry["part"] for entry in contact.history}) > 1
        side = result.sides[0]
        found["overlap"] = max(found["overlap"], overlap(side.x, side.facets))
        if contact.history[-1]["active"]:
            found["asymmetry"] = max(found["asymmetry"], asymmetry(result.sides))
    found |= {"pairs": contact.history[-1]["active"], "force": float(abs(result.resultant[1]))}
    if comm.rank == 0:
        print(contact)
        print(f"{found['pairs']} pairs in contact, which carry {found['force']:.6f}")
        if not args.skew:
            print(f"forces of mirrored nodes differ by {found['asymmetry']:.1e} of the largest")
        print(f"deepest overlap over the size of a facet: {found['overlap']:.1e}")
        print(f"iterations {found['iterations']}, {found['halved']} steps in parts")
    if film:
        film.close()
        contact.plot(args.plot)
    return found


if __name__ == "__main__":
    main()
