"""Patch tests of blocks whose supports end at the interface from both sides: how far displacement,
resultant and pressure are from the exact ones, as JSON."""

import json

import numpy as np
import scenes
from mpi4py import MPI
from sampling import covering

import dolfinx_llm as llm
from dolfinx_llm.forms import choice

LAWS = {"tied": llm.Tied(), "frictionless": llm.Frictionless(), "friction": llm.Coulomb(0.4)}
WALLS = {
    "cantilever": [scenes.on(0, 0.0)],
    "two walls": [scenes.on(0, 0.0), scenes.on(1, 1.0)],
    "all round": [scenes.on(k, at) for k in (0, 1) for at in (0.0, 1.0)],
}
FORMS = ("flexibility", "saddle", "condensed")
DIRECT = {"ksp_type": "preonly", "pc_type": "cholesky"}


def patch(comm, walls, law, form, swap=False):
    """Blocks under uniaxial pressure; every component is prescribed at walls, base and top."""
    V, tags = scenes.two_blocks(comm, 4, 3, layers=(1, 2))
    levels = [scenes.on(2, 0.0), scenes.on(2, 2.0)]
    held = [(k, where) for where in (*WALLS[walls], *levels) for k in range(3)]
    a, L = scenes.forms(V)
    choice.FLEXIBLE = 10**6 if form == "flexibility" else 0
    problem = llm.ContactProblem(
        a, L, bcs=scenes.hold(V, held, scenes.uniaxial),
        interfaces=llm.Interface(tags, (3, 2) if swap else (2, 3), law=LAWS[law]),
        solver="saddle" if form == "flexibility" else form,
        petsc_options=DIRECT if form == "condensed" else None,
    )  # fmt: skip
    u = problem.solve()
    result = problem.results[0]
    exact = np.array([0.0, 0.0, -scenes.PRESSURE if swap else scenes.PRESSURE])
    errors = {
        "u": scenes.displacement_error(u, scenes.uniaxial),
        "resultant": np.abs(result.resultant - exact).max() / scenes.PRESSURE,
        "both": np.abs(sum(s.force.sum(axis=0) for s in result.sides)).max() / scenes.PRESSURE,
        "pressure": np.abs(result.pressure / scenes.PRESSURE - 1.0).max(),
        "nodes": max(
            np.abs(side.normal_force - scenes.PRESSURE * side.area).max() for side in result.sides
        ) / scenes.PRESSURE,
    }  # fmt: skip
    problem.destroy()
    return {key: float(value) for key, value in errors.items()}


# Pairs of levels of walls, law, form, side named first and number of ranks.
CASES = covering(WALLS, LAWS, FORMS, (False, True), (1, 2, 3))


def cases(ranks):
    return [case[:-1] for case in CASES if case[-1] == ranks]


if __name__ == "__main__":
    comm = MPI.COMM_WORLD
    out = {" ".join(map(str, case)): patch(comm, *case) for case in cases(comm.size)}
    if comm.rank == 0:
        print(json.dumps(out))
