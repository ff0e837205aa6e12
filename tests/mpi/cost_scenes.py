"""Two blocks pressed and dragged, for the estimate of what forms cost: rank 0 prints, as JSON, what
each rank has found."""

import json
from dataclasses import asdict, replace

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.forms.cost import Scene

LAWS = {"tied": llm.Tied(), "frictionless": llm.Frictionless(), "friction": llm.Coulomb(0.3)}


DRAGS = (0.0, 0.004, 0.012, 0.05)  # over the height, in four load steps from stick to gross slip


def dragged(comm, dim, n, cell, law, gap=0.0, held=True, degree=1, height=1.0, solver="auto"):
    """Blocks of about n and 1.3 n nodes a side, not solved yet, drawn a gap apart, of which only
    contact holds the upper one if it is not ``held``; and what moves its top for a load step."""
    forms, loads, sides, bcs = [], [], [], []
    make, n = mesh.create_box if dim == 3 else mesh.create_rectangle, max(n // degree, 2)
    for up, m in ((0, n), (1, round(1.3 * n))):
        low, high = np.zeros(dim), np.ones(dim)
        low[-1] = up * (height + gap)
        high[-1] = low[-1] + height
        cells = [m] * (dim - 1) + [max(round(m * height), 1)]
        domain = make(comm, [low, high], cells, getattr(mesh.CellType, cell))
        ends = [
            mesh.locate_entities_boundary(domain, dim - 1, lambda x, z=z: np.isclose(x[dim - 1], z))
            for z in (low[-1], high[-1])
        ]
        at = np.sort(ends[1 - up])
        V = compat.function_space(domain, degree=degree, shape=(dim,))
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        eps = ufl.sym(ufl.grad(u))
        stress = eps / 1.3 + 0.3 / 1.3 / 0.4 * ufl.tr(eps) * ufl.Identity(dim)
        forms.append(ufl.inner(stress, ufl.grad(w)) * ufl.dx)
        loads.append(fem.Constant(domain, 0.0) * w[0] * ufl.dx)
        sides.append((mesh.meshtags(domain, dim - 1, at, np.ones(len(at), dtype=np.int32)), 1))
        moved, far = fem.Function(V), fem.locate_dofs_topological(V, dim - 1, ends[up])
        bcs += [fem.dirichletbc(moved, far)] * (held or not up)
    problem = llm.ContactProblem(
        forms, loads, bcs=bcs, interfaces=[llm.Interface(None, tuple(sides), law=LAWS[law])],
        solver=solver,
    )  # fmt: skip

    def load(k):
        across = V.tabulate_dof_coordinates()[far, 0] - 0.5
        values = moved.x.array.reshape(-1, dim)
        values[far, 0] = DRAGS[k] * height
        values[far, dim - 1] = height * (-0.02 + 0.005 * k * across)

    return problem, load


def blocks(comm, dim, n, cell, law="friction", **options):
    """The problem alone."""
    return dragged(comm, dim, n, cell, law, **options)[0]


CASES = [(2, 10, "triangle", "friction"), (3, 4, "tetrahedron", "tied"),
         (3, 4, "hexahedron", "frictionless"), (3, 4, "hexahedron", "friction")]  # fmt: skip


def chosen(comm):
    """What each rank has found: the scenes as one rank would see them, forms, and words."""
    problems = [blocks(comm, *case, gap=0.01 * k) for k, case in enumerate(CASES)]
    scenes = [Scene.of(problem.operators) for problem in problems]
    assert all(scene.ranks == comm.size for scene in scenes)
    scenes = [asdict(replace(scene, ranks=1)) for scene in scenes]
    found = {"scenes": json.loads(json.dumps(scenes)), "forms": [p.form for p in problems]}
    return found | {"told": [problem.method.setting.why for problem in problems]}


if __name__ == "__main__":
    every = MPI.COMM_WORLD.gather(chosen(MPI.COMM_WORLD))
    if MPI.COMM_WORLD.rank == 0:
        assert all(found["told"] == every[0]["told"] for found in every)
        print(json.dumps({"ranks": every}))
