"""Friction with displacements prescribed at contact nodes: rank 0 prints, as JSON, by how much u
and λ of the forms that solve the whole system differ from the surfaces' flexibility.

Of multipliers whose dofs are all prescribed only what they do to the frame is compared: where there
are more of them than frame unknowns the rest is not determined. Nor is the friction where both
bodies are held.
"""

import json
import sys

import numpy as np
import ufl
from contact_scenes import ABOVE, BELOW, rectangle, stress
from dolfinx import fem
from mpi4py import MPI
from pairs import block
from scenes import hold, on

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.forms import choice as solvers

DOWN = -0.02
EVERY = (0, 1, 2)
# Per scene: dimension, μ, motion of the top along x and y, components held at x = 0 of the lower
# and the upper block, and at y = 0 of both.
SCENES = {
    "line": (2, 0.05, (0.01, 0.0), (0,), (0,), ()),
    "line, lower clamped": (2, 0.05, (0.01, 0.0), (0, 1), (), ()),
    "planes": (3, 0.02, (0.0, 0.0), (0,), (0,), (1,)),
    "plane": (3, 0.05, (0.0, 0.006), (0,), (0,), ()),
    "lower clamped": (3, 0.2, (0.004, 0.006), EVERY, (), ()),
    "lower clamped, plane": (3, 0.2, (0.0, 0.006), EVERY, (0,), ()),
}


def scene(comm, name, solver):
    gdim, mu, drag, low_x, high_x, planes = SCENES[name]
    rng = np.random.default_rng(2001)
    if gdim == 2:
        corners = ((7, 4), (0, 0), (1, 1)), ((5, 4), (0, 1), (1, 2))
        bodies = [rectangle(comm, *c, "quadrilateral", 0.2, rng) for c in corners]
    else:
        corners = ((4, 4, 2), (0, 0, 0), (1, 1, 1)), ((3, 3, 2), (0, 0, 1), (1, 1, 2))
        bodies = [block(comm, *c, "hexahedron", jitter=0.2, rng=rng) for c in corners]
    low, high = spaces = [compat.function_space(d, shape=(gdim,)) for d, _ in bodies]
    ends = [(k, on(gdim - 1, level)) for level in (0.0, 2.0) for k in range(gdim)]
    motion = np.array([*drag[: gdim - 1], DOWN])
    bcs = hold(low, ends[:gdim])
    bcs += hold(high, ends[gdim:], lambda p: motion[:, None] + 0.0 * p[:gdim])
    for V, held in ((low, low_x), (high, high_x)):
        bcs += hold(V, [(k, on(0, 0.0)) for k in held] + [(k, on(1, 0.0)) for k in planes])
    forms = [(ufl.TrialFunction(V), ufl.TestFunction(V)) for V in spaces]
    return llm.ContactProblem(
        [ufl.inner(stress(u), ufl.grad(w)) * ufl.dx for u, w in forms],
        [ufl.inner(fem.Constant(V.mesh, np.zeros(gdim)), w) * ufl.dx
         for V, (_, w) in zip(spaces, forms, strict=True)],
        bcs=bcs, solver=solver,
        interfaces=[llm.Interface(
            None, ((bodies[0][1], ABOVE), (bodies[1][1], BELOW)), law=llm.Coulomb(mu)
        )],
    )  # fmt: skip


def held_on_both(name):
    *_, low_x, high_x, planes = SCENES[name]
    return bool(planes or set(low_x) & set(high_x))


def differences(comm, name):
    """Of u, λ and what prescribed λ do to the frame, relative; states of the last iteration."""
    known, found = None, {}
    for form, solver, limit in (
        ("flexibility", "saddle", 10**6), ("saddle", "saddle", 0), ("condensed", "condensed", 0),
    ):  # fmt: skip
        solvers.FLEXIBLE = limit
        problem = scene(comm, name, solver)
        u = np.concatenate([f.x.array for f in problem.solve()])
        multiplier, held = problem.method.iteration.multiplier, problem.operators.soft
        on_frame = problem.method.iteration.equations.L[held].T @ multiplier[held]
        if held_on_both(name):
            on_frame = on_frame[: problem.method.iteration.equations.n_v]
        answer = u, np.where(held, 0.0, multiplier), on_frame
        known = known or answer
        sizes = [max(comm.allgather(np.abs(known[i]).max())) for i in (0, 1, 1)]
        found[form] = [
            max(comm.allgather(float(np.abs(a - b).max(initial=0.0) / size)))
            for a, b, size in zip(known, answer, sizes, strict=True)
        ]
        assert problem.form == form
        last = problem.history[-1]
        found["states"] = [last[key] for key in ("active", "stick", "slip")]
        problem.destroy()
    return found


if __name__ == "__main__":
    found = {name: differences(MPI.COMM_WORLD, name) for name in sys.argv[1:] or SCENES}
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))
