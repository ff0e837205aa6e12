"""Cost of an interface against its size: location, patch forces, design, operators.

Two flat surfaces of jittered quads, 10^2 to 10^5 nodes a side, no bodies: what is timed is what the
interface itself costs, once per scene.

    python demos/scale.py [--largest N] [--plot DIR] [--json FILE]
"""

import argparse
import json
import resource
import time
from pathlib import Path

import numpy as np

from dolfinx_llm import plot
from dolfinx_llm.design.predict import predict_frame
from dolfinx_llm.design.weights import design_weights, patch_residual
from dolfinx_llm.geometry.loads import NodalLoads
from dolfinx_llm.geometry.overlap_flat import common_area, common_plane
from dolfinx_llm.geometry.pairs import locate_pairs, rank_certificate, with_weights
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.operators.assemble import interface_operator

STAGES = ("patch forces", "frame", "location", "design", "certificate", "operators")


def surface(n, size, shift, up, rng):
    """n x n jittered quads on a square; ``up``: whether its outward normal is +z."""
    line = np.linspace(0.0, 1.0, n + 1)
    x, y = (g.ravel() for g in np.meshgrid(line, line, indexing="ij"))
    inner = (x > 0) & (x < 1) & (y > 0) & (y < 1)
    x, y = (c + inner * rng.uniform(-0.2, 0.2, len(c)) / n for c in (x, y))
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    facets = corner[:, None] + np.array([0, n + 1, n + 2, 1])
    points = np.column_stack([x * size + shift, y * size + shift, np.zeros(len(x))])
    nodes = np.arange(len(points))
    return Surface(points, facets if up else facets[:, ::-1], nodes, 0 * nodes, f"{n} x {n} quads")


def measure(n):
    """Seconds by stage and the figures of one pair of surfaces, about n^2 nodes each."""
    rng = np.random.default_rng(2001)
    sides = (surface(n, 1.0, 0.0, True, rng), surface(round(1.1 * n), 0.93, 0.11, False, rng))
    times, last = {}, time.perf_counter()

    def stop(stage):
        nonlocal last
        times[stage], last = time.perf_counter() - last, time.perf_counter()

    plane = common_plane(*sides)
    area = common_area(*sides, plane)
    loads = [NodalLoads.on(side, plane.project(side.x), area) for side in sides]
    stop("patch forces")
    frame, _ = predict_frame(
        sides, [load.touched for load in loads], plane, by_nodes=True, corners=4
    )
    stop("frame")
    pairs = locate_pairs(sides, loads, frame, 3.0, plane)
    stop("location")
    forces = [p.forces for p in pairs]
    N = design_weights(
        frame, plane.project(frame.x), [p.N for p in pairs], [p.cell for p in pairs], forces
    )
    pairs = [with_weights(p, M, frame) for p, M in zip(pairs, N, strict=True)]
    stop("design")
    singular = rank_certificate(frame, N)
    stop("certificate")
    directions = np.broadcast_to(np.eye(3), (len(frame.x), 3, 3))
    interface_operator(pairs, directions)
    stop("operators")
    return {
        "nodes": [len(p.nodes) for p in pairs],
        "times": times,
        "total": sum(times.values()),
        "residual": float(np.abs(patch_residual(N, forces)).max()),
        "singular_values": [float(s) for s in singular],
        "memory_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2,
    }


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--largest", type=int, default=100_000, help="nodes a side")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    parser.add_argument("--json", type=Path, metavar="FILE")
    args = parser.parse_args(arguments)
    sizes = [n for n in (10, 32, 100, 316) if n * n <= args.largest]
    measure(10)  # first calls load libraries
    print(f"{'nodes':>15}" + "".join(f"{s:>14}" for s in (*STAGES, "total [s]", "residual", "GB")))
    rows = []
    for n in sizes:
        rows.append(row := measure(n))
        seconds = "".join(f"{row['times'][s]:14.3f}" for s in STAGES)
        print(
            f"{row['nodes'][0]:>7}{row['nodes'][1]:>8}{seconds}{row['total']:14.3f}"
            f"{row['residual']:14.1e}{row['memory_gb']:14.2f}"
        )
    if args.json:
        args.json.write_text(json.dumps(rows, indent=2) + "\n")
    if args.plot:
        nodes = np.array([sum(row["nodes"]) for row in rows])
        lines = [(stage, ".-", nodes, [row["times"][stage] for row in rows]) for stage in STAGES]
        lines.append(("total", "k.-", nodes, [row["total"] for row in rows]))
        guide = rows[-1]["total"] / nodes[-1] * nodes
        lines.append(("proportional to the nodes", "k:", nodes, guide))
        names = {"xlabel": "surface nodes in contact, both sides", "ylabel": "seconds"}
        plot.curves(lines, args.plot / "scale.png", log=True, **names)
    return rows


if __name__ == "__main__":
    main()
