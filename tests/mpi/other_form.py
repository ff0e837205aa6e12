"""Contact that comes to no rest in one form, with laws that differ, and remember: rank 0 prints, as
JSON, forces of all load steps, as they were asked for and where another form goes on."""

import json

import numpy as np
import scenes
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.contact.search.circles import UNSETTLED
from dolfinx_llm.forms.condensed.steps import CondensedForm
from dolfinx_llm.forms.flexibility import Flexibility

STEPS = (0.0, 0.0), (0.02, 0.01), (0.03, 0.03), (0.01, 0.035)  # along x and y
FAILS = 2  # before this one
FIRST = {"condensed": CondensedForm, "saddle": Flexibility}
GOES_ON = {"condensed": "flexibility", "saddle": "condensed"}


def bodies(comm, solver):
    """Three blocks, the lowest on a plane, and the motion of the uppermost one's top."""
    sections = [scenes.grid(n, n, jitter=0.2, seed=n) for n in (3, 4, 2)]
    domain, tags = scenes.stacked(comm, sections, (0.0, 1.0, 2.0, 3.0), (1, 1, 1))
    V, top = compat.function_space(domain, shape=(3,)), fem.Constant(domain, (0.0, 0.0, -0.02))
    plane = llm.RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    interfaces = [
        llm.Interface(tags, (1, plane), law=llm.Frictionless()),
        llm.Interface(tags, (2, 3), law=llm.Coulomb(0.6)),
        llm.Interface(tags, (4, 5), law=llm.Coulomb(0.3, dynamic=0.2)),
    ]
    bcs = [fem.dirichletbc(top, fem.locate_dofs_topological(V, 2, tags.find(6)), V)]
    bcs += scenes.hold(V, [(k, lambda p: (abs(p[0]) < 1e-9) & (p[2] < 2.5)) for k in (0, 1)])
    return scenes.elastic_problem([V], bcs, interfaces, solver=solver), top


def forces(comm, solver, fails):
    """Of all load steps; steps of the form that was asked for fail from one on, if told so."""
    form, found = FIRST[solver], []
    solve = form.solve
    problem, top = bodies(comm, solver)
    for i, (x, y) in enumerate(STEPS):
        if fails and i == FAILS:
            form.solve = unsettled
        top.value[:2] = x, y
        problem.solve()
        sides = [side.force for result in problem.results for side in result.sides]
        found.append(np.concatenate(sides).tolist())
    form.solve = solve
    assert problem.form == (GOES_ON[solver] if fails else form.name)
    problem.destroy()
    return found


def unsettled(*_):
    raise llm.ContactError(UNSETTLED)


def of_all(comm):
    """By form, as asked for and as another one goes on."""
    return {solver: [forces(comm, solver, fails) for fails in (False, True)] for solver in FIRST}


if __name__ == "__main__":
    found = of_all(MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))
