"""The method in a picture: a frame between two meshes, its multipliers, and what its design does.

Two blocks of the same width, tied, under a constant pressure. Every node of either surface touches
the frame and passes its own multiplier to it (arrows). With rows that only interpolate, the frame's
nodes are out of balance, (28), and a constant pressure does not pass; with designed rows they are
in balance to rounding.

    mpirun -n 2 python demos/frame.py [--elements 4 7] [--plot DIR]
"""

import argparse
import json
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from friction_block import BOTTOM, TOP, body, stress
from hertz2d import hold
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

E, NU, PRESSURE, L, H = 1000.0, 0.3, 1.0, 1.0, 0.4
BODIES = ("#1f77b4", "#d62728")  # lower, upper


def solve(elements, design, comm=MPI.COMM_WORLD):
    """Result of the interface, its rows (n_i, m) of either side, and by how much (28) is missed."""
    forms, loads, bcs, sides = [], [], [], []
    for k, n in enumerate(elements):
        domain, tags = body(comm, (0.0, (k - 1) * H), (L, H), (n, 3))
        V = compat.function_space(domain, shape=(2,))
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
        forms.append(ufl.inner(stress(u, E, NU), ufl.grad(w)) * ufl.dx)
        loads.append(-fem.Constant(domain, k * PRESSURE) * w[1] * ds(TOP))
        if k == 0:
            bcs.append(hold(V, 1, lambda p: np.isclose(p[1], -H)))
            bcs.append(hold(V, 0, lambda p: np.isclose(p[0], 0.0) & np.isclose(p[1], -H)))
        sides.append((tags, BOTTOM if k else TOP))
    interface = llm.Interface(None, tuple(sides), design=design)
    problem = llm.ContactProblem(forms, loads, bcs=bcs, interfaces=[interface])
    problem.solve()
    N = [pairs.N.toarray() for pairs in problem.geometries[0].pairs]
    areas = [side.area for side in problem.results[0].sides]
    return problem.results[0], N, N[0].T @ areas[0] - N[1].T @ areas[1]


def error(result):
    """Largest error of the pressure at the surfaces' nodes."""
    found = np.concatenate([s.normal_force / s.area for s in result.sides])
    return float(np.abs(found / PRESSURE - 1.0).max())


def draw(result, N, missed, file):
    """The frame apart from the surfaces; what is missed without and with design."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    scene, bars = figure.subplots(1, 2, width_ratios=(1.9, 1.0))
    frame = result.frame.x[:, 0]
    order = np.argsort(frame)
    scene.plot(frame[order], 0.0 * frame, "ks-", ms=8, zorder=3)
    longest = max(np.abs(s.normal_force).max() for s in result.sides)
    for k, (side, rows) in enumerate(zip(result.sides, N)):
        x, y, color = side.x[:, 0], (-0.2, 0.2)[k], BODIES[k]
        scene.fill_between([0.0, L], [y, y], [3.0 * y, 3.0 * y], color=color, alpha=0.15, lw=0)
        scene.plot(np.sort(x), np.full(len(x), y), "o-", color=color, ms=7)
        for p, J in zip(*np.nonzero(np.abs(rows) > 1e-12)):
            width = 2.5 * abs(rows[p, J])
            scene.plot([x[p], frame[J]], [y, 0.0], ":", color=color, lw=width, zorder=1)
        size = 0.25 * side.normal_force / longest
        ends = {"headwidth": 4.0, "width": 0.006, "color": color, "zorder": 4}
        at = {"pivot": "tip", "angles": "xy", "scale_units": "xy", "scale": 1.0}
        scene.quiver(x, np.full(len(x), y), 0.0 * x, -np.sign(y) * size, **at, **ends)
        scene.text(-0.03, 2.0 * y, f"side {k}", ha="right", color=color)
    scene.text(-0.03, 0.0, "frame", ha="right", va="center")
    scene.set(xlim=(-0.22, 1.05), ylim=(-0.62, 0.62))
    scene.set_title("nodes, weights L_b (dotted), multipliers λ (arrows)", fontsize=10)
    scene.axis("off")
    for shift, (label, (x, r)) in zip((-0.03, 0.03), missed.items()):
        bars.bar(x / L + shift, r / L, 0.06, label=label)
    bars.set_title("r_J / L of (28) at the frame's nodes", fontsize=10)
    bars.set_xlabel("x / L")
    bars.legend()
    Path(file).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110)


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--elements", type=int, nargs=2, default=(4, 7), metavar="N")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    rows, missed = {}, {}
    for label, design in ("interpolated", None), ("designed", "auto"):
        result, N, r = solve(args.elements, design)
        missed[label] = result.frame.x[:, 0], r
        rows[label] = {"missed": float(np.abs(r).max()), "pressure error": error(result)}
    if MPI.COMM_WORLD.rank == 0:
        for label, row in rows.items():
            print(f"{label}: " + ", ".join(f"{name} {value:.2g}" for name, value in row.items()))
        if args.json:
            args.json.write_text(json.dumps(rows) + "\n")
        if args.plot:
            draw(result, N, missed, args.plot / "frame.png")
    return rows


if __name__ == "__main__":
    main()
