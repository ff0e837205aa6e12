"""Many random scenes, each in a process that may crash or hang: what failed, and how.

    python tests/shared/random_campaign.py FIRST-LAST [--second] [--finite | --time]
        [--variants] [--curved] [--tools] [--seconds 60]

Prints one line of JSON per seed. On several ranks, all seeds in one process, against one rank, with
`--second`, `--finite`, `--time`, `--curved`, `--tools` as well:

    python tests/shared/random_campaign.py FIRST-LAST --answers FOLDER
    mpirun -n 2 python tests/shared/random_campaign.py FIRST-LAST --answers FOLDER
"""

import argparse
import json
import logging
import os
import signal
import sys
import time
import traceback
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1] / "demos")]


def of_kind(kind):
    """(draw, check, solve) of scenes."""
    import random_finite
    import random_scenes
    import random_time
    import scene_oracle

    if kind == "finite":
        return random_finite.draw, random_finite.check, random_finite.solve
    if kind == "time":
        return random_time.draw, random_time.check, random_time.solve
    return random_scenes.draw, scene_oracle.check, random_scenes.solve


def drawn(seed, args):
    """Scene of a seed; None: not one of those that are asked for."""
    scene = of_kind(args.kind)[0](seed, args.second)
    scene.tool = args.tools
    moved = scene.load == "motion" and len(scene.bodies) > 1
    if (args.curved and not rubs_on_curves(scene)) or (args.tools and not moved):
        return None
    return scene


def one(scene, kind, variants):
    """Result of one scene as a dict."""
    import random_scenes as scenes

    import dolfinx_llm as llm

    logging.disable(logging.CRITICAL)
    _, check, solve = of_kind(kind)
    out = {"seed": scene.seed, "solver": scene.solver, "kind": "ok", "worst": {}, "variants": {}}
    try:
        answers, found = check(scene)
        if variants and not answers:
            answers = solve(scene)
    except llm.ContactError as error:
        return {**out, "kind": "raise", "text": str(error)}
    except Exception:
        return {**out, "kind": "error", "text": traceback.format_exc()[-1500:]}
    for step, worst in enumerate(found, 1):
        for name, value in worst.items():
            if value > 1e-8:
                out["worst"][f"{step} {name}"] = value
    hard = [k for k in out["worst"] if "(" not in k]
    out["kind"] = "violation" if hard else "ok"
    if not variants:
        return out
    posed = {
        "again": scenes.Variant(),
        "turned": scenes.Variant(turn="random"),
        "mirrored": scenes.Variant(turn="mirror"),
        "swapped": scenes.Variant(swap=True),
        "renumbered": scenes.Variant(renumber=scene.seed),
        "units": scenes.Variant(length=1e3, modulus=1e-5),
        **({} if kind == "time" else {"mixed": scenes.Variant(mixed=True)}),
        "form": scenes.Variant(solver="saddle" if scene.solver == "condensed" else "condensed"),
    }
    if kind == "finite":  # "swapped" is another frame where cells are as large on both sides
        del posed["again"]
    for name, variant in posed.items():
        try:
            difference = scenes.differences(solve(scene, variant.of(scene)), answers, scene)
        except Exception as error:
            out["variants"][name] = f"{type(error).__name__}: {error}"[:300]
            continue
        out["variants"][name] = difference
    return out


def rubs_on_curves(scene):
    """Whether there is friction between two bodies along a curve."""
    rubs = [c for c in scene.contacts if getattr(c.law, "mu", 0.0)]
    return bool(scene.radius) and any(not isinstance(c.second[0], str) for c in rubs)


def on_ranks(seeds, args):
    """One rank leaves answers in a folder, several compare theirs with these; collective."""
    import numpy as np
    import random_scenes as scenes
    from mpi4py import MPI

    import dolfinx_llm as llm

    logging.disable(logging.CRITICAL)
    comm, solve, folder = MPI.COMM_WORLD, of_kind(args.kind)[2], args.answers
    for seed in seeds:
        if (scene := drawn(seed, args)) is None:
            continue
        began, file = time.time(), folder / f"{seed}.npz"
        line = {"seed": seed, "ranks": comm.size}
        try:
            found = solve(scene, comm=comm)
        except llm.ContactError as error:
            found, line["text"] = [], str(error)[:300]
        if comm.rank == 0 and comm.size == 1:
            folder.mkdir(parents=True, exist_ok=True)
            np.savez(file, u=[a.u for a in found], force=[a.force for a in found])
        elif comm.rank == 0:
            with np.load(file) as kept:
                pairs = zip(kept["u"], kept["force"], strict=True)
                known = [scenes.Answer(u, list(f), [], []) for u, f in pairs]
            if len(found) == len(known) > 0:
                line |= scenes.differences(found, known, scene)
            elif len(found) != len(known):
                line["differs"] = "raises on one rank, or on these, alone"
        line["seconds"] = round(time.time() - began, 2)
        if comm.rank == 0:
            print(json.dumps(line), flush=True)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("seeds", nargs="+", help="seeds, or FIRST-LAST")
    parser.add_argument("--variants", action="store_true")
    kinds = parser.add_mutually_exclusive_group()
    parser.add_argument("--second", action="store_true", help="most bodies of second order")
    for kind, text in (
        ("finite", "at finite deformation"),
        ("time", "bodies that fly at each other, in time"),
    ):
        kinds.add_argument(f"--{kind}", dest="kind", action="store_const", const=kind, help=text)
    parser.add_argument("--curved", action="store_true", help="friction on curved frames alone")
    parser.add_argument("--tools", action="store_true", help="all of a body moved, alone")
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--answers", type=Path)
    args = parser.parse_args()
    seeds = []
    for word in args.seeds:
        low, _, high = word.partition("-")
        seeds += range(int(low), int(high or low) + 1)
    if args.answers:
        on_ranks(seeds, args)
        return
    for seed in seeds:
        if (scene := drawn(seed, args)) is None:
            continue
        began = time.time()
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(read)
            try:
                text = json.dumps(one(scene, args.kind, args.variants))
            except BaseException:
                text = json.dumps({"seed": seed, "kind": "broken", "text": traceback.format_exc()})
            with os.fdopen(write, "w") as file:
                file.write(text)
            os._exit(0)
        os.close(write)
        signal.signal(signal.SIGALRM, lambda *_, child=child: os.kill(child, signal.SIGKILL))
        signal.alarm(args.seconds)
        with os.fdopen(read) as file:
            text = file.read()
        _, status = os.waitpid(child, 0)
        signal.alarm(0)
        if text:
            result = json.loads(text)
        else:
            killed = os.WIFSIGNALED(status) and os.WTERMSIG(status)
            result = {"seed": seed, "kind": "hang" if killed == signal.SIGKILL else "crash"}
            result["text"] = f"signal {killed}"
        result["seconds"] = round(time.time() - began, 2)
        line = json.dumps(result)
        print(line, flush=True)


if __name__ == "__main__":
    main()
