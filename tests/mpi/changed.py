"""Problems whose data change between two solves, against problems that are made afterwards.

Prints, as JSON, the largest difference of displacements and forces, relative, per case.
"""

import json
import sys

import numpy as np
import scenes
import ufl
from dolfinx import fem
from mpi4py import MPI
from sampling import covering

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.forms import choice

DIRECT = {"ksp_type": "preonly", "pc_type": "cholesky"}
LAWS = {"tied": llm.Tied(), "frictionless": llm.Frictionless(), "friction": llm.Coulomb(0.3)}
FORMS = ("saddle", "condensed", "flexibility")


class Data:
    """All that a problem of two blocks is made of; the upper one is moved at its top."""

    def __init__(self, comm):
        self.V, self.tags = scenes.two_blocks(comm, 3, 2, layers=(2, 1))
        mesh = self.V.mesh
        self.E, self.step = fem.Constant(mesh, 1.0), fem.Constant(mesh, 0.1)
        self.density = fem.Function(compat.function_space(mesh, "DG", 0))
        self.density.x.array[:] = 5.0
        self.force = fem.Constant(mesh, (3.0, -2.0, -40.0))
        self.base, self.motion = fem.Function(self.V), fem.Function(self.V)
        self.bcs = [self.held(self.base, 0.0), self.held(self.motion, 2.0)]
        self.move(0.02, -0.03)

    def held(self, value, level):
        return fem.dirichletbc(value, fem.locate_dofs_geometrical(self.V, scenes.on(2, level)))

    def move(self, drag, press):
        self.motion.interpolate(lambda p: np.array([drag + 0 * p[0], 0 * p[0], press + 0 * p[0]]))

    def problem(self, law, form):
        u, w = ufl.TrialFunction(self.V), ufl.TestFunction(self.V)
        inertia = self.density / self.step * ufl.inner(u, w) * ufl.dx
        choice.FLEXIBLE = 10**6 if form == "flexibility" else 0
        return llm.ContactProblem(
            self.E * ufl.inner(scenes.stress(u), ufl.grad(w)) * ufl.dx + inertia,
            ufl.inner(self.force, w) * ufl.dx,
            bcs=self.bcs,
            interfaces=llm.Interface(self.tags, (2, 3), law=LAWS[law]),
            solver="saddle" if form == "flexibility" else form,
            petsc_options=DIRECT if form == "condensed" else None,
        )


def modulus(data):
    data.E.value = 3.0


def time_step(data):
    data.step.value = 0.004


def coefficient(data):
    x = data.density.function_space.tabulate_dof_coordinates()
    data.density.x.array[:] = 5.0 + 40.0 * x[: len(data.density.x.array), 0]


def mesh(data):
    x = data.V.mesh.geometry.x
    x[:, 0] += 0.1 * x[:, 1] ** 2
    x[:, 2] *= 1.0 + 0.1 * x[:, 0]


def function(data):
    """A Function that conditions were made of."""
    data.move(-0.01, -0.02)


def values(data):
    data.base.x.array[:] = 0.01


def dofs(data):
    """Another condition, in the list that the problem was given."""
    data.bcs[0] = data.held(data.base, 0.0)
    side = fem.locate_dofs_geometrical(data.V, lambda p: np.isclose(p[0], 0.0) & (p[2] < 0.9))
    data.bcs.append(fem.dirichletbc(data.base, side))


CHANGES = (modulus, time_step, coefficient, mesh, function, values, dofs)


def state(problem, u):
    n = problem.bulk.dofs.sizes[0]
    forces = [side.force.ravel() for result in problem.results for side in result.sides]
    return {"u": u.x.array[:n].copy(), "force": np.concatenate(forces)}


def difference(comm, found, known):
    worst = 0.0
    for key in known:
        size = max(comm.allgather(np.abs(known[key]).max(initial=0.0)))
        gap = max(comm.allgather(np.abs(found[key] - known[key]).max(initial=0.0)))
        worst = max(worst, gap / size)
    return float(worst)


# Pairs of levels of law, form, change and number of ranks, in place of the whole product.
CASES = covering(
    list(LAWS), FORMS, CHANGES, (1, 2), fits=lambda law, form, *_: (law, form) != ("tied", FORMS[2])
)


def cases(ranks, part=None):
    """(law, form) to changes that are made one after the other; every eighth one, or all."""
    found = {}
    for law, form, change, n in CASES:
        if n == ranks:
            found.setdefault((law, form), []).append(change)
    return found if part is None else dict(list(found.items())[part::8])


def compare(comm, law, form, changes):
    """Per change how far the problem is then from a new one, and the new one from before."""
    data, out = Data(comm), {}
    problem = data.problem(law, form)
    known = state(problem, problem.solve())
    for change in changes:
        before = known
        change(data)
        if law == "friction" and change is not mesh:
            problem.reset()  # what has slipped depends on the way
        found = state(problem, problem.solve())
        fresh = data.problem(law, form)
        known = state(fresh, fresh.solve())
        out[f"{law} {form} {change.__name__}"] = (
            difference(comm, found, known), difference(comm, before, known),
        )  # fmt: skip
        assert problem.form == fresh.form == form
        fresh.destroy()
    problem.destroy()
    return out


if __name__ == "__main__":
    comm, out = MPI.COMM_WORLD, {}
    for (law, form), changes in cases(comm.size, int(sys.argv[1])).items():
        out |= compare(comm, law, form, changes)
    if comm.rank == 0:
        print(json.dumps(out))
