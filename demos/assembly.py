"""A CAD assembly of ten parts: a STEP file is read, and what touches is found without a list.

A bracket is bolted to a plate, two bolts with washers and nuts; a pin is pressed into the bracket,
and a link hangs on it, whose end is pulled. Shanks have clearance in their holes, the link stands
off the bracket: these must not be taken for contact. The link may part from the pin and turn on
it; all else is tied. No part but plate and link has supports, so that forces on each must balance,
and plate and nuts hand on what the link pulls.

    mpirun -n 2 python demos/assembly.py [--size H] [--step FILE] [--plot DIR]
"""

import argparse
import tempfile
from pathlib import Path

import gmsh
import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

E, NU, PULL = 210e3, 0.3, 0.02  # MPa, -, mm
PARTS = "plate bracket bolt-1 bolt-2 washer-1 washer-2 nut-1 nut-2 pin link".split()
TOUCHES = [("plate", "bracket"), ("bracket", "pin"), ("pin", "link")]  # by hand
for n in "12":
    TOUCHES += [("bracket", f"washer-{n}"), (f"bolt-{n}", f"washer-{n}")]
    TOUCHES += [(f"bolt-{n}", f"nut-{n}"), ("plate", f"nut-{n}")]
OPENS = [("pin", "link")]
BOLTS, SHANK, HOLE = (-18.0, 18.0), 3.0, 3.5  # where bolts are along x, radii [mm]
FIT, PIN = 4.0, 22.0  # radius of the pin, its height over the plate [mm]


def build(path):
    """Draw the parts by gmsh's OpenCASCADE kernel and write them to a STEP file [mm]."""
    occ = gmsh.model.occ
    upright = lambda x, z, h, r: (3, occ.addCylinder(x, 0, z, 0, 0, h, r))  # noqa: E731
    across = lambda y, h, r: (3, occ.addCylinder(0, y, PIN, 0, h, 0, r))  # noqa: E731
    box = lambda *sizes: (3, occ.addBox(*sizes))  # noqa: E731
    holes = lambda z, h, r: [upright(x, z, h, r) for x in BOLTS]  # noqa: E731
    cut = lambda body, tools: occ.cut([body], tools)[0][0]  # noqa: E731
    cut(box(-30, -12, -6, 60, 24, 6), holes(-7, 8, HOLE))
    wall = box(-10, 6, 0, 20, 6, 32)
    foot = occ.fuse([box(-26, -12, 0, 52, 24, 5)], [wall])[0][0]
    cut(foot, [*holes(-1, 7, HOLE), across(5, 8, FIT)])
    for x in BOLTS:
        occ.fuse([upright(x, -12, 18.5, SHANK)], [upright(x, 6.5, 4, 5.0)])
    for x in BOLTS:
        cut(upright(x, 5, 1.5, 6.0), [upright(x, 4, 4, HOLE)])
    for x in BOLTS:
        cut(upright(x, -11, 5, 5.5), [upright(x, -12, 8, SHANK)])
    across(-4, 16, FIT)
    cut(box(-7, -3, PIN - 7, 14, 5, 30), [across(-5, 10, FIT)])
    occ.synchronize()
    gmsh.write(str(path))


def read(comm, path, size):
    """Mesh of a STEP file's parts, each meshed by itself, and cell tags 1, 2, ... in order."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    if comm.rank == 0:
        build(path)
        gmsh.clear()
        volumes = gmsh.model.occ.importShapes(str(path))
        gmsh.model.occ.synchronize()
        for k, (dim, volume) in enumerate(volumes, start=1):
            gmsh.model.addPhysicalGroup(dim, [volume], k)
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 12)
        gmsh.model.mesh.generate(3)
    domain, cells, *_ = compat.model_to_mesh(gmsh.model, comm, 0, gdim=3)
    gmsh.finalize()
    return domain, cells


def part_of(interface, domain, cells):
    """The parts of both sides of an interface."""
    names = []
    for tags, number in interface.tagged_sides():
        to_cell = domain.topology.connectivity(2, 3)
        mine = to_cell.array[to_cell.offsets[tags.find(number)]]
        kinds = cells.values[np.isin(cells.indices, mine)]
        names.append(domain.comm.allreduce(int(kinds.max(initial=0)), op=MPI.MAX))
    return tuple(PARTS[k - 1] for k in names)


def problem(domain, cells):
    """The problem, with interfaces by laws; pairs that touch, found without; the link's pull."""
    V = compat.function_space(domain, shape=(3,))
    number = {name: k for k, name in enumerate(PARTS, start=1)}
    every = [tuple(sorted(part_of(i, domain, cells))) for i in llm.find_interfaces(None, V)]
    laws = {(number[a], number[b]): llm.Tied() for a, b in TOUCHES}
    laws |= {(number[a], number[b]): llm.Frictionless() for a, b in OPENS}
    interfaces = llm.find_interfaces(None, V, laws=laws, cell_tags=cells)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    eps = ufl.sym(ufl.grad(u))
    stress = E / (1 + NU) * (eps + NU / (1 - 2 * NU) * ufl.tr(eps) * ufl.Identity(3))
    a = ufl.inner(stress, ufl.grad(v)) * ufl.dx
    L = ufl.inner(fem.Constant(domain, np.zeros(3)), v) * ufl.dx
    ends = lambda p: np.isclose(np.abs(p[0]), 30.0)  # noqa: E731
    top = lambda p: np.isclose(p[2], PIN + 23.0)  # noqa: E731
    pull = fem.Constant(domain, (0.0, 0.0, PULL))
    bcs = [
        fem.dirichletbc(value, fem.locate_dofs_topological(V, 2, facets), V)
        for value, facets in (
            (np.zeros(3), mesh.locate_entities_boundary(domain, 2, ends)),
            (pull, mesh.locate_entities_boundary(domain, 2, top)),
        )
    ]
    return llm.ContactProblem(a, L, bcs=bcs, interfaces=interfaces), every


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=float, default=5.0, metavar="H", help="of the cells [mm]")
    parser.add_argument("--step", type=Path, metavar="FILE", help="where the STEP file is kept")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    comm = MPI.COMM_WORLD
    with tempfile.TemporaryDirectory() as folder:
        domain, cells = read(comm, args.step or Path(folder) / "assembly.step", args.size)
    contact, every = problem(domain, cells)
    contact.solve()
    force = {}  # that the first named part exerts on the second
    for interface, result in zip(contact.interfaces, contact.results, strict=True):
        a, b = part_of(interface, domain, cells)
        force[a, b], force[b, a] = result.resultant, -result.resultant
    free = [name for name in PARTS if name not in ("plate", "link")]
    net = [sum(f for (a, _), f in force.items() if a == name) for name in free]
    pulled = force["link", "pin"]
    by_hand = {tuple(sorted(pair)) for pair in TOUCHES}
    through = force["bracket", "plate"] + sum(force[f"nut-{n}", "plate"] for n in "12")
    found = {
        "parts": len(PARTS),
        "pairs": len(every),
        "missed": sorted(by_hand - set(every)),
        "besides": sorted(set(every) - by_hand),
        "pull": float(pulled[2]),
        "balance": float(np.abs(net).max() / np.abs(pulled).max()),
        "through": float(through[2] / pulled[2]),
    }
    if comm.rank == 0:
        print(contact)
        print(f"{found['parts']} parts, {found['pairs']} pairs that touch; by hand {len(by_hand)}")
        print(f"missed: {found['missed']}; besides: {found['besides']}")
        print(
            f"the link pulls with {found['pull']:.1f} N; of that comes to the plate: "
            f"{found['through']:.12f}"
        )
        print(f"largest force that is left on a part, over the pull: {found['balance']:.1e}")
    if args.plot:
        contact.plot(args.plot, colour="displacement")
    return found


if __name__ == "__main__":
    main()
