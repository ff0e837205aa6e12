"""What load steps of contact cost, over one CG + GAMG solve with set-up of a matching mesh.

Two cubes of n and 1.2 n bricks a side, pressed and dragged in four load steps from stick to gross
slip, without friction (--mu 0), or tied (--tied), in the condensed form; and one matching mesh with
as many unknowns, solved before and after in the same process. CPU seconds without assembly of the
bodies, of the first step with the set-up of contact; counts are exact.

    python tests/shared/load_step_cost.py 14 19 25 [--mu 0.3 | --tied] [--profile K]
"""

import argparse
import cProfile
import pstats
import sys
import time
from pathlib import Path

import numpy as np
from dolfinx import fem
from mpi4py import MPI

DEMOS = Path(__file__).parents[2] / "demos"
PATH = (0.0, 0.006, 0.010, 0.030)  # along; and 0.010 down
APART = ("assembly of K", "assembly of f", "form compilation")


def problem_of(n, law):
    """The problem, what moves its top, and the CPU seconds that making it took."""
    import convergence
    import solvers

    import dolfinx_llm as llm
    from dolfinx_llm import compat

    domain, tags = convergence.blocks(MPI.COMM_WORLD, n, round(1.2 * n))
    V = compat.function_space(domain, shape=(3,))
    a, L = solvers.forms(V)
    low, top = (fem.locate_dofs_geometrical(V, lambda x, z=z: np.isclose(x[2], z)) for z in (0, 2))
    moved, began = fem.Function(V), time.process_time()
    problem = llm.ContactProblem(
        a, fem.Constant(domain, 0.0) * L,
        bcs=[fem.dirichletbc(np.zeros(3), low, V), fem.dirichletbc(moved, top)],
        interfaces=[llm.Interface(tags, (convergence.LOWER, convergence.UPPER), law=law)],
        solver="condensed", petsc_options={"pc_type": "gamg"},
    )  # fmt: skip
    made = time.process_time() - began

    def move(along):
        moved.x.array.reshape(-1, 3)[top] = [along, 0.3 * along, -0.010]

    return problem, move, made


def steps(n, law):
    """After each load step the problem and what it took."""
    problem, move, made = problem_of(n, law)
    before, done = dict.fromkeys(APART, 0.0), []
    for along in PATH:
        move(along)
        began = time.process_time()
        problem.solve()
        spent = time.process_time() - began + made
        times = {key: problem.times.get(key, 0.0) for key in APART}
        form = problem.method.form
        of = form.friction or form.system
        solves, set_ups = of.steps, of.set_ups
        yield (
            problem,
            {
                "seconds": spent - sum(times[key] - before[key] for key in APART),
                "law": len(problem.history),
                "krylov": [solve["iterations"] for solve in solves[len(done) :]],
                "set-ups": set_ups,
                "slip": problem.history[-1].get("slip", 0),
            },
        )
        before, done, made = times, list(solves), 0.0


def main():
    sys.path.insert(0, str(DEMOS))
    time.perf_counter = time.process_time  # every clock: other work on the machine counts little
    import solvers

    import dolfinx_llm as llm

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bricks", type=int, nargs="+")
    parser.add_argument("--mu", type=float, default=0.3)
    parser.add_argument("--tied", action="store_true")
    parser.add_argument("--profile", type=int, default=0, metavar="K", help="of the Kth load step")
    args = parser.parse_args()
    law = llm.Tied() if args.tied else llm.Coulomb(args.mu) if args.mu else llm.Frictionless()
    for n in args.bricks:
        matching = [solvers.matching(MPI.COMM_WORLD, n)]
        found, run = [], steps(n, law)
        for k in range(len(PATH)):
            profile = cProfile.Profile()
            if args.profile == k + 1:
                profile.enable()
            problem, row = next(run)
            profile.disable()
            found.append(row)
            if args.profile == k + 1:
                pstats.Stats(profile).sort_stats("tottime").print_stats(25)
        matching.append(solvers.matching(MPI.COMM_WORLD, n))
        unit = np.mean([row["set-up"] + row["solve"] for row in matching])
        print(f"{problem.unknowns['u']} unknowns; matching: {unit:.2f} s, "
              f"{matching[0]['iterations']} iterations")  # fmt: skip
        for row in found:
            print(f"  {row['seconds'] / unit:5.2f} x, law {row['law']:2}, slip {row['slip']:4}, "
                  f"set-ups {row['set-ups']}, GMRES {sum(row['krylov']):3} {row['krylov']}",
                  flush=True)  # fmt: skip
        problem.destroy()


if __name__ == "__main__":
    main()
