"""What the rows of ``error_vs_time.py`` say: table, comparisons, diagrams, files."""

import csv
import json
import statistics

import numpy as np
from work_precision.plan import (
    CHOLESKY,
    CHOSEN,
    DIAGRAMS,
    GAMG,
    LAW,
    LAWS,
    MATCHING,
    MPC,
    MULTIGRID,
    NODE_TO_SEGMENT,
    POSITIONS,
    REFERENCE,
    ROUNDING,
    SADDLE,
    STAGES,
    UNDESIGNED,
    WEIGHTS,
)

EPS = 2.0**-52  # what diagrams show of errors that are nought


# ## Comparisons
def curves(rows, scene, error):
    """Per method and solver: its rows over the sizes."""
    found = {}
    for row in rows:
        if row["scene"] == scene and error in row:
            found.setdefault((row["method"], row["solver"]), []).append(row)
    return found


def time_to(goal, rows, error):
    """Seconds in which a method gets to an error; between sizes interpolated in logarithms."""
    t, e = (np.array([row[key] for row in rows]) for key in ("cpu_seconds", error))
    e = np.maximum(e, ROUNDING)
    best = min(t[e <= goal], default=np.inf)
    for k in range(len(e) - 1):
        if e[k + 1] < goal < e[k]:
            part = np.log(e[k] / goal) / np.log(e[k] / e[k + 1])
            best = min(best, t[k] * (t[k + 1] / t[k]) ** part)
    return float(best)


def against_rivals(rows, scene, error):
    """Per rival point: the quickest designed frame's time to its error, over the rival's time."""
    every = curves(rows, scene, error)
    frames = [found for (method, _), found in every.items() if method in (POSITIONS, WEIGHTS)]
    out = {}
    for case, found in every.items():
        if case[0].startswith((NODE_TO_SEGMENT, MPC)):
            goals = [max(row[error], ROUNDING) for row in found]
            best = [min(time_to(goal, frame, error) for frame in frames) for goal in goals]
            out[case] = [t / row["cpu_seconds"] for t, row in zip(best, found)]
    return out


def median_run(rows):
    """Of several runs of a case the one whose CPU time is the median, the lower one of two."""
    order = sorted(rows, key=lambda row: row.get("cpu_seconds", 0.0))
    return order[(len(rows) - 1) // 2]


def add_ratios(rows):
    """CPU times over those of the matching mesh in the same run, of the same scene and size."""
    unit = {(row["scene"], row["n"]): row["cpu_seconds"] for row in rows
            if (row["method"], row["solver"]) == REFERENCE[row["scene"]]}  # fmt: skip
    for row in rows:
        if "failed" not in row and (row["scene"], row["n"]) in unit:
            row["ratio"] = row["cpu_seconds"] / unit[row["scene"], row["n"]]


def ratios(rows):
    """The ratios by scene, method, solver and size, without the matching mesh's, which are 1."""
    return {
        (row["scene"], row["method"], row["solver"], row["n"]): row["ratio"]
        for row in rows
        if "ratio" in row and (row["method"], row["solver"]) != REFERENCE[row["scene"]]
    }


def compare(rows, earlier):
    """How far the ratios of two runs lie apart, in words."""
    new, old = ratios(rows), ratios(earlier)
    change = {key: max(new[key] / old[key], old[key] / new[key]) - 1.0
              for key in new if key in old}  # fmt: skip
    finest = {scene: max(n for name, *_, n in change if name == scene) for scene, *_ in change}
    words = "CPU times over the matching mesh's, against the earlier run: "
    for name, some in (
        ("all sizes", change),
        ("finest meshes", {key: c for key, c in change.items() if key[-1] == finest[key[0]]}),
    ):
        worst = max(some, key=some.get)
        words += (
            f"\n  {name}: {sum(c <= 0.15 for c in some.values())} of {len(some)} within 15 %, "
            f"median {100 * statistics.median(some.values()):.0f} %, largest "
            f"{100 * some[worst]:.0f} % ({', '.join(map(str, worst))})"
        )
    for key in sorted((key for key in change if change[key] > 0.15), key=change.get, reverse=True):
        words += f"\n    {old[key]:8.2f} -> {new[key]:8.2f}  {', '.join(map(str, key))}"
    return words


# ## Table and diagrams
def solver_name(method, solver):
    """Only frames have a condensed form: the others' matrices are factorised as they are."""
    framed = method in (POSITIONS, WEIGHTS, UNDESIGNED, LAW)
    return solver if framed else solver.removeprefix("condensed ")


def table(rows, scenes):
    """Lines for the terminal."""
    out = []
    for scene in scenes:
        errors = [error for name, error, _ in DIAGRAMS + LAWS if name == scene]
        heads = [
            *errors,
            "rate",
            "its",
            *STAGES,
            "seconds",
            "its CPU",
            "ratio",
            "wall",
            "CPU",
            "GB",
        ]
        out += ["", f"{scene:<27}{'solver':<21}{'n':>3}{'unknowns':>9}"
                + "".join(f"{head[:8]:>9}" for head in heads)]  # fmt: skip
        last = {}
        for row in (row for row in rows if row["scene"] == scene):
            case = row["method"], row["solver"]
            line = f"{case[0]:<27}{solver_name(*case):<21}{row['n']:>3}"
            if "failed" in row:
                out.append(f"{line}  {row['failed'][:120]}")
                continue
            before, last[case] = last.get(case), row
            rate = "" if before is None or row.get(errors[0], 0.0) < ROUNDING else (
                f"{np.log(before[errors[0]] / row[errors[0]]) / np.log(row['n'] / before['n']):.2f}"
            )  # fmt: skip
            found = "".join(f"{row[e]:9.1e}" if e in row else f"{'-':>9}" for e in errors)
            line += f"{row['unknowns']:>9}{found}{rate:>9}{row['iterations']:>9}"
            keys = (*STAGES, "seconds", "cpu_seconds", "ratio", "wall", "cpu", "memory")
            out.append(line + "".join(f"{row.get(key, np.nan):9.3f}" for key in keys))
    return out


def verdict(rows, scenes):
    """Per diagram and rival, what the frames need for the rival's error."""
    out = ["", "quickest designed frame's CPU time to a rival's error, over the rival's, by size"]
    for scene, error, title in DIAGRAMS:
        if scene in scenes:
            for case, ratios in against_rivals(rows, scene, error).items():
                figures = " ".join(f"{ratio:7.2f}" for ratio in ratios)
                name = f"{case[0]}, {solver_name(*case)}"
                out.append(f"  {title:<44} {name:<38} {figures}")
    return out


STYLES = {POSITIONS: "C0", WEIGHTS: "C2", UNDESIGNED: "C1", f"{NODE_TO_SEGMENT}, slave 0": "C3",
          f"{NODE_TO_SEGMENT}, slave 1": "C5", f"{MPC} tied, slave 0": "C6",
          f"{MPC} tied, slave 1": "C9", f"{MPC} slip, slave 1": "C8", MATCHING: "k",
          LAW: "C2"}  # fmt: skip
DASHES = {SADDLE: "o-", CHOLESKY: "s--", GAMG: "^:", CHOSEN: "D-", MULTIGRID: "^:"}
OF_LAW = {CHOSEN: "C2", SADDLE: "C0", MULTIGRID: "C3"}  # colours, where only the solver differs


def diagrams(rows, path, of):
    """Error against run time, a line for every method and solver, in the diagrams ``of``."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from PIL import Image

    lines, columns = (2, 2) if len(of) == 4 else (1, len(of))
    figure, axes = plt.subplots(lines, columns, figsize=(11, 4.25 * lines))
    shown = {}
    for axis, (scene, error, title) in zip(axes.flat, of):
        for (method, solver), found in curves(rows, scene, error).items():
            points = np.array([(row["cpu_seconds"], max(row[error], EPS)) for row in found]).T
            shown[f"{method}: {solver_name(method, solver)}"], = axis.loglog(
                *points, DASHES[solver], markersize=4, linewidth=1.2,
                color=OF_LAW[solver] if method == LAW else STYLES[method],
            )  # fmt: skip
        axis.set(title=title, xlabel="run time [CPU s]", ylabel="relative error")
        axis.grid(alpha=0.3)
    order = list(STYLES)
    names = sorted(shown, key=lambda name: order.index(name.split(":")[0]))
    figure.tight_layout(rect=(0, 0.13 if lines > 1 else 0.06, 1, 1))
    figure.legend([shown[k] for k in names], names, loc="lower center", ncol=4, fontsize=7)
    figure.savefig(path, dpi=90)
    plt.close(figure)
    Image.open(path).convert("P", palette=Image.Palette.ADAPTIVE, colors=64).save(path)  # a third


def write(folder, about, rows):
    """error_vs_time.png, of opening and friction error_vs_time_laws.png, .csv and .json."""
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"about": about, "rows": rows}, indent=1)
    (folder / "error_vs_time.json").write_text(text + "\n")
    with open(folder / "error_vs_time.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(dict.fromkeys(key for row in rows for key in row)))
        writer.writeheader()
        writer.writerows(rows)
    for name, of in (("error_vs_time", DIAGRAMS), ("error_vs_time_laws", LAWS)):
        if {row["scene"] for row in rows} & {scene for scene, *_ in of}:
            diagrams(rows, folder / f"{name}.png", of)
