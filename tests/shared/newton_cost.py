"""What an iteration at finite deformation costs, over one of the same bodies as one matching mesh.

Two neo-Hookean cubes of n and 1.2 n hexahedra a side, clamped at both ends and pressed by 5 % in
one load step, and one matching mesh with about as many unknowns, all in the same process. CPU
seconds of the whole solve over the number of iterations, medians; counts of GMRES are exact.

    python tests/shared/newton_cost.py [--bricks 17] [--solver auto] [--repeat 3] [--profile LAW]
"""

import argparse
import cProfile
import pstats
import sys
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from dolfinx import fem
from mpi4py import MPI

DEMOS = Path(__file__).parents[2] / "demos"
LAWS = ("matching", "tied", "frictionless", "friction")
DOWN = 0.1  # of a height of 2


def problem_of(n, law, solver="auto"):
    """The problem, and what moves its top."""
    import finite_patch
    import patch2d

    import dolfinx_llm as llm
    from dolfinx_llm import compat

    if law == "matching":
        a = round(1.12 * n)
        box = patch2d.brick((0.0, 0.0, 0.0), (1.0, 1.0, 2.0), (a, a, 2 * a - 1), False)
        x, cells = box
        domain = compat.create_mesh(MPI.COMM_SELF, cells, x, "hexahedron")
    else:
        boxes = [((0.0, 0.0, z), (1.0,) * 3, (m,) * 3) for z, m in enumerate((n, round(1.2 * n)))]
        [(domain, tags)] = patch2d.bodies(MPI.COMM_SELF, "hex", boxes=boxes)
    V = compat.function_space(domain, shape=(3,))
    u = fem.Function(V)
    F = finite_patch.residual(u, *finite_patch.lame(1000.0, 0.3))
    ends = [fem.Constant(domain, np.zeros(3)) for _ in range(2)]
    bcs = [
        fem.dirichletbc(g, fem.locate_dofs_geometrical(V, lambda p, z=z: np.isclose(p[2], z)), V)
        for g, z in zip(ends, (0.0, 2.0), strict=True)
    ]
    chosen = {"tied": llm.Tied(), "frictionless": llm.Frictionless(), "friction": llm.Coulomb(0.3)}
    interfaces = ()
    if law in chosen:
        sides = (tags, patch2d.FOUNDATION_TOP), (tags, patch2d.PUNCH_BOTTOM)
        interfaces = [llm.Interface(None, sides, law=chosen[law])]
    problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=interfaces, solver=solver)
    return problem, ends[1]


def main():
    sys.path.insert(0, str(DEMOS))
    time.perf_counter = time.process_time  # every clock: other work on the machine counts little
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bricks", type=int, default=17)
    parser.add_argument("--solver", default="auto")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--profile", choices=LAWS, help="of one law alone")
    args = parser.parse_args()
    spent, told = defaultdict(list), {}
    for _ in range(1 if args.profile else args.repeat):
        for law in [args.profile] if args.profile else LAWS:
            problem, top = problem_of(args.bricks, law, args.solver)
            top.value[2] = -DOWN
            profile = cProfile.Profile()
            if args.profile:
                profile.enable()
            began = time.process_time()
            problem.solve()
            taken = time.process_time() - began
            profile.disable()
            history = problem.history
            spent[law].append(taken / len(history))
            told[law] = f"{problem.unknowns['u']} unknowns, {problem.method}, " + " ".join(
                str(entry["linear"]) for entry in history
            )
            if args.profile:
                pstats.Stats(profile).sort_stats("tottime").print_stats(40)
                pstats.Stats(profile).sort_stats("cumulative").print_stats(70)
                print({key: round(value, 3) for key, value in problem.times.items()})
            problem.destroy()
    unit = np.median(spent.get("matching", [np.nan]))
    for law, seconds in spent.items():
        low, middle, high = np.min(seconds), np.median(seconds), np.max(seconds)
        print(f"{law:13}{middle:6.2f} s ({low:.2f} to {high:.2f}), {middle / unit:.2f} x; "
              f"{told[law]}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
