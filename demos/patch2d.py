"""The 2D contact patch test of Taylor and Papadopoulos (paper, Figures 1 and 2).

A punch stands on a wider foundation, in plane strain, with meshes that do not match. Pressure on
all that is free of the upper surfaces must give the same uniaxial stress in both bodies.

    mpirun -n 2 python demos/patch2d.py [--cells tri] [--refine N] [--separate] ...
"""

import argparse
import json
from itertools import permutations, product
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

E, NU, PRESSURE = 1000.0, 0.4, 10.0
FOUNDATION_TOP, PUNCH_BOTTOM, PUNCH_TOP = 1, 2, 3
# Lower left corner, width and height, cells along x and y.
FOUNDATION = ((0.0, 0.0), (4.0, 1.0), (7, 3))
PUNCH = ((1.1, 1.0), (2.0, 1.0), (5, 4))


# ## The bodies
CELLS = {"quad": "quadrilateral", "tri": "triangle", "hex": "hexahedron", "tet": "tetrahedron"}


def brick(corner, size, cells, simplices, refine=1, rough=0.0):
    """Nodes and cells, in dolfinx's order, of a regular mesh of a box in 2D or 3D; inner nodes are
    moved by up to ``rough`` cells, those of the outside along it."""
    counts = np.array(cells) * refine
    dim, axes = len(counts), [np.linspace(0, 1, n + 1) for n in counts]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dim)
    first = np.ravel_multi_index(np.indices(counts).reshape(dim, -1), counts + 1)
    step = np.append(np.cumprod(counts[:0:-1] + 1)[::-1], 1)  # between nodes along each axis
    if simplices:  # from the first corner to the last, along the axes in every order
        paths = [np.cumsum([0, *step[list(p)]]) for p in permutations(range(dim))]
        found = np.concatenate([first[:, None] + path for path in paths])
    else:
        found = first[:, None] + np.array(list(product((0, 1), repeat=dim))) @ step
    rng = np.random.default_rng(len(x))
    x += rng.uniform(-rough, rough, x.shape) / counts * ((x > 0.0) & (x < 1.0))
    return x * size + corner, found


def bodies(
    comm, kind="quad", refine=1, separate=False, scale=1.0, boxes=(FOUNDATION, PUNCH), rough=0.0
):
    """(mesh, facet tags) of both bodies together, or of each; lengths times scale. ``kind`` may be
    a pair for bodies apart."""
    kinds = (kind, kind) if isinstance(kind, str) else kind
    built = [brick(*b, k in ("tri", "tet"), refine, rough) for b, k in zip(boxes, kinds)]
    (x0, c0), (x1, c1) = built
    parts = built if separate else [(np.r_[x0, x1], np.r_[c0, c1 + len(x0)])]
    n = None if comm.rank == 0 else 0  # rank 0 brings the mesh
    dim, scene = x0.shape[1], []
    for (x, cells), k in zip(parts, kinds):
        domain = compat.create_mesh(comm, cells[:n], scale * x[:n], CELLS[k])
        domain.topology.create_connectivity(dim - 1, dim)
        to_cell = domain.topology.connectivity(dim - 1, dim)
        centres = domain.geometry.x[compat.cell_dofs(domain.geometry)].mean(axis=1)
        middle = centres[:, dim - 1] / scale
        values = np.zeros(len(to_cell.offsets) - 1, dtype=np.int32)
        # Facets at level 1 belong to the body that their cell lies in.
        for z, low, high in ((1.0, FOUNDATION_TOP, PUNCH_BOTTOM), (2.0, PUNCH_TOP, 0)):
            on = lambda p, z=z: np.isclose(p[dim - 1] / scale, z)  # noqa: E731
            at = mesh.locate_entities_boundary(domain, dim - 1, on)
            values[at] = np.where(middle[to_cell.array[to_cell.offsets[at]]] > z, high, low)
        tagged = np.flatnonzero(values).astype(np.int32)
        scene.append((domain, mesh.meshtags(domain, dim - 1, tagged, values[tagged])))
    return scene


# ## The problem
def stress(u):
    """Hooke's law in plane strain."""
    eps = ufl.sym(ufl.grad(u))
    return E / (1 + NU) * (eps + NU / (1 - 2 * NU) * ufl.tr(eps) * ufl.Identity(2))


def exact(x):
    """Displacement at points (n, 2) under the uniaxial stress -q along y."""
    return PRESSURE * (1 + NU) / E * x * [NU, NU - 1.0]


def problem(scene, design="positions", frame=None, order=(0, 1)):
    """The contact problem; ``order`` of the sides of the interface."""
    spaces = [compat.function_space(domain, shape=(2,)) for domain, _ in scene]
    (low, low_tags), (high, high_tags) = ((spaces[i], scene[i][1]) for i in (0, -1))
    bcs = []  # sliding on the bottom, its left end fixed
    bottom, corner = (lambda p, n=n: np.isclose(p[n:2], 0.0).all(axis=0) for n in (1, 0))
    for k, where in ((1, bottom), (0, corner)):
        Vk, _ = low.sub(k).collapse()
        dofs = fem.locate_dofs_geometrical((low.sub(k), Vk), where)
        bcs.append(fem.dirichletbc(fem.Function(Vk), dofs, low.sub(k)))
    cover = (high, high_tags, PUNCH_BOTTOM)[low is high :]  # its space, if it is another
    loads = [llm.free_surface_load(high, high_tags, PUNCH_TOP, PRESSURE)]
    loads += [llm.free_surface_load(low, low_tags, FOUNDATION_TOP, PRESSURE, covered_by=cover)]
    a, L = [], []
    for V in spaces:
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        a.append(ufl.inner(stress(u), ufl.grad(w)) * ufl.dx)
        L.append(ufl.inner(fem.Constant(V.mesh, np.zeros(2)), w) * ufl.dx)
    sides = ((low_tags, FOUNDATION_TOP), (high_tags, PUNCH_BOTTOM))
    interface = llm.Interface(None, tuple(sides[i] for i in order), design=design, frame=frame)
    return llm.ContactProblem(a, L, bcs=bcs, interfaces=[interface], nodal_loads=loads)


# ## The figures
def errors(u, forces, areas):
    """Largest errors of stress, displacement (relative) and contact forces over their area."""
    ds, du, size = 0.0, 0.0, 0.0
    for f in u:
        domain = f.function_space.mesh
        points = compat.quadrature_points(domain, 2)
        sigma = compat.evaluate(stress(f), points, domain, (2, 2)) / PRESSURE
        ds = max(ds, np.abs(sigma - np.diag([0.0, -1.0])).max(initial=0.0))
        known = exact(f.function_space.tabulate_dof_coordinates()[:, :2])
        du = max(du, np.abs(f.x.array.reshape(known.shape) - known).max(initial=0.0))
        size = max(size, np.abs(known).max(initial=0.0))
    ds, du, size = (domain.comm.allreduce(float(e), op=MPI.MAX) for e in (ds, du, size))
    dp = [np.abs(n / PRESSURE - A).max() / A.max() for n, A in zip(forces, areas, strict=True)]
    return {"stress": ds, "displacement": du / size, "pressure": float(max(dp))}


def table(scene, contact):
    """Errors and frame residual by method; "none": the coarser side's mesh as frame."""
    rows = {}
    for design in ("positions", "weights", None):
        this = contact if contact.interfaces[0].design == design else problem(scene, design)
        u, result = this.solve(), this.results[0]
        found = errors(u, *zip(*((s.normal_force, s.area) for s in result.sides), strict=True))
        rows[str(design).lower()] = found | {"residual": result.certificate.residual}
    for slave, name in enumerate(("foundation", "punch")):
        classical = llm.classical.NodeToSegment(contact, slave=slave)
        u, pairs = classical.solve(), contact.geometries[0].pairs[slave]
        force = np.zeros(len(pairs.x))  # slave nodes beyond the master's ends carry none
        at = np.linalg.norm(pairs.x[:, None] - classical.x, axis=2).argmin(axis=0)
        force[at] = classical.force[:, 1] * (1 if slave else -1)
        rows[f"node-to-segment, slave {name}"] = errors(u, [force], [pairs.forces])
    return rows


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", choices=["tri", "quad"], default="quad")
    parser.add_argument("--refine", type=int, default=1, metavar="N")
    parser.add_argument("--design", choices=["positions", "weights", "none"], default="positions")
    parser.add_argument("--separate", action="store_true", help="one dolfinx mesh per body")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    scene = bodies(MPI.COMM_WORLD, args.cells, args.refine, args.separate)
    contact = problem(scene, None if args.design == "none" else args.design)
    rows = table(scene, contact)
    if MPI.COMM_WORLD.rank == 0:
        print(f"{contact}\n\n{'relative errors':32}" + "".join(f"{n:>14}" for n in rows["none"]))
        for name, row in rows.items():
            print(f"{name:32}" + "".join(f"{value:14.2e}" for value in row.values()))
        if args.json:
            args.json.write_text(json.dumps({"rows": rows, "unknowns": contact.unknowns}) + "\n")
    for k, f in enumerate(contact.solve() if args.plot else []):
        plot.bodies(f, -stress(f)[1, 1], args.plot / f"pressure_{k}.png", label="-σ_yy")
    return rows


if __name__ == "__main__":
    main()
