"""Tools that supports lead as a whole, let go between load steps, and led again.

Prints, as JSON, per case the largest difference from a problem that is made afterwards.
"""

import itertools
import json
import sys

import finite_patch
import numpy as np
import scenes
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from sampling import covering

import dolfinx_llm as llm
from dolfinx_llm import compat

LAWS = {"tied": llm.Tied(), "frictionless": llm.Frictionless(), "friction": llm.Coulomb(0.3)}
# Kind of problem, law, and whether the tool is led at first.
SCENES = list(itertools.product(("linear", "finite"), LAWS, (False, True)))


def cases(ranks, part=slice(None)):
    """Scenes, order of the bodies, and whether the tool is named first; all, or some of them."""
    rows = covering(SCENES, (1, 2), (False, True), (1, 2))
    return [row[:-1] for row in rows if row[-1] == ranks][part]


class Scene:
    """A block of four cells across, and a tool of seven whose top is held down."""

    def __init__(self, comm, kind, law, degree, first):
        self.kind, self.u, forms, held, sides = kind, [], [], [], []
        for low, n in ((0.0, 4), (1.0, 7)):
            domain = mesh.create_rectangle(comm, [(0.0, low), (1.0, low + 1.0)], [n, 3])
            V = compat.function_space(domain, degree=degree, shape=(2,))
            u, w = fem.Function(V), ufl.TestFunction(V)
            if kind == "finite":
                energy = finite_patch.energy(u, *finite_patch.lame(10.0, 0.3))
                forms.append((ufl.derivative(energy * ufl.dx, u, w),))
            else:
                forms.append(scenes.forms(V))
            end = scenes.on(1, 2.0 * len(sides))
            found = mesh.locate_entities_boundary(domain, 1, scenes.on(1, 1.0))
            tags = mesh.meshtags(domain, 1, np.sort(found), np.full(len(found), 1, dtype=np.int32))
            sides.append((tags, 1))
            held.append(fem.locate_dofs_geometrical(V, end))
            self.u.append(u)
        low, high = (u.function_space for u in self.u)
        self.bcs = [
            fem.dirichletbc(fem.Constant(V.mesh, (0.0, down)), at, V)
            for V, at, down in zip((low, high), held, (0.0, -0.1), strict=True)
        ]
        at = fem.locate_dofs_geometrical(high, scenes.on(1, 1.0))
        self.leads = fem.dirichletbc(fem.Constant(high.mesh, (0.0, -0.02)), at, high)
        interface = llm.Interface(None, sides[::-1] if first else sides, law=LAWS[law])
        self.args = list(zip(*forms)), interface

    def solve(self, led):
        """Forces and displacements at the end of a step."""
        self.bcs[2:] = [self.leads] if led else []
        if not hasattr(self, "problem"):
            forms, interface = self.args
            given = dict(bcs=self.bcs, interfaces=[interface])
            if self.kind == "finite":
                self.problem = llm.NonlinearContactProblem(list(forms[0]), self.u, **given)
            else:
                self.problem = llm.ContactProblem(*map(list, forms), **given)
        u = self.problem.solve()
        forces = [side.force.ravel() for side in self.problem.results[0].sides]
        own = [f.x.array[: 2 * f.function_space.dofmap.index_map.size_local] for f in u]
        return np.concatenate(forces), np.concatenate(own)


def difference(comm, found, known):
    """Largest difference of forces and displacements, over the largest."""
    worst = 0.0
    for a, b in zip(found, known, strict=True):
        far, size = (comm.allreduce(np.abs(c).max(initial=0.0), op=MPI.MAX) for c in (a - b, b))
        worst = max(worst, far / size)
    return float(worst)


def compare(comm, scene, degree, first):
    """A step after another one, in which supports led the tool or did not, against that step alone;
    with friction two steps that change nothing but who holds the tool, against none."""
    kind, law, led = scene
    one, other = (Scene(comm, kind, law, degree, first) for _ in range(2))
    before = one.solve(led)
    if law != "friction":
        return difference(comm, one.solve(not led), other.solve(not led))
    if led:
        before = one.solve(False)
    where = fem.Function(one.u[1].function_space)
    where.x.array[:] = one.problem.u[1].x.array
    at = fem.locate_dofs_geometrical(where.function_space, scenes.on(1, 1.0))
    one.leads = fem.dirichletbc(where, at)
    one.solve(True)
    return difference(comm, one.solve(False), before)


if __name__ == "__main__":
    comm = MPI.COMM_WORLD
    part = slice(int(sys.argv[1]), None, 3)
    found = {repr(case): compare(comm, *case) for case in cases(comm.size, part)}
    if comm.rank == 0:
        print(json.dumps(found))
