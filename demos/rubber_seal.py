"""An O-ring of rubber squeezed between two plates, from a gmsh model.

Half of its round section is meshed by gmsh; the plates are rigid obstacles, the upper one comes
down. The rubber is neo-Hookean, in plane strain. For a small squeeze d of a cylinder of radius R
between two plates the linear theory (K. L. Johnson, Contact Mechanics, 1985) has, with F the force
per length, half of the width of contact a and the largest pressure p0,

    d = 2 F / (pi E*) (2 ln(4 R / a) - 1),   a² = 4 F R / (pi E*),   p0 = 2 F / (pi a).

    mpirun -n 2 python demos/rubber_seal.py [--refine N] [--squeeze C] [--plot DIR]
"""

import argparse
from pathlib import Path

import gmsh
import numpy as np
import ufl
from dolfinx import fem
from finite_patch import energy, lame
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

DIAMETER, YOUNG, POISSON = 5.0, 6.0, 0.45  # mm, N / mm²
SKIN, MIDDLE, RUBBER = 1, 2, 3


def seal(comm, refine=1):
    """Mesh and facet tags of the right half of the section, of quads."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    if comm.rank == 0:
        r, geo = DIAMETER / 2, gmsh.model.geo
        low, mid, high, side = (
            geo.addPoint(*p, 0, 0.16 * r / refine) for p in ((0, -r), (0, 0), (0, r), (r, 0))
        )
        arcs = [geo.addCircleArc(low, mid, side), geo.addCircleArc(side, mid, high)]
        lines = [geo.addLine(high, mid), geo.addLine(mid, low)]
        surface = geo.addPlaneSurface([geo.addCurveLoop([*arcs, *lines])])
        geo.synchronize()
        for dim, entities, tag in ((1, arcs, SKIN), (1, lines, MIDDLE), (2, [surface], RUBBER)):
            gmsh.model.addPhysicalGroup(dim, entities, tag)
        gmsh.option.setNumber("Mesh.RecombineAll", 1)
        gmsh.option.setNumber("Mesh.SubdivisionAlgorithm", 1)  # quads alone
        gmsh.model.mesh.generate(2)
    domain, _, tags, *_ = compat.model_to_mesh(gmsh.model, comm, 0, gdim=2)
    gmsh.finalize()
    return domain, tags


def problem(domain, tags):
    """The problem, and the upper plate, which touches at first."""
    V = compat.function_space(domain, shape=(2,))
    u = fem.Function(V)
    mu, lam = (fem.Constant(domain, value) for value in lame(YOUNG, POISSON))
    stored = energy(u, mu, lam) * ufl.dx(degree=3)
    middle = fem.locate_dofs_topological(V.sub(0), 1, tags.indices[tags.values == MIDDLE])
    r = DIAMETER / 2
    plates = [llm.RigidPlane((0.0, -r), (0.0, 1.0)), llm.RigidPlane((0.0, r), (0.0, -1.0))]
    contact = llm.NonlinearContactProblem(
        ufl.derivative(stored, u, ufl.TestFunction(V)),
        u,
        bcs=[fem.dirichletbc(0.0, middle, V.sub(0))],
        interfaces=[llm.Interface(tags, (SKIN, p), law=llm.Frictionless()) for p in plates],
    )
    return contact, plates[1]


def linear(squeeze):
    """Force per length [N / mm] and largest pressure for the squeeze over the diameter, by halving
    an interval of forces."""
    stiff, r, low, high = YOUNG / (1 - POISSON**2), DIAMETER / 2, 0.0, YOUNG * DIAMETER
    for _ in range(60):
        F = 0.5 * (low + high)
        a = np.sqrt(4 * F * r / (np.pi * stiff))
        d = 2 * F / (np.pi * stiff) * (2 * np.log(4 * r / a) - 1)
        low, high = (low, F) if d > squeeze * DIAMETER else (F, high)
    return F, 2 * F / (np.pi * a)


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--refine", type=int, default=1, metavar="N")
    parser.add_argument("--squeeze", type=float, default=0.3, metavar="C")
    parser.add_argument("--steps", type=int, default=6, metavar="N")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    contact, plate = problem(*seal(MPI.COMM_WORLD, args.refine))
    root = MPI.COMM_WORLD.rank == 0
    if root:
        print(contact)
        print("squeeze   force  over linear    width  pressure  over linear  iterations")
    rows = []
    for C in args.squeeze * np.arange(1, args.steps + 1) / args.steps:
        plate.displacement = (0.0, -C * DIAMETER)
        contact.solve()
        low, high = (result.sides[0] for result in contact.results)
        force = 2.0 * high.normal_force.sum()  # of both halves
        width = 2.0 * high.x[high.status > 0, 0].max()
        rows.append({
            "squeeze": float(C),
            "force": float(force),
            "ratio": float(force / linear(C)[0]),
            "balance": float(np.abs(low.normal_force.sum() / high.normal_force.sum() - 1.0)),
            "width": float(width),
            "pressure": float(contact.results[1].pressure.max()),
            "peak": float(contact.results[1].pressure.max() / linear(C)[1]),
            "iterations": len(contact.history),
            "parts": len({entry["part"] for entry in contact.history}),
        })  # fmt: skip
        if root:
            line = "{squeeze:7.3f} {force:7.3f} {ratio:12.3f} {width:8.3f} {pressure:9.3f} "
            print((line + "{peak:12.3f} {iterations:11d}").format(**rows[-1]))
    if args.plot:
        contact.plot(args.plot)
    return rows


if __name__ == "__main__":
    main()
