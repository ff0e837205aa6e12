"""What the forms of (31) cost, side by side, and how far the one that ``solver="auto"`` takes is
from the best: where the constants of ``forms/cost.py`` come from.

Two blocks that do not match, pressed and dragged from stick into gross slip in four load steps, in
2D and 3D, of first and second order, slabs and towers, and Hertz's sphere on graded meshes. Every
form runs in a process of its own; compared are CPU seconds of all load steps, told as well is peak
memory. Forms that take longer than the limit are left out.

    python tests/shared/cost_campaign.py [--scenes NAME ...] [--sizes N ...] [--laws LAW ...]
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

TESTS = Path(__file__).resolve().parent.parent
SIZES = {"2D": (24, 72, 170), "3D": (6, 11, 16, 19)}  # nodes a side of the lower block
BLOCKS = {  # dimension, cell, degree, height over width
    "2D quadrilateral": (2, "quadrilateral", 1, 1.0),
    "2D triangle": (2, "triangle", 1, 1.0),
    "2D second order": (2, "triangle", 2, 1.0),
    "3D hexahedron": (3, "hexahedron", 1, 1.0),
    "3D tetrahedron": (3, "tetrahedron", 1, 1.0),
    "3D second order": (3, "tetrahedron", 2, 1.0),
    "3D slab": (3, "hexahedron", 1, 0.25),
    "3D tower": (3, "hexahedron", 1, 4.0),
}
HERTZ = {"Hertz plane": ("plane", (4, 9)), "Hertz block": ("block", (3, 4))}  # elements over a
LAWS = ("tied", "frictionless", "friction")
FORMS = ("auto", "flexibility", "saddle", "condensed")


def solver_of(form):
    """What is given as ``solver``; in the condensed form all is to be multigrid's."""
    from dolfinx_llm.forms.condensed.steps import CondensedForm
    from dolfinx_llm.forms.flexibility import Flexibility
    from dolfinx_llm.forms.saddle import SaddleForm

    kinds = {"flexibility": Flexibility, "saddle": SaddleForm}
    if form == "condensed":
        return CondensedForm(options={"pc_type": "gamg"})
    return kinds[form]() if form in kinds else form


def case(scene, n, law, form):
    """A form on a scene, in this process: prints a line of JSON."""
    sys.path[:0] = [str(TESTS / "mpi"), str(TESTS.parent / "demos")]
    from mpi4py import MPI

    steps = 4
    if scene in BLOCKS:
        import cost_scenes

        dim, cell, degree, height = BLOCKS[scene]
        problem, load = cost_scenes.dragged(
            MPI.COMM_SELF, dim, n, cell, law, degree=degree, height=height, solver=solver_of(form)
        )
    else:
        import hertz3d

        m = n if HERTZ[scene][0] == "plane" else round(1.4 * n)
        problem, load = hertz3d.problem(HERTZ[scene][0], (n, m), solver=solver_of(form)), id
        steps = 1
    seconds, iterations = [], []
    for k in range(steps):
        load(k)
        began = time.process_time()
        problem.solve()
        seconds.append(time.process_time() - began)
        iterations.append(len(problem.history))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    row = {"scene": scene, "n": n, "law": law, "form": form, "took": problem.form}
    row |= {name: problem.unknowns[name] for name in ("u", "lambda")}
    row |= {"seconds": seconds, "total": sum(seconds), "iterations": iterations, "gb": peak}
    print(json.dumps(row))


def run(arguments, limit):
    """The row, or None where it takes too long."""
    command = [sys.executable, __file__, "--case", json.dumps(arguments)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    try:
        out = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=limit
        )
    except subprocess.TimeoutExpired:
        return None
    lines = [line for line in out.stdout.splitlines() if line.startswith("{")]
    if not lines:
        raise RuntimeError(out.stderr[-2000:])
    return json.loads(lines[-1])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=[*BLOCKS, *HERTZ])
    parser.add_argument("--sizes", type=int, nargs="+")
    parser.add_argument("--laws", nargs="+", default=LAWS)
    parser.add_argument("--forms", nargs="+", default=FORMS)
    parser.add_argument("--limit", type=float, default=100.0, help="seconds of wall time of a form")
    parser.add_argument("--json", type=Path, metavar="FILE", help="rows are appended")
    parser.add_argument("--case", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.case:
        return case(*json.loads(args.case))
    for scene in args.scenes:
        hertz = scene in HERTZ
        for n in args.sizes or (HERTZ[scene][1] if hertz else SIZES[scene[:2]]):
            for law in ("frictionless",) if hertz else args.laws:
                forms = [f for f in args.forms if (f, law) != ("flexibility", "tied")]
                rows = [run((scene, n, law, form), args.limit) for form in forms]
                rows = [row for row in rows if row is not None]
                if args.json:
                    with args.json.open("a") as file:
                        file.writelines(json.dumps(row) + "\n" for row in rows)
                told = "  ".join(f"{r['form']} {r['total']:.2f} s {r['gb']:.2f} GB" for r in rows)
                for row in rows[:1] if rows and rows[0]["form"] == "auto" else []:
                    # The same form anew differs by the noise of the machine alone.
                    of = {r["form"]: r["total"] for r in rows[1:]}
                    over = of.get(row["took"], row["total"]) / min(of.values(), default=1.0)
                    told += f"  took {row['took']}: {over:.2f} of the best"
                size = f"{rows[0]['u']:7}{rows[0]['lambda']:5}" if rows else ""
                print(f"{scene:18}{n:4} {law:13}{size}  {told}", flush=True)


if __name__ == "__main__":
    main()
