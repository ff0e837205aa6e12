"""The table of results in README.md, made from the demos' own reports: .ci/figures.py [--check]

Runs the commands that the table names, and writes the table between its marks in README.md, and
what was found to build/figures.json. With --check README.md stays as it is; what it says must be
what the commands give, within the bounds below. No time is among them.
"""

from __future__ import annotations

import argparse
import json
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import log2
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
BEGIN, END = "<!-- figures: made by `make figures` -->", "<!-- figures: end -->"
WORKERS = 2  # rows at a time
NUMBER = r"([-+]?[\d,]*\.?\d+(?:e[-+]?\d+)?)"


@dataclass(frozen=True)
class Figure:
    """A number of the table."""

    form: str  # how it is written, as of str.format
    differs: float = 0.0  # by how much it may differ from what the table says
    times: float | None = None  # or how many times that of the table an error may be

    def agrees(self, said: float, found: float) -> bool:
        """Whether a number of the table is that of a run."""
        if self.times is not None:
            return abs(found) <= self.times * abs(said)
        return abs(found - said) <= self.differs + 1e-12 * abs(said)


@dataclass(frozen=True)
class Row:
    """A line of the table."""

    scene: str
    text: str  # with {} for each figure
    figures: tuple[Figure, ...]
    read: Callable[..., list[float]]  # the figures, from the reports of the commands
    commands: tuple[str, ...]

    def said(self, readme: str) -> list[float]:
        """The figures of this row in README.md."""
        parts = [re.escape(part) for part in self.text.split("{}")]
        line = rf"^\| {re.escape(self.scene)} \| {NUMBER.join(parts)} \| "
        found = re.search(line, readme, re.M)
        if not found:
            raise ValueError(f"README.md has no row {self.scene!r} of the form {self.text!r}")
        return [float(number.replace(",", "")) for number in found.groups()]

    def faults(self, readme: str, found: list[float]) -> list[str]:
        """What README.md says otherwise than a run."""
        return [
            f"{self.scene}: README.md says {said}, found {value:.6g}"
            for figure, said, value in zip(self.figures, self.said(readme), found, strict=True)
            if not figure.agrees(said, value)
        ]

    def line(self, found: list[float]) -> str:
        """This row, with what was found."""
        texts = [f.form.format(v) for f, v in zip(self.figures, found, strict=True)]
        commands = ", ".join(f"`{command}`" for command in self.commands)
        return f"| {self.scene} | {self.text.format(*texts)} | {commands} |"

    def run(self, folder: Path) -> dict[str, Any]:
        """Run the commands: the figures, and what it took [s]."""
        reports, began = [], time.perf_counter()
        for k, command in enumerate(self.commands):
            file = folder / f"{ROWS.index(self)}_{k}.json"
            print("==", command, flush=True)
            words = [*shlex.split(command), "--json", str(file)]
            done = subprocess.run(words, cwd=ROOT, capture_output=True)
            if done.returncode:
                raise SystemExit(done.stdout.decode()[-2000:] + done.stderr.decode()[-4000:])
            reports.append(json.loads(file.read_text()))
        found = [float(value) for value in self.read(*reports)]
        seconds = round(time.perf_counter() - began, 1)
        return {"scene": self.scene, "commands": self.commands, "found": found, "seconds": seconds}


def patch3d(report: dict[str, Any]) -> list[float]:
    wrong = sorted(100.0 * error for error in report["node to segment"].values())
    return [report["errors"]["von_mises"], *wrong]


def convergence(rows: list[dict[str, Any]]) -> list[float]:
    coarse, fine = (row["tied"] for row in rows[-2:])
    return [log2(coarse[key] / fine[key]) for key in ("l2", "h1", "pressure")]


def hertz3d(report: dict[str, Any]) -> list[float]:
    return [100.0 * (report["rows"]["frame"][key] - 1.0) for key in ("peak", "radius")]


def friction(report: dict[str, Any]) -> list[float]:
    last = report["newton"][-1]
    return [last["friction"] / (0.3 * last["normal"])]


def solvers(rows: list[dict[str, Any]]) -> list[float]:
    last = {row["method"].split()[0]: row for row in rows}
    iterations = [last[kind]["iterations"] for kind in ("condensed", "matching")]
    return [last["condensed"]["unknowns"], *iterations]


ROUNDING = Figure("{:.0e}", times=10.0)
ROWS = (
    Row(
        "the paper's 3D patch test: von Mises stress, both bodies",
        "{} (node to segment: {} to {} % wrong)",
        (ROUNDING, Figure("{:.0f}", differs=1.0), Figure("{:.0f}", differs=1.0)),
        patch3d,
        ("mpirun -n 2 python demos/patch3d.py",),
    ),
    Row(
        "finite deformation: patch test at stretches of 1.17 and 0.78, error of the stretches in"
        " 2D and 3D",
        "{}, {}",
        (ROUNDING, ROUNDING),
        lambda *reports: [report["stretch"] for report in reports],
        (
            "mpirun -n 2 python demos/finite_patch.py",
            "mpirun -n 2 python demos/finite_patch.py --cells hex",
        ),
    ),
    Row(
        "axisymmetric: two cylinders pressed evenly, error of the contact pressure",
        "{} (without a thickness of 2 pi r {} %)",
        (ROUNDING, Figure("{:.0f}", differs=1.0)),
        lambda report: [report["2 pi r"], 100.0 * report["none"]],
        ("python demos/axisymmetric.py --patch",),
    ),
    Row(
        "manufactured solution on non-matching cubes: rates of L2, H1, pressure",
        "{}, {}, {}",
        (Figure("{:.2f}", differs=0.01),) * 3,
        convergence,
        ("python demos/convergence.py --refinements 4",),
    ),
    Row(
        "Hertz in 3D, spherical end on a rigid plane: peak, radius",
        "{} %, {} %",
        (Figure("{:+.2f}", differs=0.02),) * 2,
        hertz3d,
        ("python demos/hertz3d.py --elements 9 9",),
    ),
    Row(
        "Cattaneo and Mindlin: traction in L2",
        "{} %",
        (Figure("{:.1f}", differs=0.1),),
        lambda report: [100.0 * report["L2 error of q"]],
        ("python demos/cattaneo_mindlin.py",),
    ),
    Row(
        "block dragged: friction in full slip over μ N",
        "{}",
        (Figure("{:.12f}", differs=1e-9),),
        friction,
        ("python demos/friction_block.py",),
    ),
    Row(
        "tied interface, algebraic multigrid: unknowns; iterations against those of one matching"
        " mesh",
        "{}; {} against {}",
        (Figure("{:,.0f}"), Figure("{:.0f}", differs=2.0), Figure("{:.0f}", differs=2.0)),
        solvers,
        ("python demos/solvers.py --only CG --repeat 1",),
    ),
)


def table(lines: list[str]) -> str:
    """The rows of the table between its marks."""
    head = ["| scene | figure | command |", "| --- | --- | --- |"]
    return "\n".join([BEGIN, *head, *lines, END])


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing into README.md")
    args = parser.parse_args(arguments)
    page, build = ROOT / "README.md", ROOT / "build"
    readme, folder = page.read_text(), build / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*.json"):
        old.unlink()
    with ThreadPoolExecutor(WORKERS) as workers:
        runs = list(workers.map(lambda row: row.run(folder), ROWS))
    (build / "figures.json").write_text(json.dumps(runs, indent=2) + "\n")
    new = table([row.line(run["found"]) for row, run in zip(ROWS, runs)])
    print(new, f"\n{sum(run['seconds'] for run in runs):.0f} s")
    if args.check:
        faults = [f for row, run in zip(ROWS, runs) for f in row.faults(readme, run["found"])]
        sys.exit("\n".join(faults) or None)
    before, _, rest = readme.partition(BEGIN)
    _, _, after = rest.partition(END)
    page.write_text(before + new + after)


if __name__ == "__main__":
    main()
