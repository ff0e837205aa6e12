"""Friction with displacements prescribed at contact nodes: rank 0 prints, as JSON, by how much the
whole-system forms differ from the surfaces' flexibility."""

import json

import numpy as np
import scenes
import ufl
from contact_scenes import BELOW, ABOVE, rectangle
from dolfinx import fem
from mpi4py import MPI
from solve_scenes import CLAMPED

import dolfinx_llm as llm
from dolfinx_llm import compat, solvers

LAW = llm.Coulomb(0.3)
PUSH = np.array([0.004, -0.003, -0.02])  # of the top, from where the planes allow it


def side(axis, level):
    return scenes.on(axis, level)


def blocks(comm, held, amount):
    """Two cubes, the top moved; ``held``: (component, where) at contact nodes too, moved by
    ``amount`` times the coordinate along it."""
    V, tags = scenes.two_blocks(comm, 4, 3)
    planes = scenes.hold(V, held, lambda p: amount * p)
    top = scenes.hold(V, [(k, scenes.on(2, 2.0)) for k in (0, 1, 2)], lambda p: PUSH[:, None] * p[2] * (p[:3] > 1e-9) / 2.0)
    a, L = scenes.forms(V)
    base = scenes.hold(V, CLAMPED)
    return a, L, top + base + planes, tags


def main(comm):
    found = {}
    cases = {
        "planes": ([(0, side(0, 0.0)), (1, side(1, 0.0))], 0.0),
        "one plane": ([(0, side(0, 0.0))], 0.0),
        "clamped": ([(k, side(0, 0.0)) for k in (0, 1, 2)], -0.002),
        "moved": ([(0, side(0, 1.0)), (1, side(1, 0.0))], 0.002),
    }
    for name, (held, amount) in cases.items():
        known = None
        for solver, limit in (("saddle", 10**6), ("saddle", 0), ("condensed", 0)):
            solvers.FLEXIBLE = limit
            a, L, bcs, tags = blocks(comm, held, amount)
            problem = llm.ContactProblem(a, L, bcs=bcs, interfaces=[llm.Interface(tags, (2, 3), law=LAW)], solver=solver)
            u = problem.solve().x.array.copy()
            multiplier = problem._iteration.multiplier
            if known is None:
                known = u, multiplier
                print(name, [ (h['active'],h['stick'],h['slip'], '%.0e'%h['residual']) for h in problem.history], flush=True)
            else:
                e = [float(np.abs(x - y).max() / np.abs(x).max()) for x, y in zip(known, (u, multiplier))]
                print(name, problem.form, e, len(problem.history), 'W', len(problem._prescribed), flush=True)
                found[f"{name} {problem.form}"] = e
            problem.destroy()
    return found

main(MPI.COMM_WORLD)
