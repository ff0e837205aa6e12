"""Every pair of laws as two interfaces of one problem: worst violation of each pair, as JSON."""

import json
import sys

from law_scenes import LAWS, STEPS, Cantilever
from mpi4py import MPI
from sampling import covering

from dolfinx_llm.forms import choice


def worst(comm, gdim, pair, form):
    """Over all load steps."""
    choice.FLEXIBLE = 0 if form == "saddle" else 10**6
    scene = Cantilever(comm, gdim, pair, "saddle" if form == "flexibility" else form)
    found = {}
    for step in STEPS:
        scene.move(step)
        for name, value in scene.violations().items():
            found[name] = max(found.get(name, 0.0), value)
    scene.problem.destroy()
    return found


FORMS = "flexibility", "saddle", "condensed"


def fits(one, other, gdim, _):
    """Each pair once; a third of them in 3D, too, where they take long."""
    first, second = (list(LAWS).index(name) for name in (one, other))
    return first <= second and (gdim == 2 or (first + second) % 3 == 0)


# Every pair of laws, and pairs of law, dimension and form.
CASES = covering(LAWS, LAWS, (2, 3), FORMS, fits=fits)


def cases(ranks, part):
    """First a sixth; on several ranks those that bring a law, a dimension or a form for the first
    time, or only a few of them. Then all others."""
    seen, new = set(), []
    for least in (4, 3, 2, 1):  # what a case must bring, so that few are enough
        for case in CASES:
            if len(set(case) - seen) >= least:
                new.append(case)
                seen |= set(case)
    first = new if ranks > 1 else CASES[::6]
    if part == "few":
        return first[:2]
    return first if part == "first" else [case for case in CASES if case not in first]


if __name__ == "__main__":
    found = {}
    for one, other, gdim, form in cases(MPI.COMM_WORLD.size, sys.argv[1]):
        found[f"{one}, {other} {gdim} {form}"] = worst(MPI.COMM_WORLD, gdim, (one, other), form)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))
