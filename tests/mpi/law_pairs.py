"""Every pair of laws as two interfaces of one problem: worst violation of each pair, on one line.

Arguments: the dimension, the step from one pair to the next, and solver forms that the pairs take
by turns.
"""

import json
import sys

from law_scenes import PAIRS, STEPS, Cantilever
from mpi4py import MPI

from dolfinx_llm.forms import choice


def worst(comm, gdim, pair, form):
    """Over all load steps."""
    choice.FLEXIBLE = 0 if form == "saddle" else 10**6
    scene = Cantilever(comm, gdim, pair, "auto" if form == "flexibility" else form)
    found = {}
    for step in STEPS:
        scene.move(step)
        for name, value in scene.violations().items():
            found[name] = max(found.get(name, 0.0), value)
    scene.problem.destroy()
    return found


if __name__ == "__main__":
    gdim, every, *forms = sys.argv[1:]
    found = {}
    for i, pair in enumerate(PAIRS[:: int(every)]):
        form = forms[i % len(forms)]
        found[f"{pair} {form}"] = worst(MPI.COMM_WORLD, int(gdim), pair, form)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))
