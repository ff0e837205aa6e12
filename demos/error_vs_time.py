"""Error against run time: what a contact by frames costs and gains against other ways.

The 3D patch test, two cubes with a known field and Hertz's cylinders, over refinements; frames by
positions, by weights and undesigned, node-to-segment, dolfinx_mpc where it is installed, and a
matching mesh as the limit. Of opening and friction, as "auto" takes them, factorised and by
multigrid: Hertz's point contact, Cattaneo and Mindlin, a block dragged until all of it slips.
Run time is all that a solve takes, without mesh and form compilation; stages and "seconds" are wall
time, compared is CPU time: seconds times CPU over wall of the case, and as "ratio" what repeats:
that over the matching mesh's of the same run.
Every method runs in a process of its own, all of them in turn, and the median turn is shown;
with --quick the methods of a scene share one process, and their memory is the largest so far.

    python demos/error_vs_time.py [--quick] [-n RANKS] [--output DIR] [--against FILE]
    python demos/error_vs_time.py --scenes "Hertz 3D" "dragged block" --largest 400000
    python demos/error_vs_time.py --read FILE    # table and diagrams of an earlier run
    python demos/error_vs_time.py --read FILE --against FILE    # how far two runs' ratios differ
"""

import argparse
import json
import os
import platform
import subprocess
import sys
from pathlib import Path

from work_precision.evaluation import add_ratios, compare, median_run, table, verdict, write
from work_precision.plan import CASES, SIZES, sizes_of


def run(scene, cases, ranks):
    """Versions and rows of (method, solver, sizes), in a process of its own."""
    command = [sys.executable, __file__, "--case", json.dumps([scene, cases])]
    command = ["mpirun", "-n", str(ranks), *command] if ranks > 1 else command
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}\n{done.stdout}\n{done.stderr}")
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    return lines[0]["about"], lines[1:]


def measure(scenes, repeat, ranks, quick, largest):
    """Versions and rows; of ``repeat`` runs, in turn over the methods, the median one."""
    from tqdm import tqdm

    jobs = []
    for scene in scenes:
        cases = [(*case, sizes_of(scene, *case, quick, largest)) for case in CASES[scene]]
        jobs += [(scene, cases)] if quick else [(scene, [case]) for case in cases]
    turns = {}
    with tqdm(total=repeat * len(jobs), disable=None) as bar:
        for _ in range(repeat):
            for scene, cases in jobs:
                bar.set_description(f"{scene}, {cases[0][0]}")
                about, found = run(scene, cases, ranks)
                for row in found:
                    key = scene, row["method"], row["solver"], row["n"]
                    turns.setdefault(key, []).append(row)
                bar.update()
    rows = [median_run(found) for found in turns.values()]
    return {**about, "repeat": repeat, "machine": platform.machine()}, rows


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="two refinements, one run each")
    parser.add_argument("--scenes", nargs="+", choices=SIZES, default=list(SIZES))
    parser.add_argument("--repeat", type=int, default=3, help="runs, of which the median is shown")
    parser.add_argument("--largest", type=int, default=0, help="unknowns, of more sizes")
    parser.add_argument("-n", "--ranks", type=int, default=1)
    parser.add_argument("--output", type=Path, default=Path("out"), metavar="DIR")
    parser.add_argument("--against", type=Path, metavar="FILE", help="JSON of an earlier run")
    parser.add_argument("--read", type=Path, metavar="FILE", help="JSON of a run to show again")
    parser.add_argument("--case", help=argparse.SUPPRESS)
    args = parser.parse_args(arguments)
    if args.case:
        from work_precision import methods

        return methods.run(*json.loads(args.case))
    if args.read:
        about, rows = json.loads(args.read.read_text()).values()
    else:
        repeat = 1 if args.quick else args.repeat
        about, rows = measure(args.scenes, repeat, args.ranks, args.quick, args.largest)
    add_ratios(rows)
    print(", ".join(f"{key} {value}" for key, value in about.items()))
    print("\n".join(table(rows, args.scenes) + verdict(rows, args.scenes)))
    if args.against:
        earlier = json.loads(args.against.read_text())["rows"]
        add_ratios(earlier)
        print(compare(rows, earlier))
    write(args.output, about, rows)
    return rows


if __name__ == "__main__":
    main()
